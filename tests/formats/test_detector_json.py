# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""JSON of detectors: every form gives the same people, others are refused by their place."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Detections, associate_people, select_person
from mocap_ros.formats.detector_json import MIN_PERSON_SCORE, load_json_file, load_json_folder
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.recordings.load_keypoints import load_input
from mocap_ros.skeleton import keypoint_layout
from tests.support.input_files import FPS, FRAMES, VIDEO, check_same_keypoints, flatten_keypoints, make_walker

COCO17 = keypoint_layout('coco17').joints
BODY = [100.0, 100.0, 0.9] * 25
Frames = list[list[float]]  # x, y, score of each joint, in each frame

WALKER = make_walker()
DOG = {'image_id': 0, 'category_id': 18, 'keypoints': [50.0, 60.0, 0.9] * 17, 'score': 0.9}
PERSON = {**DOG, 'category_id': 1}


def write_folder(folder: Path, contents: dict[str, Any]) -> Path:
    for name, content in contents.items():
        (folder / name).write_text(json.dumps(content))
    return folder


def load(path: Path, content: Any, video: ReadingOptions = VIDEO) -> Detections:
    (path / 'people.json').write_text(json.dumps(content))
    return load_json_file(path / 'people.json', video)


def split(keypoints: list[float]) -> dict[str, Any]:
    """Return a person as MMPose writes it."""
    points = np.reshape(keypoints, (-1, 3))
    return {'keypoints': points[:, :2].tolist(), 'keypoint_scores': points[:, 2].tolist(), 'bbox_score': 0.9}


def make_yolo_person(keypoints: list[float], **fields: Any) -> dict[str, Any]:
    """Return a person as YOLO's `to_json` writes it."""
    x, y, visible = keypoints[::3], keypoints[1::3], keypoints[2::3]
    return {'name': 'person', 'confidence': 0.8, 'keypoints': {'x': x, 'y': y, 'visible': visible}, **fields}


LONG_NAMES = [n.replace('l', 'left_', 1) if n[0] == 'l' else n.replace('r', 'right_', 1) for n in COCO17]


def name_points(keypoints: list[float], label: str, score: str) -> list[dict[str, Any]]:
    """Return the seen keypoints with the names of their joints, under the key `label`, in another order."""
    points = zip(LONG_NAMES, np.reshape(keypoints, (-1, 3)).tolist(), strict=True)
    named = [{'x': x, 'y': y, score: s, label: name} for name, (x, y, s) in points if s > 0]
    return sorted(named, key=lambda point: point[label])


def make_vitpose_person(keypoints: list[float], score: str = 'scores') -> dict[str, Any]:
    """Return the seen keypoints of a person as ViTPose of Hugging Face gives them with a threshold."""
    points = np.reshape(keypoints, (-1, 3))
    seen = np.flatnonzero(points[:, 2] > 0)
    columns = {'keypoints': points[seen, :2].tolist(), score: points[seen, 2].tolist(), 'labels': seen.tolist()}
    return {**columns, 'bbox': [1, 2, 3, 4]}


def make_roboflow_person(keypoints: list[float], **fields: Any) -> dict[str, Any]:
    """Return a person as Roboflow's inference writes one, whose list is filled up with keypoints without names."""
    filler = {'x': 0.0, 'y': 0.0, 'confidence': 0.0, 'class': '', 'class_id': 0}
    points = [*name_points(keypoints, 'class', 'confidence'), filler, filler]
    box = {'x': 9.0, 'y': 9.0, 'width': 5.0, 'height': 9.0, 'confidence': 0.9, 'detection_id': 'a'}
    return {'keypoints': points, 'class': 'person', 'class_id': 0, **box, **fields}


def make_ml5_person(keypoints: list[float]) -> dict[str, Any]:
    points = name_points(keypoints, 'name', 'confidence')
    by_name = {p['name']: {'x': p['x'], 'y': p['y'], 'confidence': p['confidence']} for p in points}
    return {'keypoints': points, 'box': {'xMin': 1}, 'id': 1, 'confidence': 0.9, 'keypoints3D': [], **by_name}


