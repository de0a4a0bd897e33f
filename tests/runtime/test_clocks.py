# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Clocks that jump, stand still or are another's: a line names the gap, and no export invents motion in it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.cli.main import main
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.sequence_file import KeypointSequence, save_sequence
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.offline.whole_sequence import find_frames_in_sight
from mocap_ros.runtime.load_keypoints import InputOptions, load_input
from mocap_ros.runtime.pipeline import Pipeline
from tests.support.keypoint_files import FRAMES, LIMITS, make_walker

NOW_NS, STEP_NS, HOUR_NS = 1_760_000_000_000_000_000, 40_000_000, 3_600_000_000_000
REGULAR = [NOW_NS + i * STEP_NS for i in range(FRAMES)]
QUICK = ['--model', 'walk', '--set', 'solver.max_iterations=2']
QUICKLY = {'tracker.model': 'walk', 'tracker.components': 8, 'tracker.iterations': 1, 'node.camera_info_wait': 0.0}
CONFIG = with_values(Config(), QUICKLY)
Edit = Callable[[int, int], int]  # the stamp of an image, of its number and its time in ns


def encode_image(number: int, stamp_ns: int) -> bytes:
    return encode_keypoints(Header(stamp_ns, 'cam'), (640, 480), [make_walker().person(number, 'anna')])


def write_bag(folder: Path, edit: Edit) -> Path:
    with Recorder(folder, RecorderConfig(min_free_mb=0)) as recorder:
        for number, time_ns in enumerate(REGULAR):
            stamp_ns = edit(number, time_ns)
            recorder.write('/k', KEYPOINTS, encode_image(number, stamp_ns), time_ns, stamp_ns)
    return folder


@pytest.mark.parametrize(
    ('edit', 'frames', 'line'),
    [
        (lambda _, t: t, FRAMES, ''),
        (lambda _, t: t - NOW_NS, FRAMES, 'stamps are 1760000000.0 s before the times of receipt'),
        (lambda _, t: t + HOUR_NS, FRAMES, 'stamps are 3600.0 s after the times of receipt'),
        (lambda n, t: t + HOUR_NS * (n >= 25), FRAMES, r'gap of 3600\.0 s after frame 24 \(at 0\.96 s\)'),
        (lambda n, t: t + 5 * STEP_NS * (n >= 25), FRAMES, ''),
        (lambda n, t: t - HOUR_NS * (n >= 25), 25, r'message 26: the stamp goes back by 3600\.0 s; of 2 runs'),
        (lambda n, t: t - 20 * STEP_NS * (n >= 25), 25, '15 messages left out'),  # the same stamps again
        (lambda n, t: t - 27 * STEP_NS * (n >= 28), 28, r'goes back by 1\.0 s; of 2 runs'),
        (lambda n, t: t * (n % 8 > 0), FRAMES - 5, '5 messages left out; .*header.stamp is not set'),
    ],
)  # fmt: skip
def test_a_line_says_what_the_clock_of_a_bag_did(tmp_path: Path, edit: Edit, frames: int, line: str) -> None:
    sequence, lines = load_input(write_bag(tmp_path / 'bag', edit), InputOptions(Video(), LIMITS))
    assert (sequence.keypoints[..., 2] > 0).any(axis=1).sum() in (frames, frames + 1)
    assert len(lines) == 1 + bool(line)
    if line:
        assert any(re.search(line, text) for text in lines)


@pytest.mark.parametrize(
    ('edit', 'reason'),
    [
        (lambda _, t: t * 0, 'header.stamp is not set'),
        (lambda n, t: t - (n % 2) * HOUR_NS, 'message 2: the stamp goes back by 3600.0 s; of 21 runs'),
    ],
)
def test_a_bag_without_a_clock_is_refused(tmp_path: Path, edit: Edit, reason: str) -> None:
    with pytest.raises(InputError, match=re.escape(reason)):
        load_input(write_bag(tmp_path / 'bag', edit), InputOptions(Video(), LIMITS))


@pytest.mark.parametrize('jump_s', [-3600.0, 3600.0, 30.0])
def test_the_live_pipeline_names_a_jump_once(jump_s: float) -> None:
    pipeline = Pipeline(CONFIG)
    stamps = [t + round(jump_s * 1e9) * (n >= 5) for n, t in enumerate(REGULAR[:10])]
    results = [pipeline.feed(Source.KEYPOINTS, encode_image(n, t)) for n, t in enumerate(stamps)]
    assert [n for n, result in enumerate(results) if 'the ' in result.reason and ' s' in result.reason] == [5]
    expected = 'went back by 3600.0 s' if jump_s < 0 else f'gap of {jump_s:.1f} s before this stamp'
    assert expected in results[5].reason
    assert pipeline.counters.accepted == 10


def reconstruct(folder: Path, sequence: KeypointSequence, gap_s: float, *suffixes: str) -> int:
    times = np.where(np.arange(FRAMES) < 20, 0.0, gap_s) + sequence.timestamps
    save_sequence(folder / 'in.npz', KeypointSequence(sequence.keypoints, sequence.joint_names, times, (640, 480)))
    outputs = [word for suffix in suffixes for word in ('-o', str(folder / f'out{suffix}'))]
    return main(['reconstruct', str(folder / 'in.npz'), *outputs, *QUICK])


@pytest.mark.parametrize(('suffix', 'gap_s'), [('.trc', 3600.0), ('.bvh', 3600.0), ('.trc', 70.0), ('.bvh', 15.0)])
def test_no_hour_is_invented(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str, gap_s: float
) -> None:
    assert reconstruct(tmp_path, make_walker(), gap_s, suffix) == 1
    assert f'a gap of {gap_s:.1f} s after 0.6 s' in capsys.readouterr().err
    assert not (tmp_path / f'out{suffix}').exists()


def test_a_gap_is_empty_in_files_of_a_constant_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert reconstruct(tmp_path, make_walker(), 5.0, '.trc', '.csv', '.npz') == 0
    assert 'a gap of 5.0 s after frame 19' in capsys.readouterr().err
    rows = [line.split('\t') for line in (tmp_path / 'out.trc').read_text().splitlines()[6:]]
    filled = [any(cell.strip() for cell in row[2:]) for row in rows]
    assert (filled.count(True), len(rows)) == (FRAMES, FRAMES + 150)
    assert len((tmp_path / 'out.csv').read_text().splitlines()) == 1 + FRAMES
    assert len(np.load(tmp_path / 'out.npz')['joints3d']) == FRAMES


def test_frames_in_a_long_gap_of_a_person_are_out_of_sight() -> None:
    seen = np.zeros((300, 15), bool)
    seen[[5, 20, 200, 210], 3] = True
    expected = np.isin(np.arange(300), [*range(5, 21), *range(200, 211)])
    np.testing.assert_array_equal(find_frames_in_sight(seen, np.arange(300) / 30), expected)


def test_times_since_1970_are_seconds_with_six_digits(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', lambda n, t: t + n * 1000)
    assert main(['reconstruct', str(bag), '-o', str(tmp_path / 'out.csv'), *QUICK]) == 0
    times = [line.split(',')[0] for line in (tmp_path / 'out.csv').read_text().splitlines()[1:]]
    assert times == [f'1760000000.{40_001 * n % 1_000_000:06d}' for n in range(25)] + times[25:]
