# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The recording of Rerun: rows that end where people leave, states that change, and what Rerun reads back."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from mocap_ros.errors import MocapError
from mocap_ros.skeleton import CMU15
from mocap_ros.viewing import rerun_recording
from mocap_ros.viewing.rerun_recording import (
    LiveDrawing,
    end_runs,
    find_changes,
    make_entity_name,
    name_people,
    name_states,
    write_recording,
)
from mocap_ros.viewing.rerun_viewer import disable_telemetry, require_display, start_viewer
from mocap_ros.viewing.scene import Scene, SceneKeypoints
from tests.support.browser import count_colours
from tests.support.full_disk import limit_file_size
from tests.support.recording_of_rerun import count_rows, run_rerun
from tests.support.scenes import make_scene, make_scene_person
from tests.support.virtual_display import open_display

TIMES = np.arange(10) / 10
PHOTOGRAPH_TIMEOUT_S = 240  # s; with software rendering on a busy machine it took 40 s


def test_an_empty_row_follows_each_run_of_frames() -> None:
    times, lengths = end_runs(TIMES, np.array([1, 2, 5]), np.array([15, 15, 14]))
    assert times.tolist() == [0.1, 0.2, 0.3, 0.5, 0.6]
    assert lengths.tolist() == [15, 15, 0, 14, 0]
    times, lengths = end_runs(TIMES, np.array([8, 9]), np.array([3, 3]))
    assert (times.tolist(), lengths.tolist()) == ([0.8, 0.9], [3, 3])


def test_states_are_sent_where_they_change_and_end_where_the_person_leaves() -> None:
    changes = find_changes(TIMES, np.array([1, 2, 3, 6, 7]), ['a', 'a', 'b', 'b', 'b'])
    assert changes == [(0.1, 'a'), (0.3, 'b'), (0.4, None), (0.6, 'b'), (0.8, None)]
    assert find_changes(TIMES, np.array([9]), ['a']) == [(0.9, 'a')]


def test_the_states_say_what_became_of_the_person() -> None:
    person = make_scene_person('anna', range(4), (0, 0, 4))
    person.tentative[0], person.predicted[2], person.motion[:] = True, True, [0, 1, 2, 9]
    states = name_states(person, np.array([False, True, False, False]))
    assert states['detection'] == ['tentative', 'swap undone', 'predicted', 'seen']
    assert states['motion'] == ['unknown', 'periodic', 'not periodic', 'unknown']


def test_ids_of_strangers_become_names_of_their_own() -> None:
    assert make_entity_name('a/../b') == 'a____b'
    scene = make_scene()
    twins = replace(scene, people=tuple(replace(scene.people[0], id=i) for i in ('a/b', 'a.b', '')))
    assert name_people(twins) == ['a_b', 'a_b_2', '_']


def test_without_rerun_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, 'rerun', None)
    with pytest.raises(MocapError, match=re.escape("pip install 'mocap_ros[view]'")):
        write_recording(make_scene(), tmp_path / 'x.rrd')


def test_without_a_display_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('DISPLAY', raising=False)
    monkeypatch.delenv('WAYLAND_DISPLAY', raising=False)
    with pytest.raises(MocapError, match=re.escape('-o page.html')):
        require_display()


@pytest.fixture
def scene() -> Scene:
    return make_scene()


def test_a_full_disk_is_one_clear_error(scene: Scene, tmp_path: Path) -> None:
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    path = tmp_path / 'scene.rrd'
    with limit_file_size(2_000), pytest.raises(MocapError, match=r'^scene\.rrd: Rerun could not write it'):
        write_recording(scene, path)


def test_rerun_reads_what_was_written(scene: Scene, tmp_path: Path) -> None:
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    path = tmp_path / 'scene.rrd'
    write_recording(replace(scene, title=os.fsdecode(b'walk\xff.npz')), path)
    run_rerun(tmp_path, 'rrd', 'verify', str(path))
    rows = count_rows(tmp_path, path)
    frames = len(scene.stamps_ns)
    static = 1  # the row of what does not change
    assert rows['world/people/anna/joints'] == frames + static
    assert rows['world/people/_b_en/joints'] == frames // 2 + static
    assert rows['world/people/anna/deviation'] == frames + static
    assert rows['world/camera/people/anna'] == frames + static
    assert rows['world/camera/input/0_0'] == frames + static
    assert rows['world/camera/input/0_1'] == frames // 2 + static
    assert rows['curves/residual/anna'] == frames + static
    assert rows['states/anna/motion'] == 1 + static
    assert rows['states/_b_en/detection'] == 2 + static
    assert rows['marks'] == len(scene.marks)


