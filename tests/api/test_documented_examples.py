"""The examples of docs/python.md run, one after the other, and print what the page says."""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PAGE = (ROOT / 'docs' / 'python.md').read_text(encoding='utf-8')
# Each example and the output that the page shows below it, if any.
EXAMPLES = re.findall(r'```python\n(.*?)```(?:\n\n```text\n(.*?)```)?', PAGE, re.DOTALL)


def mask_numbers(text: str) -> list[str]:
    """Return the lines with decimals and shares masked, whose last digits vary with the machine."""
    masked = re.sub(r'-?\d+\.\d*|\d+%', '#', text)
    return [' '.join(line.split()) for line in masked.strip().splitlines()]


def test_the_page_has_examples() -> None:
    assert len(EXAMPLES) == PAGE.count('```python') == PAGE.count('```') // 2 - PAGE.count('```text')
    assert sum(bool(output) for _, output in EXAMPLES) == PAGE.count('```text')


@pytest.mark.slow
def test_every_example_runs_and_prints_what_the_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {'__name__': '__main__'}
    for code, expected in EXAMPLES:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, 'docs/python.md', 'exec'), names)
        assert not expected or mask_numbers(printed.getvalue()) == mask_numbers(expected), printed.getvalue()


@pytest.mark.slow
def test_the_types_of_the_examples_are_known(tmp_path: Path) -> None:
    pytest.importorskip('mypy')
    script = tmp_path / 'examples.py'
    script.write_text('\n'.join(code for code, _ in EXAMPLES), encoding='utf-8')
    check = subprocess.run(
        [sys.executable, '-m', 'mypy', '--strict', '--follow-imports=silent', '--no-error-summary', script],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert not check.stdout, check.stdout
