# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The documents name files that exist, and the code keeps the rules that a reader relies on."""

import ast
import re
from pathlib import Path

import pytest

from mocap_ros.cli.main import COMMANDS
from mocap_ros.config.access import parameters
from tests.support.paths import ROOT

PACKAGE = ROOT / 'mocap_ros'
PAGES = [*ROOT.glob('*.md'), *ROOT.glob('docs/*.md')]
MODULES = sorted(PACKAGE.rglob('*.py'))


def test_every_file_that_the_architecture_names_exists() -> None:
    text = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
    paths = re.findall(r'`([a-z0-9_]+(?:/[a-z0-9_]+)*(?:\.py|/))`', text)
    assert paths
    for path in paths:
        places = [PACKAGE / path, ROOT / path, *PACKAGE.glob(f'*/{path}')]
        assert any(p.exists() for p in places), path


def anchors(page: Path) -> set[str]:
    text = re.sub(r'^```.*?^```', '', page.read_text(encoding='utf-8'), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r'^#+ (.*)$', text, re.MULTILINE)
    return {re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target, anchor in re.findall(r'\]\(([^)#\s]*)#?([^)\s]*)\)', page.read_text(encoding='utf-8')):
        if '://' not in target:
            path = page.parent / target if target else page
            assert path.exists(), f'{page.name}: {target}'
            assert not anchor or anchor in anchors(path), f'{page.name}: {target}#{anchor}'


@pytest.mark.parametrize('page', PAGES, ids=lambda p: p.name)
def test_every_parameter_and_command_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding='utf-8').split('## 0.1.0')[0]
    known = {parameter.name for parameter in parameters()}
    groups = '|'.join({name.partition('.')[0] for name in known})
    assert set(re.findall(rf'(?:`|-p |--set )((?:{groups})\.[a-z_]+)', text)) <= known
    assert set(re.findall(r'mocap-ros ([a-z]+)', text)) <= {*COMMANDS, 'plot'}, 'the changelog names `plot`'


def test_every_page_is_in_the_table_of_contents_of_the_site() -> None:
    listed = (ROOT / 'docs' / 'index.rst').read_text(encoding='utf-8').split()
    assert {page.stem for page in PAGES if page.parent.name == 'docs'} - set(listed) == set()


@pytest.mark.parametrize('module', MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_every_number_among_the_constants_has_a_comment(module: Path) -> None:
    """A comment on the line of the constant, or above its block, gives unit and reason; options have help."""
    text = module.read_text(encoding='utf-8')
    lines = text.split('\n')
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        numbers = [n for n in ast.walk(node) if isinstance(n, ast.Constant) and type(n.value) in (int, float)]
        if not numbers or not any(name[0] != '_' and name.isupper() for name in {*names} - {'OPTIONS'}):
            continue
        inside = any('#' in line for line in lines[node.lineno - 1 : node.end_lineno])
        block = '\n'.join(lines[: node.lineno - 1]).rpartition('\n\n')[2]
        is_commented = inside or block.startswith('#') or lines[node.lineno - 2].startswith('#')
        assert is_commented, f'{module.name}:{node.lineno}: {names[0]} has neither unit nor reason'
