# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Networks of the forms of YOLO-pose, RTMPose and MoveNet find people of blobs, and MediaPipe a real one."""

import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from mocap_ros.detectors import detector
from mocap_ros.detectors.detector import load_detector
from mocap_ros.detectors.regions import Box, cut_out
from mocap_ros.errors import ModelError
from mocap_ros.skeleton import keypoint_layout
from tests.support import blob_people
from tests.support.blob_people import COLOURS, SIZE, draw, walk

# The numbers that the networks take for the numbers c = 0 to 255 of a picture are (c - mean) / std.
NETWORKS = {
    'pose_detector.tflite': ('pose_detection/pose_detection.tflite', 127.5, 127.5),
    'pose_landmarks_detector.tflite': ('pose_landmark/pose_landmark_full.tflite', 0.0, 255.0),
}


def require_mediapipe() -> Any:
    """Return the module `mediapipe`, or skip the test where it is missing or has no model."""
    mediapipe = pytest.importorskip('mediapipe', reason="needs MediaPipe: pip install -e '.[mediapipe]'")
    if not hasattr(mediapipe, 'solutions'):
        pytest.skip(f'MediaPipe {mediapipe.__version__} has no model; needs 0.10.21')
    return mediapipe


def save_task(path: Path) -> Path:
    """Write the networks that come with MediaPipe as a model bundle of the Tasks API."""
    modules = Path(require_mediapipe().__file__).parent / 'modules'
    from mediapipe.tasks.python.metadata.metadata_writers import metadata_writer

    with zipfile.ZipFile(path, 'w') as bundle:
        for name, (source, mean, std) in NETWORKS.items():
            writer = metadata_writer.MetadataWriter.create(bytearray((modules / source).read_bytes()))
            writer.add_image_input(norm_mean=[mean], norm_std=[std])
            bundle.writestr(name, bytes(writer.populate()[0]))
    return path


def load_portrait() -> np.ndarray:
    """Return the portrait (600, 512, 3) of Grace Hopper that comes with matplotlib, seen down to the chest."""
    path = Path(mpl.get_data_path()) / 'sample_data' / 'grace_hopper.jpg'
    return np.asarray(Image.open(path).convert('RGB'))


FRAMES = 12
SAVE_SINGLE: dict[str, Callable[[Path], Path]] = {
    'rtmpose': blob_people.save_rtmpose,
    'movenet': blob_people.save_movenet,
}
SAVE_SEVERAL: dict[str, Callable[[Path], Path]] = {
    'movenet': blob_people.save_multi_pose_movenet,
    'yolo11': blob_people.save_yolo_pose,
    'yolo26': partial(blob_people.save_yolo_pose, one_each=True),
}


