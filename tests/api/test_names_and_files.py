# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The public names and their signatures, what importing them costs, and the examples of docs/python.md; `read`,
`write` and `evaluate`: every format, errors of results, one error for each wrong argument."""

import ast
import contextlib
import dataclasses
import inspect
import io
import json
import math
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.cli.main import main
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.recordings.save_results import SUFFIXES
from mocap_ros.skeleton import BODY26
from mocap_ros.verdict.accuracy import evaluate
from tests.support.input_files import flatten_keypoints
from tests.support.paths import ROOT

FPS = 30.0  # Hz


@pytest.fixture(scope='module')
def result(sequence: mocap_ros.KeypointSequence) -> mocap_ros.PoseSequence:
    return mocap_ros.reconstruct(sequence)


@pytest.fixture
def openpose(sequence: mocap_ros.KeypointSequence, tmp_path: Path) -> Path:
    """A folder as OpenPose writes it, of a person and of a second one in one frame."""
    folder = tmp_path / 'openpose'
    folder.mkdir()
    for frame, flat in enumerate(flatten_keypoints(sequence)):
        with_neck = [*flat[:3], 0.0, 0.0, 0.0, *flat[3:]]
        aside = [v + 150 if i % 3 == 0 and v else v for i, v in enumerate(with_neck)]
        people = [{'pose_keypoints_2d': p} for p in (with_neck, aside)[: 2 if frame == 0 else 1]]
        (folder / f'walk_{frame:012d}_keypoints.json').write_text(json.dumps({'people': people}), encoding='utf-8')
    return folder


def test_write_gives_what_the_command_gives(
    result: mocap_ros.PoseSequence, sequence: mocap_ros.KeypointSequence, tmp_path: Path
) -> None:
    mocap_ros.write(tmp_path / 'walk.npz', sequence)
    whole = mocap_ros.reconstruct(mocap_ros.read(tmp_path / 'walk.npz'))
    assert np.abs(whole.joints - result.joints).max() < 1e-3
    outputs = [word for suffix in SUFFIXES for word in ('-o', str(tmp_path / f'command{suffix}'))]
    assert main(['reconstruct', str(tmp_path / 'walk.npz'), *outputs]) == 0
    for suffix in SUFFIXES:
        own, command = ((tmp_path / f'{name}{suffix}') for name in ('own', 'command'))
        mocap_ros.write(str(own), whole)
        if suffix == '.mcap':
            np.testing.assert_array_equal(mocap_ros.read(own).keypoints, mocap_ros.read(command).keypoints)
        else:
            content = own.read_bytes()
            assert command.read_bytes() in (content, content.replace(b'own', b'command')), suffix


@pytest.mark.parametrize('model', ['plumb_bob', 'equidistant'])
def test_the_camera_of_a_bag_is_written_but_for_a_fisheye(
    sequence: mocap_ros.KeypointSequence, tmp_path: Path, caplog: Any, model: str
) -> None:
    lens = Distortion.from_coefficients(model, (0.1, -0.05, 0.001, 0.002))
    camera = Intrinsics.from_matrix(np.array([[610.0, 0, 330], [0, 590, 235], [0, 0, 1]]), lens)
    calibrated = replace(sequence, camera_matrix=None, distortion=None, calibration=camera)
    mocap_ros.write(tmp_path / 'own.npz', calibrated)
    read = mocap_ros.read(tmp_path / 'own.npz').intrinsics(1.0)
    if model == 'equidistant':
        assert not read.is_focal_known
        assert 'no fisheye lens' in caplog.text
    else:
        assert read.focal_lengths == pytest.approx([610, 590])
        assert (read.center, read.is_focal_known, read.distortion) == ((330, 235), True, lens)


def test_json_needs_the_frame_rate_and_logs_what_is_assumed(openpose: Path, caplog: Any) -> None:
    for path, reason in ((openpose, r'\(fps\) or the video \(video\)'), (openpose / 'a--b.json', r'a--b\.json: ')):
        with pytest.raises(mocap_ros.InputError, match=reason):
            mocap_ros.read(path)
    sequence = mocap_ros.read(openpose, fps=FPS)
    assert (len(sequence), sequence.image_size) == (40, (640, 480))
    choice, size = (record.getMessage() for record in caplog.records)
    assert "person 'person_1', seen in 40 of 40 frames; 1 more, choose by person: " in choice
    assert size.endswith('image size not known, 640x480 px assumed; give it by image_size or video')
    matrix = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    for camera, source in ((None, 'nominal'), (matrix, 'known')):
        result = mocap_ros.reconstruct(replace(sequence, camera_matrix=camera))
        assert f'px, {source}' in str(result.summary)
    other = mocap_ros.read(openpose, fps=FPS, image_size=(800, 600), person='person_2', layout='coco18')
    assert (len(other), other.image_size) == (1, (800, 600))


@pytest.mark.parametrize(
    ('arguments', 'place'),
    [
        ({'fps': -1}, 'fps: -1'),
        ({'fps': '30'}, "fps: '30'"),
        ({'fps': FPS, 'image_size': (0, 480)}, 'image_size: 0 x 480 px'),
        ({'fps': FPS, 'image_size': (640, 480, 3)}, 'image_size: shape'),
        ({'fps': FPS, 'layout': 'coco'}, 'layout: unknown'),
        ({'fps': FPS, 'hfov': 200}, 'hfov: 200'),
        ({'fps': FPS, 'hfov': 60, 'focal': 600}, 'focal: hfov is given'),
        ({'fps': FPS, 'person': 'eve'}, ".*openpose: no person 'eve'"),
    ],
)
def test_a_wrong_argument_of_read_is_named(openpose: Path, arguments: dict[str, Any], place: str) -> None:
    with pytest.raises(mocap_ros.MocapError, match=f'^{place}'):
        mocap_ros.read(openpose, **arguments)


def test_what_cannot_be_written_is_refused(
    result: mocap_ros.PoseSequence, sequence: mocap_ros.KeypointSequence, tmp_path: Path
) -> None:
    assert sequence.truth is not None
    short = mocap_ros.GroundTruth(sequence.truth.joints, ('neck', 'head'))
    cases: list[tuple[str, Any, str]] = [
        ('walk.fbx', result, r'path: .*walk\.fbx: unknown file type'),
        ('walk.bvh', sequence, r'path: .*walk\.bvh: unknown file type'),
        ('/dev/null/walk.csv', result, r'/dev/null/walk\.csv: cannot be written: /dev/null is no folder'),
        ('walk.npz', replace(sequence, timestamps=sequence.timestamps[::-1]), 'timestamps: frame 1: '),
        ('walk.npz', replace(sequence, truth=short), r'truth: shape \(40, 15, 3\), expected \(40, 2, 3\)'),
        ('walk.npz', 7, 'result: 7, expected'),
    ]
    for name, given, place in cases:
        with pytest.raises(mocap_ros.MocapError, match=f'^{place}'):
            mocap_ros.write(tmp_path / name, given)
    with pytest.raises(mocap_ros.InputError, match=r'path: .* give the path first'):
        mocap_ros.write(sequence, 'walk.npz')  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.fixture
def truth(sequence: mocap_ros.KeypointSequence) -> mocap_ros.GroundTruth:
    assert sequence.truth is not None
    return sequence.truth


@pytest.mark.parametrize('limbs_only', [False, True])
def test_the_errors_of_a_result_are_those_of_the_evaluation(
    result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth, limbs_only: bool
) -> None:
    keypoints = result.sequence
    assert keypoints is not None
    scores = keypoints.keypoints[..., 2] if limbs_only else None
    fps = 1 / float(np.median(np.diff(result.times)))
    expected = evaluate(
        result.joints,
        BODY26,
        result.reprojection_residual,
        truth.joints,
        truth.joint_names,
        fps,
        keypoints.joint_names,
        scores,
    )
    own = mocap_ros.evaluate(result, limbs_only=limbs_only)
    assert own == mocap_ros.evaluate(result, truth, limbs_only=limbs_only) == expected
    assert own.joints == (12 if limbs_only else 15)


def test_arrays_have_the_same_errors(result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth) -> None:
    whole = mocap_ros.evaluate(result)
    order = np.arange(15)[::-1]
    names = [truth.joint_names[i].replace('lk', 'left_k') for i in order]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        by_arrays = mocap_ros.evaluate(result.joints.tolist(), truth.joints[:, order], truth_names=names)
    assert math.isnan(by_arrays.residual_px)
    assert math.isnan(by_arrays.accel_mm_s2 or 0.0)
    assert by_arrays.mpjpe_mm == pytest.approx(whole.mpjpe_mm)
    with_times = mocap_ros.evaluate(result.joints, truth.joints, times=result.times)
    assert with_times.accel_mm_s2 == pytest.approx(whole.accel_mm_s2)


def zero_frame(joints: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(joints))[:, None, None] == 5, 0.0, joints)


def unknown(joints: np.ndarray) -> np.ndarray:
    return np.full(joints.shape, np.nan)


@pytest.mark.parametrize(
    ('change', 'place'),
    [
        ({'joints': np.zeros((40, 15, 3)), 'truth': None}, 'joints: frame 0: all joints at one point'),
        ({'joints': lambda truth: truth, 'truth': None}, 'truth: missing'),
        ({'times': np.arange(40)}, 'times: the PoseSequence has its own'),
        ({'joints': np.zeros((40, 17, 3))}, r'joints: shape \(40, 17, 3\), expected \(n, 15, 3\)'),
        ({'joints': lambda truth: truth, 'limbs_only': True}, 'limbs_only: needs a result'),
        ({'joints': lambda truth: truth * 1000}, 'joints: .* looks like mm, m expected'),
        ({'joints': zero_frame}, 'joints: frame 5: all joints at one point'),
        ({'truth': np.ones((39, 15, 3))}, r'truth: shape \(39, 15, 3\), expected \(40, 15, 3\)'),
        ({'truth': unknown}, 'truth: no joint is known in any frame'),
        ({'truth': np.ones((40, 2, 3)), 'truth_names': ['fin', 'tail']}, 'truth_names: only 0 joints'),
        ({'joints': lambda truth: truth, 'times': np.arange(40)[::-1]}, 'times: frame 1: .* is not later'),
        ({'joints': lambda truth: truth, 'times': np.arange(40) * 33.3}, 'times: .* looks like milliseconds'),
    ],
)
def test_a_wrong_argument_is_one_error_that_names_it(
    result: mocap_ros.PoseSequence, truth: mocap_ros.GroundTruth, change: dict[str, Any], place: str
) -> None:
    arguments = {'joints': result, 'truth': truth, **change}
    for argument in ('joints', 'truth'):
        if callable(arguments[argument]):
            arguments[argument] = arguments[argument](truth.joints)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(mocap_ros.InputError, match=f'^{place}'):
            mocap_ros.evaluate(**arguments)


# Every public name: bases of exceptions, members of classes, and signatures without types. A change here changes
# the public API: name it in CHANGELOG.md, and raise the version as semantic versioning says.
PUBLIC: dict[str, str] = {
    'MocapError': 'Exception',
    **{name + 'Error': 'MocapError' for name in ('Config', 'Input', 'Model', 'Recording', 'Skeleton')},
    'FrameDropped': 'MocapError',
    'BasePoses': 'aligned_by_heading components explained fit joint_names load mean name poses provenance rescale '
    'save skeleton stature std truncate weights',
    'Config': '(solver=..., classifier=..., tracker=..., node=..., recorder=..., keyframes=...)',
    'Evaluation': 'abs_mpjpe_mm accel_mm_s2 as_dict bone_std_mm e_paper_cm failed_frames fps frames joints '
    'metric_mpjpe_mm mpjpe_mm pa_mpjpe_mm residual_px root_mm seq_mpjpe_mm',
    'GroundTruth': '(joints, joint_names)',
    'KeypointSequence': '(keypoints, joint_names, timestamps, image_size, camera_matrix=None, distortion=None, '
    "truth=None, person_id='', frame_id='', recorded_ns=(), calibration=None, focal_source='', notes=(), "
    'is_size_assumed=False, recording_start=None, depth=None)',
    'Motion': 'cadence category kind residual',
    'Person3D': 'age contact core id inferred is_scale_known joint_names joint_orientation joint_std '
    'joint_velocity joint_velocity_std joints motion posture posture_probability predicted reprojection_residual '
    'root root_covariance root_velocity root_velocity_covariance rotation scale skeleton tentative '
    'translation turn_inferred unseen_for',
    'PoseSequence': 'base_poses body_height cadence camera_height contact core cost floor_std id in_sight '
    'inferred intrinsics is_scale_known iterations joint_names joint_orientation joint_std joints message motion '
    'parents posture posture_probability predicted recorded_ns reprojection_residual root_covariance rotation '
    'scale select sequence skeleton stamps_ns success summary tentative times translation turn_inferred '
    'vertical vertical_std weights world_from_camera',
    'Tracker': "(joint_names, *, image_size, camera_matrix=None, distortion=None, model='auto', parameters=None)",
    'evaluate': "(joints, truth=None, *, truth_names='cmu15', times=None, limbs_only=False)",
    'read': "(path, *, person=None, topic=None, camera_info=None, fps=None, image_size=None, layout='', "
    'detector=None, hfov=None, focal=None, video=None, normalised=False)',
    'reconstruct': '(keypoints, joint_names=None, times=None, *, image_size=None, camera_matrix=None, '
    "distortion=None, depth=None, model='auto', parameters=None, method='whole')",
    'write': '(path, result)',
}


def describe(name: str) -> str:
    """Return a signature without types, the base of an exception, or the members of a class of results."""
    value = getattr(mocap_ros, name)
    if isinstance(value, type) and issubclass(value, Exception):
        return value.__mro__[1].__name__
    if not PUBLIC[name].startswith('('):
        members = {*dir(value), *getattr(value, '__dataclass_fields__', ())}
        return ' '.join(sorted(member for member in members if not member.startswith('_')))
    signature = inspect.signature(value)
    plain = [
        p.replace(annotation=p.empty, default=... if dataclasses.is_dataclass(p.default) else p.default)
        for p in signature.parameters.values()
    ]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty)).replace('Ellipsis', '...')


@pytest.mark.parametrize('name', PUBLIC)
def test_signatures_are_those_of_this_list(name: str) -> None:
    assert describe(name) == PUBLIC[name]


def test_type_checkers_know_the_same_names_from_the_same_modules() -> None:
    tree = ast.parse(Path(mocap_ros.__file__).read_text(encoding='utf-8'))
    conditional = [node for node in tree.body if isinstance(node, ast.If)]
    (block,) = (node for node in conditional if ast.unparse(node.test) == 'TYPE_CHECKING')
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert {node.module: tuple(alias.name for alias in node.names) for node in imports} == mocap_ros._MODULES


def test_importing_the_package_imports_no_library_and_using_it_no_matplotlib() -> None:
    code = (
        'import mocap_ros, sys; dir(mocap_ros); print(*sys.modules);'
        '[getattr(mocap_ros, n) for n in mocap_ros.__all__]; print(*sys.modules)'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    first, after_use = ({*line.split()} for line in done.stdout.splitlines())
    assert not first & {'numpy', 'scipy', 'matplotlib', 'rosbags', 'mcap', 'yaml'}
    assert 'numpy' in after_use
    assert not after_use & {'matplotlib', 'rclpy'}


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
    """Return what differs; a figure may by `TOLERANCE` of the expected one, or by one in its last digit."""
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
