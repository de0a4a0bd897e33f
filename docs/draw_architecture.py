# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Draw the folders of the package and the imports between them into docs/img/architecture.png.

The floors are the layers of the import contract in pyproject.toml, the purposes are the first lines of the
folders' docstrings, and the arrows are the import statements. Run it as `make architecture`.
"""

from __future__ import annotations

import ast
import sys
import textwrap
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'mocap_ros'
PICTURE = ROOT / 'docs' / 'img' / 'architecture.png'

WIDTH = 22.2  # inches, of the picture: eight boxes on the lowest floor
LEFT, RIGHT = 6.4, 17.2  # inches, middles of the columns of mathematics and of data
FLOOR_HEIGHT = 1.35  # inches from floor to floor
SLOT = 2.75  # inches from box to box on a floor
BOX_WIDTH, BOX_HEIGHT = 2.55, 0.98  # inches
MATHEMATICS, DATA, SHARED = '#d9e8fb', '#fde5c8', '#ececec'  # fills of the two columns and of what both use
PURPOSE_CHARACTERS = 36  # characters in a line of a box


def read_contract() -> tuple[list[list[str]], set[str], set[str]]:
    """Return the floors from the top down, and the folders of the mathematics and of the data."""
    contracts = tomllib.loads((ROOT / 'pyproject.toml').read_text())['tool']['importlinter']['contracts']
    layers = next(c for c in contracts if c['type'] == 'layers')['layers']
    columns = next(c for c in contracts if c['name'].startswith('Messages, bags'))
    names = {
        key: {m.split('.')[1] for m in columns[key] if '.' in m} for key in ('source_modules', 'forbidden_modules')
    }
    floors = [[name.strip() for name in layer.replace(':', '|').split('|')] for layer in layers]
    return floors, names['forbidden_modules'] - {'runtime'}, names['source_modules']


def read_purpose(folder: str) -> str:
    """Return the first line of the docstring of a folder or module at the root of the package."""
    path = PACKAGE / folder / '__init__.py'
    text = (path if path.is_file() else PACKAGE / f'{folder}.py').read_text()
    docstring = ast.get_docstring(ast.parse(text)) or ''
    return docstring.split('\n')[0].split('. ')[0].split(' (')[0].rstrip('.')


def find_imports() -> set[tuple[str, str]]:
    """Return the pairs of folders of which the first imports the second.

    The root of the package, which exports the public names of `api`, is no folder.
    """
    pairs = set()
    for path in set(PACKAGE.rglob('*.py')) - {PACKAGE / '__init__.py'}:
        importer = path.relative_to(PACKAGE).parts[0].removesuffix('.py')
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith('mocap_ros'):
                modules = (
                    [node.module] if node.module != 'mocap_ros' else [f'mocap_ros.{a.name}' for a in node.names]
                )
                pairs |= {(importer, module.split('.')[1]) for module in modules}
    return {(importer, imported) for importer, imported in pairs if importer != imported}


def leave_out_implied(imports: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return the imports that do not follow from a chain of others (the transitive reduction)."""

    def reaches(start: str, end: str) -> bool:
        following = {b for a, b in imports if a == start}
        return end in following or any(reaches(middle, end) for middle in following)

    return {
        (importer, imported)
        for importer, imported in imports
        if not any(reaches(middle, imported) for a, middle in imports if a == importer and middle != imported)
    }


def place_boxes(floors: list[list[str]], mathematics: set[str], data: set[str]) -> dict[str, tuple[float, float]]:
    """Return the middle and the lower edge of each box in inches: mathematics on the left, data on the right."""
    boxes = {}
    for number, floor in enumerate(floors):
        y = (len(floors) - 1 - number) * FLOOR_HEIGHT + 0.2
        left = [name for name in floor if name in mathematics]
        right = [name for name in floor if name in data]
        middle = [name for name in floor if name not in mathematics | data]
        for names, centre in ((left, LEFT), (middle, WIDTH / 2), (right, RIGHT)):
            for i, name in enumerate(names):
                boxes[name] = (centre + (i - (len(names) - 1) / 2) * SLOT, y)
    return boxes


def draw() -> Figure:
    """Return the picture."""
    floors, mathematics, data = read_contract()
    modules = [
        name for floor in floors for name in floor if (PACKAGE / f'{name}.py').is_file() or name == 'config'
    ]
    floors = [[name for name in floor if name not in modules] for floor in floors]
    floors = [floor for floor in floors if floor] + [modules]
    boxes = place_boxes(floors, mathematics, data)
    height = len(floors) * FLOOR_HEIGHT + 0.7
    figure = Figure(figsize=(WIDTH, height))
    axes: Any = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(0, height))
    axes.axis('off')
    for importer, imported in sorted(leave_out_implied({i for i in find_imports() if not set(i) & set(modules)})):
        (x0, y0), (x1, y1) = boxes[importer], boxes[imported]
        arrow = FancyArrowPatch(
            (x0, y0),
            (x1, y1 + BOX_HEIGHT),
            connectionstyle=f'arc3,rad={0.0 if y0 - y1 < 1.5 * FLOOR_HEIGHT else 0.12}',
            arrowstyle='-|>',
            mutation_scale=14,
            linewidth=1.4,
            color='#b06a10' if imported in data else '#4a5a70',
            zorder=1,
        )
        axes.add_patch(arrow)
    for name, (x, y) in boxes.items():
        fill = MATHEMATICS if name in mathematics else DATA if name in data else SHARED
        corner = (x - BOX_WIDTH / 2, y)
        style = 'round,pad=0.02,rounding_size=0.08'
        axes.add_patch(
            FancyBboxPatch(corner, BOX_WIDTH, BOX_HEIGHT, boxstyle=style, fc=fill, ec='#555555', zorder=2)
        )
        label = f'{name}.py' if (PACKAGE / f'{name}.py').is_file() else f'{name}/'
        text = {'ha': 'center', 'va': 'center', 'zorder': 3}
        axes.text(x, y + BOX_HEIGHT - 0.17, label, weight='bold', size=13, **text)
        lines = textwrap.wrap(read_purpose(name), PURPOSE_CHARACTERS)[:4]
        axes.text(x, y + (BOX_HEIGHT - 0.27) / 2, '\n'.join(lines), size=8.5, **text)
    caption = (
        'Imports go down. Blue: mathematics; orange: messages, bags and files; grey: what both use, or what\n'
        'brings both together. Arrows that follow from others are left out, and those to the lowest floor.'
    )
    axes.text(WIDTH / 2, height - 0.28, caption, ha='center', va='center', size=11)
    return figure


def main() -> None:
    """Write the picture."""
    figure = draw()
    FigureCanvasAgg(figure)
    figure.savefig(PICTURE, dpi=90)
    print(PICTURE.relative_to(ROOT))


if __name__ == '__main__':
    main()