def set_unseen(keypoints: list[float], point: tuple[float, float], score: float | None) -> list[float]:
    """Return keypoints of which those that are not seen are at a point, with a score or as it is."""
    points = np.reshape(keypoints, (-1, 3)).copy()
    unseen = points[:, 2] == 0
    points[unseen, :2] = point
    points[unseen, 2] = 0 if score is None else score
    return points.ravel().tolist()


def make_annotations(frames: Frames) -> dict[str, Any]:
    """Return COCO annotations of people and a dog, with image ids in reverse order."""
    size = {'width': 640, 'height': 480}
    images = [{'id': 900 - f, 'file_name': f'cam1/{f:05d}.png', **size} for f in range(len(frames))]
    names = [n.replace('l', 'left_', 1) if n[0] == 'l' else n for n in COCO17]
    people = [{'image_id': 900 - f, 'category_id': 7, 'keypoints': k} for f, k in enumerate(frames)]
    dog, person = {'id': 18, 'name': 'dog', 'keypoints': ['nose']}, {'id': 7, 'name': 'person', 'keypoints': names}
    return {'images': images, 'categories': [dog, person], 'annotations': [{**DOG, 'image_id': 900}, *people]}


FORMS: dict[str, Callable[[Frames], Any]] = {
    'COCO results with a dog': lambda k: [
        DOG, *({**PERSON, 'image_id': i, 'keypoints': p} for i, p in enumerate(k))
    ],
    'COCO annotations': make_annotations,
    'AlphaPose': lambda k: [
        {'image_id': f'{i}.jpg', 'category_id': 1, 'keypoints': p, 'score': 2.9, 'idx': [3.0]}
        for i, p in enumerate(k)
    ],
    'AlphaPose --format open': lambda k: {
        f'{i}.jpg': {'people': [{'pose_keypoints_2d': p}]} for i, p in enumerate(k)
    },
    'AlphaPose --format cmu': lambda k: {f'{i}.jpg': {'bodies': [{'joints': p}]} for i, p in enumerate(k)},
    'MMPose': lambda k: [{'frame_id': f, 'instances': [split(p)]} for f, p in enumerate(k)],
    'MMPose, SimCC scores': lambda k: [
        {'frame_id': f, 'instances': [split((np.array(p) * ([1, 1, 7.3 / max(p[2::3])] * 17)).tolist())]}
        for f, p in enumerate(k)
    ],
    'YOLO to_json': lambda k: [[make_yolo_person(p)] for p in k],
    'YOLO with a dog and a sofa': lambda k: [
        [*(make_yolo_person(BODY[:51], name=name) for name in ('dog', 'sofa')), make_yolo_person(p)] for p in k
    ],
    'YOLO with zeroed points': lambda k: [[make_yolo_person(set_unseen(p, (0, 0), 0.4))] for p in k],
    'points at (-1, -1)': lambda k: [[make_yolo_person(set_unseen(p, (-1, -1), 0.9))] for p in k],
    'NaN points': lambda k: [[make_yolo_person(set_unseen(p, (np.nan, np.nan), 0.9))] for p in k],
    'NaN scores': lambda k: [[make_yolo_person(set_unseen(p, (30, 40), np.nan))] for p in k],
    'negative scores': lambda k: [[make_yolo_person(set_unseen(p, (30, 40), -0.7))] for p in k],
    'YOLO save_json with improbable people': lambda k: [
        *({'image_id': i, 'keypoints': p, 'score': 0.9} for i, p in enumerate(k)),
        *({'image_id': i, 'keypoints': p, 'score': 0.01} for i, p in enumerate(k)),
    ],
    'ViTPose': lambda k: [[make_vitpose_person(p)] for p in k],
    'torchvision': lambda k: [
        [{'keypoints': (np.reshape(p, (-1, 3)) * [1, 1, 0] + [0, 0, 1]).tolist(), 'keypoints_scores': p[2::3],
          'boxes': [1, 2, 3, 4], 'labels': 1, 'scores': 0.9, 'track_id': 5, 'area': 7.0}] for p in k
    ],
    'Roboflow with a dog': lambda k: [
        {'predictions': [make_roboflow_person(BODY[:51], **{'class': 'dog'}), make_roboflow_person(p)],
         'image': {'width': 640, 'height': 480}, 'frame_id': None} for p in k
    ],
    'ml5': lambda k: [[make_ml5_person(p)] for p in k],
    'PoseNet': lambda k: [
        [{'keypoints': [{'part': p['part'], 'position': p, 'score': p['score']} for p in q]}]
        for q in (name_points(p, 'part', 'score') for p in k)
    ],
    'by joint': lambda k: [[{'keypoints': {p['name']: p for p in name_points(q, 'name', 'score')}}] for q in k],
    'names beside the points': lambda k: [
        [{'keypoints': [[p['x'], p['y'], p['score']] for p in q], 'names': [p['name'] for p in q]}]
        for q in (name_points(p, 'name', 'score') for p in k)
    ],
    'tfjs': lambda k: [
        [{'keypoints': [{'x': x, 'y': y, 'score': s} for x, y, s in np.reshape(p, (-1, 3)).tolist()]}] for p in k
    ],
    'easy_ViTPose': lambda k: {
        'keypoints': [{'0': np.reshape(p, (-1, 3))[:, [1, 0, 2]].tolist()} for p in k],
        'skeleton': {str(i): name for i, name in enumerate(COCO17)},
    },
}  # fmt: skip
FOLDERS: dict[str, Callable[[Frames], dict[str, Any]]] = {
    'OpenPose': lambda k: {
        f'clip2_{f:012d}_keypoints.json': {'people': [{'person_id': [-1], 'pose_keypoints_2d': p}]}
        for f, p in enumerate(k)
    },
    'Pose2Sim': lambda k: {f'cam01_{f:06d}.json': {'people': [{'pose_keypoints_2d': p}]} for f, p in enumerate(k)},
    'AlphaPose sep-json': lambda k: {f'{f}.json': {'bodies': [{'joints': p}]} for f, p in enumerate(k)},
    'MMPoseInferencer': lambda k: {f'frame_{f}.json': [split(p)] for f, p in enumerate(k)},
    'result of MMPoseInferencer': lambda k: {f'{f}.json': {'predictions': [[split(p)]]} for f, p in enumerate(k)},
    'MMPoseInferencer of a video': lambda k: {'v.json': FORMS['MMPose'](k)},
    'YOLO to_json': lambda k: {f'img{f}_640x480.json': [make_yolo_person(p)] for f, p in enumerate(k)},
}  # fmt: skip


