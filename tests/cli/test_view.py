# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros view`: what it writes, and what it never overwrites."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from mocap_ros.cli.main import main
from tests.support.quick_options import QUICK_OPTIONS


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('options', [[], ['-o', 'page.html'], ['-o', 'page.png']])
def test_it_writes_a_page_or_a_picture(
    short_recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    output = Path(options[1] if options else f'{short_recording.stem}.html')
    assert main(['view', str(short_recording), *options, *QUICK_OPTIONS]) == 0
    assert capsys.readouterr().out.startswith(f'{output}\n')
    if output.suffix == '.html':
        assert short_recording.name in output.read_text(encoding='utf-8')
    else:
        assert output.read_bytes().startswith(b'\x89PNG')


def test_an_option_that_does_nothing_to_a_result_is_refused(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result, page = tmp_path / 'result.npz', tmp_path / 'page.html'
    assert main(['reconstruct', str(short_recording), '-o', str(result), *QUICK_OPTIONS]) == 0
    capsys.readouterr()
    for option in (['--set', 'tracker.lag=0.2'], ['--model', 'walk'], ['--topic', '/keypoints']):
        assert main(['view', str(result), '-o', str(page), *option]) == 1
        assert f'holds a result, which is shown as it is; {option[0]} does not' in capsys.readouterr().err
    assert not page.exists()
    for output in ('page.html', 'page.png'):
        assert main(['view', str(result), '-o', str(tmp_path / output)]) == 0


def test_a_file_whose_name_is_no_utf_8_has_pictures(short_recording: Path, tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b'walk\xff.npz')
    shutil.copy(short_recording, path)
    for out in ('a.png', 'a.html'):
        assert main(['view', str(path), '-o', str(tmp_path / out), *QUICK_OPTIONS]) == 0
        assert (tmp_path / out).stat().st_size > 1000
