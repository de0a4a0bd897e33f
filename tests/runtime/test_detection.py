# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From a video to people: their times, their names, and where a detector jumps to another person."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mocap_ros.config import NodeConfig
from mocap_ros.detectors.detector import Image
from mocap_ros.errors import InputError, ModelError
from mocap_ros.formats.detections import Detections, Video, create_person
from mocap_ros.formats.video import VideoImage
from mocap_ros.runtime import detection
from mocap_ros.runtime.detection import detect_in_video, name_people
from mocap_ros.runtime.load_keypoints import InputOptions, load_input
from tests.support.blob_people import draw, save_movenet, walk, write_video

if TYPE_CHECKING:
    from typing_extensions import Self

FRAMES = 12
STEP_NS = 40_000_000


def at(shift_px: Sequence[float | None]) -> Detections:
    """Return detections of one person or of none, moved to the right by so many px in each frame."""
    points = np.nan_to_num(walk(1)[0], nan=300.0)
    keypoints = np.column_stack([points, np.full(len(points), 0.9)])
    people = [[] if shift is None else [create_person(keypoints + [shift, 0, 0])] for shift in shift_px]
    return Detections(people, [STEP_NS * i for i in range(len(people))], (640, 480))


def test_a_video_of_two_people_in_turn_gives_one_of_them_and_a_warning(tmp_path: Path) -> None:
    here, there = walk(FRAMES) - [200.0, 0.0], walk(FRAMES) + [180.0, 10.0]
    images = [draw([person]) for person in (*here, *there[:5])]
    path = write_video(tmp_path / 'two.mkv', images, [i / 25 for i in range(len(images))])
    model = save_movenet(tmp_path / 'movenet.onnx')
    sequence, lines = load_input(path, InputOptions(Video(detector=model), NodeConfig()))
    assert len(sequence) == FRAMES
    assert np.nanmax(sequence.keypoints[..., 0]) < 320
    assert 'choose by --person: person_1 (12), person_2 (5)' in lines[0]
    assert 'at 0.48 s from person_1 to person_2' in lines[2]
    other, _ = load_input(path, InputOptions(Video(detector=model), NodeConfig(), 'person_2'))
    assert len(other) == 5


@pytest.mark.parametrize(
    ('shift_px', 'names', 'changes'),
    [
        ([0, 5, 10, 15], '1111', 0),
        ([0, 5, 300, 305, 310, 12], '112221', 2),
        ([0, None, None, 3], '1..1', 0),
        ([0, 400, 0], '121', 2),
        ([0] + [None] * 100 + [400, 405], '1' + '.' * 100 + '22', 1),  # 4 s later
    ],
)
def test_people_in_turn_are_distinguished(shift_px: list[float | None], names: str, changes: int) -> None:
    named, lines = name_people(at(shift_px))
    assert ''.join(people[0].id.removeprefix('person_') if people else '.' for people in named.people) == names
    assert sum(line.count(' from ') for line in lines) == changes


class BreakingCamera:
    """Images of a walker, and then an end of them that a camera may have."""

    image_count = None
    left_out = 0
    focal_mm = None
    images: Sequence[Image] = ()
    error: InputError | None = None

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __enter__(self) -> 'Self':
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[VideoImage]:
        yield from (VideoImage(image, i / 25) for i, image in enumerate(self.images))
        if self.error is not None:
            raise self.error


@pytest.mark.parametrize(
    ('fault', 'reason'),
    [
        ('unplugged', r'the camera has gone'),
        ('resized', r'the size of the images changes .* at 0\.240 s'),
    ],
)
def test_what_a_camera_showed_is_kept_when_it_breaks_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, reason: str
) -> None:
    path, model = Path('/dev/video0'), save_movenet(tmp_path / 'movenet.onnx')
    seen = [draw([person]) for person in walk(6)]
    further = {'unplugged': [], 'resized': [seen[0][::2, ::2]]}

    monkeypatch.setattr(detection, 'VideoReader', BreakingCamera)
    monkeypatch.setattr(BreakingCamera, 'images', [*seen, *further[fault]])
    monkeypatch.setattr(
        BreakingCamera, 'error', InputError('the camera has gone') if fault == 'unplugged' else None
    )
    found = detect_in_video(path, model, is_camera=True)
    assert [[person.id for person in people] for people in found.people] == [['person_1']] * 6
    assert found.stamps_ns == [STEP_NS * i for i in range(6)]
    assert re.search(f'ended early: .*{reason}', found.notes[1])
    with pytest.raises(InputError, match=reason):
        detect_in_video(path, model)
    monkeypatch.setattr(BreakingCamera, 'images', [draw([])] * 6 + further[fault])
    with pytest.raises(InputError, match=reason):
        detect_in_video(path, model, is_camera=True)


def test_an_empty_video_and_wrong_files_are_named(tmp_path: Path) -> None:
    empty = write_video(tmp_path / 'empty.mkv', [draw([])] * 3, [0.0, 0.1, 0.2])
    model = save_movenet(tmp_path / 'movenet.onnx')
    with pytest.raises(InputError, match=r'empty\.mkv: no person is seen in any image \(3 images, MoveNet'):
        detect_in_video(empty, model)
    with pytest.raises(ModelError, match=r'none\.onnx: no such file'):
        detect_in_video(empty, tmp_path / 'none.onnx')
    with pytest.raises(InputError, match=r'empty\.mkv: is a video, to which --fps does not apply'):
        load_input(empty, InputOptions(Video(fps=30.0, detector=model), NodeConfig()))
    (tmp_path / 'a.json').write_text('[]')
    with pytest.raises(InputError, match=r'a\.json: is a JSON file, to which --detector does not apply'):
        load_input(tmp_path / 'a.json', InputOptions(Video(fps=30.0, detector=model), NodeConfig()))