@pytest.mark.parametrize('form', FORMS)
def test_every_form_gives_the_same_keypoints(tmp_path: Path, form: str) -> None:
    detections = load(tmp_path, FORMS[form](flatten_keypoints(WALKER)))
    if 'SimCC' in form:
        sequence, _ = select_person(detections)
        expected = WALKER.keypoints[..., 2] / WALKER.keypoints[..., 2].max(axis=1, keepdims=True)
        assert sequence.keypoints[..., 2] == pytest.approx(expected)
    else:
        check_same_keypoints(detections, WALKER)
    assert [n.endswith('left out') for n in detections.notes] == [True] * ('dog' in form or 'annotations' in form)


@pytest.mark.parametrize(
    'key', ['keypoint_scores', 'keypoints_scores', 'confidence', 'keypoint_confidence', 'kpt_conf', 'visibility']
)
def test_scores_beside_the_keypoints_are_used(tmp_path: Path, key: str) -> None:
    content = [[make_vitpose_person(p, key)] for p in flatten_keypoints(WALKER)]
    check_same_keypoints(load(tmp_path, content), WALKER)


@pytest.mark.parametrize(
    ('person', 'named'),
    [
        ({'certainty': [0.5] * 17, 'scores': [0.5] * 3}, ["'certainty'", "'scores'"]),
        ({'keypoints': [{'x': 50.0 + i, 'y': 60.0, 'certainty': 1, 'class': f'k{i}'} for i in range(17)]},
         ["'certainty'", "'class'"]),
        ({'bbox': [1, 2, 3, 4], 'bbox_score': 0.9, 'labels': [1] * 17, 'trackId': 3, 'area': 9.0, 'class_id': 0,
          'num_keypoints': 17, 'pose_keypoints_3d': [], 'hand_left_keypoints_2d': []}, []),
    ],
)  # fmt: skip
def test_a_line_names_what_is_not_understood_beside_the_keypoints(
    tmp_path: Path, person: dict[str, Any], named: list[str]
) -> None:
    (tmp_path / '0.json').write_text(json.dumps({'people': [{'keypoints': BODY[:51], **person}] * 2}))
    notes = load_json_folder(tmp_path, VIDEO).notes
    assert [word for note in notes for word in re.findall("'[a-z]+'", note)] == named
    assert len(notes) == bool(named)


