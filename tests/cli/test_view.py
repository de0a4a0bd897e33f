"""`mocap-ros view`: what it writes, and what it never overwrites."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.cli.main import main
from tests.support.quick_options import QUICK_OPTIONS


def test_it_writes_a_page(short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / 'page.html'
    assert main(['view', str(short_recording), '-o', str(output), *QUICK_OPTIONS]) == 0
    assert capsys.readouterr().out == f'{output}\n'
    assert short_recording.name in output.read_text(encoding='utf-8')


def test_the_input_is_never_overwritten(short_recording: Path, tmp_path: Path) -> None:
    link = tmp_path / 'link.html'
    link.symlink_to(short_recording)
    before = short_recording.read_bytes()
    assert main(['view', str(short_recording), '-o', str(link)]) == 1
    assert short_recording.read_bytes() == before


def test_an_option_that_does_nothing_to_a_result_is_refused(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, page = tmp_path / 'result.npz', tmp_path / 'page.html'
    assert main(['reconstruct', str(short_recording), '-o', str(result), *QUICK_OPTIONS]) == 0
    capsys.readouterr()
    for option in (['--set', 'tracker.lag=0.2'], ['--model', 'walk'], ['--topic', '/keypoints']):
        assert main(['view', str(result), '-o', str(page), *option]) == 1
        assert f'{result}: holds a result, which is shown as it is; --topic' in capsys.readouterr().err
    assert not page.exists()
    assert main(['view', str(result), '-o', str(page)]) == 0
