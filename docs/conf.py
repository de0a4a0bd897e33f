# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the documentation site, which `config/task.sh docs` builds, and rosdoc2 on the ROS servers.

The site is the pages of this folder, the pages of the repository's root, and a reference that is written here from
the parameter file, the message definitions, the help of the commands and the public names of the package.

rosdoc2 copies this folder and runs this file from elsewhere; its command line then names the repository.
"""

from __future__ import annotations

import os
import re
import sys
import textwrap
import xml.etree.ElementTree as ET
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

ROOT = next(
    folder.resolve()
    for folder in (Path(__file__).parents[1], *(Path(os.environ.get('PWD', ''), word) for word in sys.argv))
    if (folder / 'msg_defs' / 'package.xml').is_file()
)
DOCS = ROOT / 'docs'
sys.path.insert(0, str(ROOT))
PACKAGE_XML = ET.parse(ROOT / 'package.xml')  # noqa: S314 - a file of this repository
REPOSITORY = PACKAGE_XML.findtext("url[@type='repository']")
LOGGER = logging.getLogger(__name__)

project = PACKAGE_XML.findtext('name')
author = PACKAGE_XML.findtext('maintainer')
copyright = f'2026, {author}'  # noqa: A001 - Sphinx gives the name
version = PACKAGE_XML.findtext('version') or ''
IS_UNRELEASED = f'## {version} (unreleased)' in (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8').splitlines()
release = f'{version} (unreleased)' if IS_UNRELEASED else version

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon', 'sphinx.ext.viewcode']
html_theme = 'furo'
html_title = f'{project} {release}'
myst_heading_anchors = 4  # levels of headings that a link with `#` finds
maximum_signature_line_length = 100  # characters; a longer one has a line for each argument
default_role = 'literal'  # single back quotes in docstrings are code
autodoc_member_order = 'bysource'
autodoc_typehints = 'signature'
autodoc_default_options = {'members': True}
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    'Array': 'Array',
    'BoolArray': 'BoolArray',
}  # shown by these names, not as what they stand for
napoleon_use_ivar = True  # attributes as one list
linkcheck_timeout = 20  # s
linkcheck_ignore = [rf'{REPOSITORY}.*']  # its paths are checked below, as files

LINK = re.compile(r'(?<=\]\()(?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?(?=\))')
# Pages of the root, which stand in the folder project/ of the site.
ROOT_PAGES = {page.name: f'project/{page.stem.lower()}.md' for page in sorted(ROOT.glob('*.md'))}
# Page of the site by the file or folder of the repository that it shows.
SHOWN_BY = {
    **ROOT_PAGES,
    'config/mocap_ros.yaml': 'reference/parameters.md',
    'msg_defs/msg': 'reference/messages.md',
}


def direct_links(text: str, folder: Path, page: str) -> str:
    """Return the text of a page with its links as the site needs them.

    A link to a page or picture of the site is relative to the page's place in the site; the repository shows any
    other file or folder.

    Args:
        text: Markdown.
        folder: Folder of the page's source, to which its links are relative.
        page: Name of the page in the site, without suffix.
    """

    def direct(link: re.Match[str]) -> str:
        target = (folder / link[1]).resolve()
        if not target.exists():
            LOGGER.warning('there is no %s', link[1], location=page)
            return link[0]
        path = target.relative_to(ROOT).as_posix()
        place = SHOWN_BY.get(path) or (path.removeprefix('docs/') if target.is_relative_to(DOCS) else None)
        if place is None:
            return f'{REPOSITORY}/{"tree" if target.is_dir() else "blob"}/main/{path}'
        return os.path.relpath(place, Path(page).parent) + (link[2] or '')

    return LINK.sub(direct, text)


def direct_page(_: Sphinx, page: str, source: list[str]) -> None:
    """Direct the links of a page of this folder."""
    if '/' not in page:
        source[0] = direct_links(source[0], DOCS, page)


def write_if_changed(path: Path, text: str) -> None:
    """Write a page; one that is the same keeps its time, and is not built again."""
    path.parent.mkdir(exist_ok=True)
    if not path.exists() or path.read_text(encoding='utf-8') != text:
        path.write_text(text, encoding='utf-8')


def write_pages(app: Sphinx) -> None:
    """Write the pages of the folders project/ and reference/."""
    for name, place in ROOT_PAGES.items():
        text = (ROOT / name).read_text(encoding='utf-8')
        write_if_changed(app.srcdir / place, direct_links(text, ROOT, place))
    pages = {
        'parameters': describe_parameters,
        'messages': describe_messages,
        'commands': describe_commands,
        'python': describe_python,
    }
    for page, describe in pages.items():
        try:
            text = describe()
        except ImportError as error:
            LOGGER.warning('the page wants the packages that this one needs: %s', error, location=page)
            text = (
                f'# {page.capitalize()}\n\nMissing, because the site was built without what the package needs.\n'
            )
        write_if_changed(app.srcdir / 'reference' / f'{page}.md', text)


def describe_parameters() -> str:
    """Return the page of the parameters, which is the parameter file."""
    parameters = (ROOT / 'config' / 'mocap_ros.yaml').read_text(encoding='utf-8')
    introduction = textwrap.dedent("""\
        # Parameters

        This is `config/mocap_ros.yaml`, which `mocap-ros config` prints: what many users set, with default,
        meaning and range; `--all` prints every parameter. `--params-file` gives such a file to the node,
        `--config` to the commands, `--set` one value.
        """)
    return f'{introduction}\n```yaml\n{parameters}```\n'


def describe_messages() -> str:
    """Return the page of the message definitions."""
    parts = ['# Messages\n\nThe definitions of the package `mocap_ros_msgs`.\n']
    parts += [
        f'## {message.stem}\n\n```text\n{message.read_text(encoding="utf-8")}```\n'
        for message in sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg'))
    ]
    return '\n'.join(parts)


def describe_commands() -> str:
    """Return the page of the commands, which is their help."""
    os.environ.update(COLUMNS='84', NO_COLOR='1')  # characters; argparse formats its help for the terminal
    from mocap_ros.cli.main import COMMANDS, build_parser

    parser = build_parser()
    subparsers = next(action.choices for action in parser._actions if isinstance(action.choices, dict))
    parts = [f'# Commands\n\n```text\n{parser.format_help()}```\n']
    parts += [f'## mocap-ros {name}\n\n```text\n{subparsers[name].format_help()}```\n' for name in COMMANDS]
    return '\n'.join(parts)


def describe_python() -> str:
    """Return the page of the public Python names, which is their docstrings."""
    import mocap_ros

    parts = ['# Python reference\n\nThe public names; [Python](../python.md) shows how they are used together.\n']
    for name in mocap_ros.__all__:
        directive = 'autoclass' if isinstance(getattr(mocap_ros, name), type) else 'autofunction'
        parts.append(f'## {name}\n\n```{{eval-rst}}\n.. {directive}:: mocap_ros.{name}\n```\n')
    return '\n'.join(parts)


def setup(app: Sphinx) -> None:
    """Connect the functions above to the build."""
    app.connect('builder-inited', write_pages)
    app.connect('source-read', direct_page)