@pytest.fixture(autouse=True)
def finder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Find people of blobs, which the network that ships does not."""
    monkeypatch.setattr(detector, 'FINDER', blob_people.save_multi_pose_movenet(tmp_path / 'finder.onnx'))


@pytest.fixture(params=SAVE_SINGLE)
def model(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return SAVE_SINGLE[request.param](tmp_path / 'model.onnx')


def check_found(found: np.ndarray, person: np.ndarray, tolerance_px: float) -> None:
    """Check that the keypoints (17, 3) found are those of a person (17, 2), except what another blob hides."""
    drawn = np.isfinite(person[:, 0])
    assert (found[~drawn, 2] < 0.2).all()
    seen = drawn & (found[:, 2] > 0.5)
    assert seen.sum() >= drawn.sum() - 3
    errors = np.linalg.norm(found[seen, :2] - person[seen], axis=1)
    assert np.median(errors) < tolerance_px
    assert errors.max() < 6.0


def test_a_walker_is_followed(model: Path) -> None:
    found_by = load_detector(model)
    errors = []
    for frame, person in enumerate(walk(FRAMES)):
        (found,) = found_by.detect(draw([person]), frame / 30)
        check_found(found, person, 1.0)
        assert found[:, 2].max() <= 1.0
        seen = (found[:, 2] > 0.5) & np.isfinite(person[:, 0])
        errors.append((found[:, :2] - person)[seen].mean(axis=0))
    assert np.mean(errors, axis=0) == pytest.approx([0.0, 0.0], abs=0.3)  # no constant shift


@pytest.mark.parametrize(
    'box', [Box(20.4, 10.2, 90.7, 70.3), Box(-30.6, -20.3, 300.0, 200.0), Box(230, 20, 60, 60)]
)
@pytest.mark.parametrize('size', [(24, 32), (192, 192)])
def test_a_rectangle_is_cut_out_where_it_is(box: Box, size: tuple[int, int]) -> None:
    """Of an image whose red is x and green y, a pixel has the place of its centre."""
    y, x = np.mgrid[:120, :250]
    part = cut_out(np.stack([x, y, 0 * x], axis=-1).astype(np.uint8), box, size, ground=255).astype(float)
    shares = np.stack(np.meshgrid(*((np.arange(side) + 0.5) / side for side in size)), axis=-1)
    place = box.place(shares)
    pixel = np.array(box[2:]) / size
    margin = 1.5 * pixel + 1  # px, in which the edge of the image shows
    inside = ((place > margin) & (place < [250, 120] - margin)).all(axis=-1)
    assert inside.any()
    assert (np.abs(part[..., :2] - (place - 0.5))[inside] < 0.5 + 0.35 * pixel).all()
    assert (part[((place < -margin) | (place > [250, 120] + margin)).any(axis=-1)] == 255).all()


def test_movenet_sees_a_person_in_the_first_image_as_closely_as_in_the_next(tmp_path: Path) -> None:
    person = walk(1)[0] + [300.0, 300.0]
    drawn, image = np.isfinite(person[:, 0]), draw([person], (1280, 960), 10)
    found_by = load_detector(blob_people.save_movenet(tmp_path / 'model.onnx'))
    (first,), (second,) = (found_by.detect(image, time_s) for time_s in (0.0, 0.1))
    assert first[drawn] == pytest.approx(second[drawn], abs=0.5)


def test_a_small_person_at_the_edge_is_found_and_then_seen_larger(model: Path) -> None:
    person = walk(1)[0]
    person = (person - person[0]) * 0.9 + [40.0, 60.0]  # partly outside of the image
    found_by = load_detector(model)
    for time_s in (0.0, 0.1):
        (found,) = found_by.detect(draw([person]), time_s)
        check_found(found, np.where((person > 0).all(axis=1, keepdims=True), person, np.nan), 1.5)


def test_nobody_is_seen_in_empty_images_and_somebody_who_comes_back_is_seen(model: Path) -> None:
    found_by = load_detector(model)
    person = walk(1)[0]
    empty, full = draw([]), draw([person])
    counts = [len(found_by.detect(image, t)) for t, image in enumerate([empty, full, empty, empty, full])]
    assert counts == [0, 1, 0, 0, 1]
    moved = draw([person + [200.0, 20.0]])  # beyond the region in which the person is expected
    (found,) = found_by.detect(moved, 6.0)
    check_found(found, person + [200.0, 20.0], 1.0)


@pytest.mark.parametrize('save', SAVE_SEVERAL.values(), ids=SAVE_SEVERAL)
def test_a_model_for_several_people_finds_each(tmp_path: Path, save: Callable[[Path], Path]) -> None:
    model = save(tmp_path / 'multi.onnx')
    left, right = walk(1)[0] - [150.0, 0.0], walk(1)[0] + [150.0, 0.0]
    image = draw([left, right])
    found_by = load_detector(model, 6)
    found = found_by.detect(image, 0.0)
    assert len(found) == 2
    for person, keypoints in zip((left, right), sorted(found, key=lambda p: float(p[0, 0])), strict=True):
        check_found(keypoints, person, 1.0)
    assert len(load_detector(model, 1).detect(image, 0.0)) == 1
    assert len(found_by.detect(draw([]), 1.0)) == 0


@pytest.mark.parametrize(('width', 'height'), [(64, 480), (1920, 64), (1, 1)])
def test_images_of_any_shape_are_taken(model: Path, width: int, height: int) -> None:
    assert len(load_detector(model).detect(np.zeros((height, width, 3), np.uint8), 0.0)) == 0


@pytest.mark.filterwarnings('error')
def test_a_person_of_one_point_breaks_nothing(model: Path) -> None:
    found_by = load_detector(model)
    image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    for index, colour in enumerate(COLOURS):
        image[240, 300 + index] = colour
    for time_s in range(3):
        assert np.isfinite(found_by.detect(image, time_s)).all()


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('other.onnx', r'gives arrays of the form \(1, 3, 8, 8\); expected '),
        ('flat.onnx', 'takes .*, expected one image'),
        ('none.onnx', 'no such file; expected MediaPipe'),
        ('text.onnx', r'no ONNX model \(.+\)'),
        ('text.h5', 'unknown file type; expected MediaPipe'),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path: Path, name: str, reason: str) -> None:
    pytest.importorskip('onnxruntime')
    for shape, file in (([1, 3, 8, 8], 'other.onnx'), ([1, 3], 'flat.onnx')):
        graph = blob_people.Graph()
        graph.save(tmp_path / file, shape, 'FLOAT', [graph.add('Relu', 'image')])
    for file in ('text.onnx', 'text.h5'):
        (tmp_path / file).write_text('no model')
    with pytest.raises(ModelError, match=reason) as raised:
        load_detector(tmp_path / name)
    assert str(raised.value).startswith(f'{tmp_path / name}: ')


# px, read off the portrait by eye; left and right are those of the person
LANDMARKS = {
    'nose': (270, 225),
    'leye': (305, 190),
    'reye': (230, 196),
    'lshoulder': (455, 428),
    'rshoulder': (96, 423),
}


@pytest.mark.parametrize('is_shipped', [True, False])
def test_a_real_person_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_shipped: bool) -> None:
    if is_shipped:
        monkeypatch.setattr(detector, 'FINDER', detector.SHIPPED / 'movenet_multipose.onnx')
    found_by = load_detector(None if is_shipped else save_task(tmp_path / 'pose.task'))
    layout, image = keypoint_layout('coco17' if is_shipped else 'mediapipe33'), load_portrait()
    try:
        assert len(found_by.detect(np.zeros_like(image), 0.0)) == 0
        for time_s in (1.0, 1.0001, 1.0002):  # less than the millisecond that MediaPipe counts by
            (person,) = found_by.detect(image, time_s)
    finally:
        found_by.close()
    for name, point in LANDMARKS.items():
        found = person[layout.index(name)]
        assert found[:2] == pytest.approx(point, abs=20 if is_shipped else 12), name
        assert found[2] > (0.4 if is_shipped else 0.9)
    assert person[layout.index('lankle'), 2] < 0.5  # below the picture


def test_several_people_are_followed_one_by_one(model: Path) -> None:
    found_by = load_detector(model, 3)
    for frame, person in enumerate(walk(FRAMES)):
        shift = [150.0 - 5 * frame, 0.0]
        people = [person - shift] if frame < 3 else [person - shift, person + shift]  # one comes later
        found = found_by.detect(draw(people), frame / 5)
        assert len(found) == (1 if frame < 3 else 2)
        for expected, keypoints in zip(people, sorted(found, key=lambda p: float(p[0, 0])), strict=True):
            check_found(keypoints, expected, 1.5)


def test_a_file_that_is_no_bundle_is_refused_in_one_line(tmp_path: Path) -> None:
    require_mediapipe()
    (tmp_path / 'pose.task').write_bytes(b'no model')
    with pytest.raises(ModelError, match=r'pose\.task: no model of the pose landmarker \(.+\)$'):
        load_detector(tmp_path / 'pose.task')