def test_frames_state_the_size_of_their_images(tmp_path: Path) -> None:
    content = FORMS['Roboflow with a dog'](flatten_keypoints(WALKER))
    assert load(tmp_path, content, ReadingOptions(fps=FPS)).image_size == (640, 480)
    write_folder(tmp_path, {f'{i}.json': frame for i, frame in enumerate(content)})
    (tmp_path / 'people.json').unlink()
    assert load_json_folder(tmp_path, ReadingOptions(fps=FPS)).image_size == (640, 480)


@pytest.mark.parametrize('tool', FOLDERS)
def test_every_folder_gives_the_same_keypoints(tmp_path: Path, tool: str) -> None:
    write_folder(tmp_path, FOLDERS[tool](flatten_keypoints(WALKER)))
    sequence, _ = load_input(tmp_path, VIDEO)
    assert sequence.keypoints == pytest.approx(WALKER.keypoints, nan_ok=True, abs=1e-4)


def test_images_whose_names_are_times_need_no_frame_rate(tmp_path: Path) -> None:
    names = [f'{1305031102 + f / FPS:.6f}.png' for f in range(FRAMES)]
    results = [{'image_id': n, 'keypoints': k} for n, k in zip(names, flatten_keypoints(WALKER), strict=True)]
    sequence, _ = select_person(load(tmp_path, results, ReadingOptions(image_size=(640, 480))))
    assert np.diff(sequence.timestamps) == pytest.approx(1 / FPS, abs=1e-5)
    assert sequence.timestamps[0] == 1305031102


@pytest.mark.parametrize('key', ['timestamp', 'timestamp_ms', 'timestamp_ns'])
@pytest.mark.parametrize('form', ['AlphaPose', 'MMPose', 'COCO annotations'])
def test_times_of_images_need_no_frame_rate(tmp_path: Path, form: str, key: str) -> None:
    """Every second image is there, so that the numbers of the images would give other times."""
    content, per_s = FORMS[form](flatten_keypoints(WALKER)), {'timestamp': 1, 'timestamp_ms': 1e3}.get(key, 1e9)
    images = content if isinstance(content, list) else content['images']
    for index, image in enumerate(images):
        image[key] = (7 + 2 * index / FPS) * per_s
    for video in (ReadingOptions(image_size=(640, 480)), VIDEO):
        sequence, lines = select_person(load(tmp_path, content, video))
        assert sequence.timestamps == pytest.approx(7 + 2 * np.arange(FRAMES) / FPS)
        assert any('--fps' in line for line in lines) == (video is VIDEO)
    images[0][key] = None
    check_same_keypoints(load(tmp_path, content), WALKER)


H36M = [
    'root', *(f'{s}_{j}' for s in ('right', 'left') for j in ('hip', 'knee', 'foot')), 'spine', 'thorax',
    'neck_base', 'head', *(f'{s}_{j}' for s in ('left', 'right') for j in ('shoulder', 'elbow', 'wrist')),
]  # fmt: skip
MPII = [
    *(f'right_{j}' for j in ('ankle', 'knee', 'hip')), *(f'left_{j}' for j in ('hip', 'knee', 'ankle')), 'pelvis',
    'thorax', 'upper_neck', 'head_top', *(f'right_{j}' for j in ('wrist', 'elbow', 'shoulder')),
    *(f'left_{j}' for j in ('shoulder', 'elbow', 'wrist')),
]  # fmt: skip
HALPE = [
    'nose', *(f'{"left" if n[0] == "l" else "right"}_{n[1:]}' for n in COCO17[1:]), 'head', 'neck', 'hip',
    *(f'{s}_{n}' for n in ('big_toe', 'small_toe', 'heel') for s in ('left', 'right')),
]  # fmt: skip
SWAPPED_COCO = [n.replace('left', '?').replace('right', 'left').replace('?', 'right') for n in HALPE[:17]]


