# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The examples of docs/python.md run, one after the other, and print nearly what the page says."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PAGE = (ROOT / 'docs' / 'python.md').read_text(encoding='utf-8')
# Each example and the output that the page shows below it, if any.
EXAMPLES = re.findall(r'```python\n(.*?)```(?:\n\n```text\n(.*?)```)?', PAGE, re.DOTALL)


# Decimals and shares, whose last digits vary with the machine; whole numbers are counts and do not.
MEASURED = re.compile(r'-?\d+\.\d*|\d+(?=%)')
TOLERANCE = 0.05  # 1; the results of two machines differ by less, those of two versions with other results by more


def split_figures(text: str) -> tuple[list[str], list[str]]:
    """Return the lines with decimals and shares masked and spaces made one, and these figures as printed."""
    masked = [' '.join(line.split()) for line in MEASURED.sub('#', text).strip().splitlines()]
    return masked, [match.group() for match in MEASURED.finditer(text)]


def find_differences(printed: str, expected: str) -> list[str]:
    """Return what differs between printed text and that of the page; figures may differ a little.

    A figure may differ by `TOLERANCE` of the expected one, or by one in its last digit where that is more.
    """
    (lines, figures), (expected_lines, expected_figures) = split_figures(printed), split_figures(expected)
    if lines != expected_lines:
        return [f'printed {lines}, the page has {expected_lines}']
    return [
        f'printed {figure}, the page has {expected_figure}'
        for figure, expected_figure in zip(figures, expected_figures, strict=True)
        if abs(float(figure) - float(expected_figure))
        > max(TOLERANCE * abs(float(expected_figure)), 1.001 * 10.0 ** -len(expected_figure.partition('.')[2]))
    ]


@pytest.mark.slow
def test_every_example_runs_and_prints_what_the_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {'__name__': '__main__'}
    for code, expected in EXAMPLES:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, 'docs/python.md', 'exec'), names)
        assert not expected or not find_differences(printed.getvalue(), expected), printed.getvalue()