def test_a_live_drawing_shows_no_detection_longer_than_its_frame(scene: Scene, tmp_path: Path) -> None:
    rerun = pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    recording = rerun.RecordingStream('test', send_properties=False)
    recording.save(tmp_path / 'live.rrd')
    drawing = LiveDrawing(recording)
    for frame, detections in enumerate((2, 2, 1, 1, 0, 0)):
        points = np.full((detections, 15, 2), 100, np.float32)
        keypoints = SceneKeypoints(CMU15, np.zeros(detections, int), points)
        drawing.draw(replace(scene, people=(), keypoints=(keypoints,) if detections else ()), frame / 30)
    recording.flush()
    recording.disconnect()
    rows = count_rows(tmp_path, tmp_path / 'live.rrd')
    static, end = 1, 1  # the row of what does not change, and the one that ends the last detection
    assert rows['world/camera/input/0_0'] == 4 + static + end
    assert rows['world/camera/input/0_1'] == 2 + static + end


def test_a_live_drawing_forgets_those_who_are_gone_and_has_every_curve(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At first neither motion nor cadence of anybody is known."""
    monkeypatch.setattr(rerun_recording, 'import_rerun', MagicMock)
    layouts: list[Scene] = []
    monkeypatch.setattr(rerun_recording, 'build_blueprint', lambda shown, _: layouts.append(shown))
    drawing = LiveDrawing(MagicMock())
    for frame in range(100):
        person = make_scene_person(f'person_{frame}', range(1), (0.0, 0.0, 4.0))
        unknown = replace(person, motion=np.zeros(1, np.uint8), cadence=np.full(1, np.nan, np.float32))
        drawing.draw(replace(scene, people=(unknown,), keypoints=(), marks=()), frame / 30)
    assert all(layout.has_motion and np.isfinite(layout.people[-1].cadence).all() for layout in layouts)
    assert layouts[-1].people[-1].id == 'person_99'
    assert len(layouts) == 100
    assert max(len(layout.people) for layout in layouts) == rerun_recording.MAX_LIVE_PEOPLE


def test_telemetry_is_off_in_settings_of_our_own(tmp_path: Path) -> None:
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    environment = disable_telemetry(tmp_path)
    (settings,) = tmp_path.rglob('analytics.json')
    assert json.loads(settings.read_text(encoding='utf-8'))['analytics_enabled'] is False
    assert environment == {'XDG_CONFIG_HOME': str(tmp_path)}


@pytest.mark.slow
def test_the_viewer_draws_the_recording_and_listens_to_this_machine_only(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    if not shutil.which('Xvfb') or not list(Path('/usr/share/vulkan/icd.d').glob('lvp_icd*')):
        pytest.skip('Xvfb or the software Vulkan driver of mesa is not installed')
    picture = tmp_path / 'picture.png'
    write_recording(scene, tmp_path / 'scene.rrd', 'paused')
    with open_display() as display:
        monkeypatch.setenv('DISPLAY', display)
        options = ('--window-size', '900x600', '--screenshot-to', str(picture))
        with start_viewer(tmp_path / 'scene.rrd', options=options) as (viewer, address):
            port = int(address.rpartition(':')[2].partition('/')[0])
            addresses = read_listening_addresses(port)
            assert viewer.wait(PHOTOGRAPH_TIMEOUT_S) == 0
    assert addresses == {'127.0.0.1'}
    assert count_colours(picture.read_bytes()) > 500


def read_listening_addresses(port: int) -> set[str]:
    """Return the addresses at which programs of this machine listen on a port."""
    found = set()
    for line in Path('/proc/net/tcp').read_text(encoding='ascii').splitlines()[1:]:
        _, local, _, state, *_ = line.split()
        address, hex_port = local.split(':')
        if state == '0A' and int(hex_port, 16) == port:
            found.add('.'.join(str(byte) for byte in reversed(bytes.fromhex(address))))
    return found