@pytest.mark.parametrize(
    ('names', 'expected'),
    [
        (H36M, keypoint_layout('h36m17').joints),
        (HALPE, keypoint_layout('halpe26').joints),
        (MPII, ('rankle', 'rknee', 'rhip', 'lhip', 'lknee', 'lankle', 'pelvis', 'neck', 'upperneck', 'headtop')),
        (SWAPPED_COCO, ('nose', 'reye', 'leye', 'rear', 'lear', 'rshoulder', 'lshoulder')),
        ([f'left_hip {i}' if i == 1 else n for i, n in enumerate(H36M)], ('pelvis', 'lhip1', 'rknee', 'rankle')),
    ],
)
@pytest.mark.parametrize(
    'place', ['keypoint_id2name', 'keypoint_name2id', 'keypoint_info', 'categories', 'keypoint_names', 'person']
)
def test_the_file_names_joints(tmp_path: Path, place: str, names: list[str], expected: tuple[str, ...]) -> None:
    numbered = [[100.0 + i, 100.0, 0.9] for i in range(len(names))]
    person: dict[str, Any] = {'image_id': 0, 'category_id': 5, 'keypoints': numbered}
    content: Any = {'annotations': [person]}
    if place in ('keypoint_id2name', 'keypoint_name2id', 'keypoint_info'):
        by_index: dict[str, Any] = {str(i): n for i, n in enumerate(names)}
        if place == 'keypoint_name2id':
            by_index = {n: i for i, n in enumerate(names)}
        elif place == 'keypoint_info':
            by_index = {str(i): {'name': n, 'swap': ''} for i, n in enumerate(names)}
        content = {'meta_info': {place: by_index}, 'instance_info': [{'frame_id': 1, 'instances': [person]}]}
    elif place == 'categories':
        other = {'id': 1, 'name': 'person', 'keypoints': list(COCO17)}
        content['categories'] = [other, {'id': 5, 'name': 'person', 'keypoints': names}]
    elif place == 'keypoint_names':
        content['keypoint_names'] = names
    else:
        person['keypoint_names'] = names
    ((found,),) = load(tmp_path, content).people
    x_by_joint = dict(zip(found.joints, found.points[:, 0].tolist(), strict=True))
    assert [x_by_joint.get(joint, 101) for joint in expected] == [100 + i for i in range(len(expected))]


def test_an_id_that_two_people_of_one_frame_have_is_none(tmp_path: Path) -> None:
    """AlphaPose gives all people the id 0 if it does not track; the ids of a tracker are kept."""
    shape = np.stack([np.linspace(0, 30, 17), np.linspace(100, 200, 17), np.ones(17)], axis=1)
    people = [
        {'image_id': f'{f}.jpg', 'keypoints': (shape + [x, 0, 0]).ravel().tolist(), 'score': 2.9, 'idx': [idx]}
        for f in range(10)
        for x, idx in ((300, 0.0), (100 + f, 7.0), (500, 0.0))[: 3 if f < 9 else 1]
    ]
    detections = load(tmp_path, people)
    tracks = {track.id: track for track in associate_people(detections)[0]}
    counts = {name: len(track.detection_by_frame) for name, track in tracks.items()}
    assert counts == {'person_1': 10, 'person_2': 9, '7': 9}
    assert detections.notes[0].endswith(': 0')


def test_people_with_a_low_score_are_left_out(tmp_path: Path) -> None:
    scores = {100: MIN_PERSON_SCORE, 200: 0.99 * MIN_PERSON_SCORE, 300: 0.3}
    people = [{'image_id': 1, 'keypoints': [x, 50, 1] * 17, 'score': score} for x, score in scores.items()]
    ((first, second),) = load(tmp_path, people).people
    assert [first.points[0, 0], second.points[0, 0]] == [100, 300]


