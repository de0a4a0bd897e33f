# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros view`: what it writes, and what it never overwrites."""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from tests.support.quick_options import QUICK_OPTIONS


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('options', [[], ['-o', 'page.html'], ['-o', 'page.png', '--poses', '2']])
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
    assert capsys.readouterr().out == f'{output}\n'
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
    assert main(['view', str(path), '--poses', '2', '-o', str(tmp_path / 'a.png'), *QUICK_OPTIONS]) == 0
    assert main(['keyframes', str(path), '-o', str(tmp_path / 'k.yaml')]) == 0
    assert (tmp_path / 'k.yaml').read_text(encoding='utf-8').startswith('# Keyframes of walk\\udcff.npz. ')
    assert all((tmp_path / name).stat().st_size > 1000 for name in ('a.png', 'k.png', 'k_distances.png'))


def test_keyframes_of_somebody_who_comes_later_are_marked_where_they_are(tmp_path: Path) -> None:
    """The scene of all people begins with Anna; the times of Ben's keyframes count from his first frame."""
    sequence = make_recording().sequence()
    stamps_ns, comes, last = sequence.stamps_ns, 15, 45
    with Recorder(tmp_path / 'in', RecorderConfig()) as recorder:
        for frame, stamp_ns in enumerate(stamps_ns[:last]):
            anna, ben = sequence.person(frame, 'anna'), sequence.person(frame, 'ben')
            people = [anna, replace(ben, points=ben.points + [-150.0, 0.0])][: 2 if frame >= comes else 1]
            raw = encode_keypoints(Header(stamp_ns, 'camera'), sequence.image_size, people)
            recorder.write('/keypoints', KEYPOINTS, raw, stamp_ns, stamp_ns)
    bag, listed = str(tmp_path / 'in'), tmp_path / 'ben.yaml'
    assert main(['keyframes', bag, '--person', 'ben', '-o', str(listed)]) == 0
    content = yaml.safe_load(listed.read_text(encoding='utf-8'))
    assert content['start_ns'] == stamps_ns[comes]
    times = sorted(entry['time'] for entry in content['keyframes'])
    assert times
    for person, first in (((), 0), (('--person', 'ben'), comes)):
        page = tmp_path / f'{first}.html'
        arguments = ['-o', str(page), '--keyframes', str(listed), *person, *QUICK_OPTIONS]
        assert main(['view', bag, *arguments]) == 0
        found = re.search(
            r'<script[^>]*id="scene"[^>]*>(.*?)</script>', page.read_text(encoding='utf-8'), re.DOTALL
        )
        assert found is not None
        marks = [mark['time'] for mark in json.loads(found[1])['marks']]
        late_s = (stamps_ns[comes] - stamps_ns[first]) / 1e9
        assert marks == pytest.approx([time + late_s for time in times], abs=1e-6)
    arguments = ['reconstruct', bag, '--person', 'ben', '--method', 'keyframes', '--choices', str(listed)]
    assert main([*arguments, '-o', str(tmp_path / 'ben.npz')]) == 0