def test_annotations_give_size_and_visibility(tmp_path: Path) -> None:
    visibility = np.nan_to_num(WALKER.keypoints).copy()
    visibility[..., 2] = np.where(visibility[..., 2] > 0, 2, 0)
    visibility[3, 0, 2] = 1
    frames = visibility.reshape(FRAMES, -1).tolist()
    content = make_annotations(frames)
    del content['annotations'][0]
    sequence, _ = select_person(load(tmp_path, content, ReadingOptions(fps=FPS)))
    assert (sequence.image_size, sequence.joint_names) == ((640, 480), COCO17)
    assert set(np.unique(sequence.keypoints[..., 2])) == {0.0, 0.5, 1.0}


@pytest.mark.parametrize(
    ('given', 'person_id'),
    [({'person_id': ids}, name) for ids, name in (([3], '3'), ([0], '0'), ([-1], ''), ([3, 4], ''), (3, ''))]
    + [({'track_id': 5}, '5'), ({'track_id': 'anna', 'idx': 3}, 'anna'), ({'idx': [[3.0]]}, '3')]
    + [({'idx': 0}, '0'), ({'idx': 3.5}, ''), ({'idx': []}, ''), ({'idx': None}, ''), ({'id': 7}, '')],
)
def test_people_have_the_ids_of_a_tracker(tmp_path: Path, given: dict[str, Any], person_id: str) -> None:
    ((person,),) = load(tmp_path, [{'image_id': 1, 'keypoints': BODY[:51], **given}]).people
    assert person.id == person_id


def make_images(*images: dict[str, Any]) -> dict[str, Any]:
    return {'images': images, 'annotations': []}


def make_results(*keypoints: Any, **fields: Any) -> Any:
    return [{'image_id': i, 'keypoints': k, **fields} for i, k in enumerate(keypoints)]


LANDMARK = {'x': 0.5, 'y': 0.3, 'z': -0.1, 'visibility': 0.9}
POINTS_3D = [[0.1 * i - 0.8, 0.2, 0.9] for i in range(17)]


@pytest.mark.parametrize(
    ('content', 'place'),
    [
        (make_images({'id': 1, 'file_name': '7'}, {'id': 2, 'file_name': '7'}), r"images\[1\]: .* '7'"),
        (make_images({'id': 1, 'file_name': 'a/7.png'}, {'id': 2, 'file_name': 'b/7.png'}), 'cameras'),
        (make_images({'id': 1, 'width': 640, 'height': 480}, {'id': 2, 'width': 9, 'height': 9}), 'images: '),
        (make_images({'id': 1}, {'id': 2, 'width': 0, 'height': 480}), r'images\[1\]: expected id'),
        (make_images({'file_name': '1.png'}), r'images\[0\]: expected id'),
        ([{'frame_id': 1, 'instances': [3]}], r'\[0\]\.instances\[0\]: expected a person'),
        (b'{', 'not JSON'),
        (b'[' * 100_000, 'nested too deep'),
        (b'[' + b'9' * 5000 + b']', r'value has 5000 digits$'),
        (3, 'expected a list'),
        ({'a': 1}, 'neither annotations nor instance_info'),
        ({'people': []}, 'give its folder'),
        ([], 'no frames'),
        ([{'keypoints': [1, 2, 3]}], r'\[0\]: expected image_id'),
        ([{'image_id': True, 'keypoints': [1, 2, 3]}], r'\[0\]: expected image_id'),
        (make_results('abc'), r'\[0\]: keypoints: expected x, y, score'),
        (make_results(BODY[:51], [1, 2, 3, 4]), r'\[1\]: keypoints: expected x, y, score'),
        (make_results({'x': [[1]], 'y': [[1]], 'visible': [[1]]}), r'\[0\]: keypoints: expected x, y, score'),
        (make_results([1, 2, 1]), r'\[0\]: 1 keypoints: no layout known; .* --layout'),
        (make_results(BODY[:51], keypoint_names=HALPE), r'\[0\]: 17 keypoints, but names of 26'),
        (make_results([1e300] * 51), r'\[0\]: x of nose is 1e\+300'),
        (make_results([1.0, 2.0, 1e999] * 17), r'\[0\]: score of nose is inf'),
        (make_results([{'x': 1, 'y': 2, 'name': 'nose'}] * 17), r"\[0\]: keypoints: two are called 'nose'"),
        (make_results([[1, 2]] * 9, labels=[*range(9)]), r'\[0\]: 9 keypoints: no layout known'),
        ([{'predictions': [], 'image': {'width': 0, 'height': 1}}], 'image: expected width and height'),
        ([{'image_id': i, 'keypoints': BODY[:51]} for i in (1, 2, 10**9)], 'not one video of 25 Hz'),
        (make_results([0.5, 0.5, 1.0] * 17), 'looks normalised; px expected: multiply'),
        (make_results(np.ravel(POINTS_3D).tolist()), '3D joints in m; 2D'),
        (make_results(POINTS_3D, keypoint_scores=[0.8] * 17), '3D joints, .*2D'),
        (make_results([[1, 2, 3, 0.9]] * 17), '3D joints, .*2D'),
        ([[LANDMARK] * 33], 'landmarks of MediaPipe'),
        ([[[LANDMARK] * 33]], 'landmarks of MediaPipe'),
        ([{'frame': 1, 'pose_landmarks': [LANDMARK] * 33}], 'landmarks of MediaPipe'),
        ({'pose_landmarks': [[LANDMARK] * 33]}, 'landmarks of MediaPipe'),
        ([{'image_id': 1, 'category_id': 1, 'bbox': [1, 2, 3, 4], 'score': 0.9}], 'without keypoints, .*-pose'),
        ([[{'name': 'person', 'box': {'x1': 1}, 'confidence': 0.9}]], 'without keypoints, .*-pose'),
        (make_results(None, [], {}, {'x': [], 'y': [], 'visible': []}), '4 detections without keypoints'),
        (make_results([50.0, 60.0, 0.0] * 17), 'score of every keypoint is 0'),
        ({'categories': [{'id': 1, 'name': 'cat'}], 'annotations': [PERSON]}, 'no people'),
        ({'categories': [{'id': [1], 'name': 'person'}], 'annotations': [PERSON]}, 'categories: expected an id'),
        (make_results(BODY[:51], BODY[:51], category_id=[1]), r'\[0\]: category_id: expected'),
        (make_results([0] * 51), 'no person is seen'),
    ],
)  # fmt: skip
def test_invalid_json_is_refused_in_one_line(tmp_path: Path, content: Any, place: str) -> None:
    path = tmp_path / 'people.json'
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    with pytest.raises(InputError, match=rf'people\.json: .*{place}'):
        load_input(path, VIDEO)


@pytest.mark.parametrize(
    ('contents', 'place'),
    [
        ({}, r'no \*\.json'),
        ({f'cam{c}_{n}': {'people': []} for c in (1, 2) for n in (7, 8)}, 'two cameras or videos'),
        ({'1': {'no': []}}, r'1_keypoints\.json: no list of people'),
        ({'1': {'people': [{'pose_keypoints_2d': BODY}, {}]}}, r'people\[1\]: no pose_keypoints_2d'),
        ({'1': {'people': [3]}}, r'people\[0\]: expected a person'),
        ({'1': {'people': [{'pose_keypoints_2d': [1.0, 2.0]}]}}, r'people\[0\]: keypoints: expected x, y'),
        ({'1': {'people': [{'pose_keypoints_2d': [1, 2, 0.5]}]}}, r'people\[0\]: 1 keypoints: no layout known'),
    ],
)
def test_an_invalid_folder_is_refused_in_one_line(tmp_path: Path, contents: dict[str, Any], place: str) -> None:
    with pytest.raises(InputError, match=place) as caught:
        load_json_folder(write_folder(tmp_path, {f'{n}_keypoints.json': c for n, c in contents.items()}), VIDEO)
    assert str(caught.value).startswith(str(tmp_path))
