# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The public names and their signatures, which change only with the version, and what importing them costs."""

from __future__ import annotations

import ast
import dataclasses
import enum
import inspect
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mocap_ros

# Every public name: bases of exceptions, members of classes, and signatures without types. A change here changes
# the public API: name it in CHANGELOG.md, and raise the version as semantic versioning says.
PUBLIC: dict[str, dict[str, str] | str] = {
    'BasePoses': {
        'aligned_by_heading': 'attribute',
        'components': 'attribute',
        'explained': 'attribute',
        'fit': "(trials, *, name, joint_names='cmu15', components=45, alignment='rotation', "
        'mirror=False, bodies=0, provenance=None)',
        'joint_names': 'attribute',
        'load': '(name_or_path)',
        'mean': 'attribute',
        'name': 'attribute',
        'poses': '(self, theta)',
        'provenance': 'attribute',
        'rescale': '(self, factor)',
        'save': '(self, path)',
        'stature': 'attribute',
        'std': 'attribute',
        'truncate': '(self, k)',
        'weights': '(self, poses)',
    },
    'Config': {'': '(solver=..., classifier=..., tracker=..., node=..., recorder=..., keyframes=...)'},
    'ConfigError': 'MocapError',
    'Evaluation': {
        'abs_mpjpe_mm': 'attribute',
        'accel_mm_s2': 'attribute',
        'as_dict': '(self)',
        'bone_std_mm': 'attribute',
        'e_paper_cm': 'attribute',
        'failed_frames': 'attribute',
        'fps': 'attribute',
        'frames': 'attribute',
        'joints': 'attribute',
        'metric_mpjpe_mm': 'attribute',
        'mpjpe_mm': 'attribute',
        'pa_mpjpe_mm': 'attribute',
        'residual_px': 'attribute',
        'root_mm': 'attribute',
        'seq_mpjpe_mm': 'attribute',
    },
    'FrameDropped': 'MocapError',
    'GroundTruth': {'': '(joints, joint_names)'},
    'InputError': 'MocapError',
    'KeypointSequence': {
        '': '(keypoints, joint_names, timestamps, image_size, camera_matrix=None, '
        "distortion=None, truth=None, person_id='', frame_id='', recorded_ns=(), "
        'calibration=None)',
        'is_camera_known': 'attribute',
        'stamps_ns': 'attribute',
    },
    'MocapError': 'Exception',
    'ModelError': 'MocapError',
    'Motion': {'cadence': 'attribute', 'category': 'attribute', 'kind': 'attribute', 'residual': 'attribute'},
    'MotionKind': {'UNKNOWN': '0', 'PERIODIC': '1', 'NON_PERIODIC': '2'},
    'Person3D': {
        'age': 'attribute',
        'core': 'attribute',
        'id': 'attribute',
        'inferred': 'attribute',
        'joint_names': 'attribute',
        'joints': 'attribute',
        'motion': 'attribute',
        'orientation': 'attribute',
        'predicted': 'attribute',
        'residual': 'attribute',
        'root': 'attribute',
        'root_covariance': 'attribute',
        'root_velocity': 'attribute',
        'root_velocity_covariance': 'attribute',
        'rotation': 'attribute',
        'scale': 'attribute',
        'scale_known': 'attribute',
        'skeleton': 'attribute',
        'std': 'attribute',
        'tentative': 'attribute',
        'translation': 'attribute',
        'turn_inferred': 'attribute',
        'unseen_for': 'attribute',
        'velocity': 'attribute',
        'velocity_std': 'attribute',
    },
    'PoseSequence': {
        'base_poses': 'attribute',
        'cost': 'attribute',
        'is_scale_known': 'attribute',
        'iterations': 'attribute',
        'joint_names': 'attribute',
        'joints': 'attribute',
        'message': 'attribute',
        'orientation': 'attribute',
        'parents': 'attribute',
        'residual': 'attribute',
        'rotation': 'attribute',
        'scale': 'attribute',
        'seen': 'attribute',
        'sequence': 'attribute',
        'success': 'attribute',
        'times': 'attribute',
        'translation': 'attribute',
        'turn_inferred': 'attribute',
        'vertical': 'attribute',
        'vertical_std': 'attribute',
        'weights': 'attribute',
    },
    'RecordingError': 'MocapError',
    'SkeletonError': 'MocapError',
    'Tracker': {
        '': "(joint_names, *, image_size, camera_matrix=None, distortion=None, model='auto', parameters=None)",
        'output_time_s': 'attribute',
        'reset': '(self)',
        'update': '(self, time_s, people, *, ids=())',
        'vertical': 'attribute',
        'vertical_std': 'attribute',
    },
    'evaluate': "(joints, truth=None, *, truth_names='cmu15', times=None, limbs_only=False)",
    'read': "(path, *, person=None, topic=None, camera_info=None, fps=None, image_size=None, layout='', "
    'detector=None, hfov=None, focal=None)',
    'reconstruct': '(keypoints, joint_names=None, times=None, *, image_size=None, camera_matrix=None, '
    "distortion=None, model='auto', parameters=None, method='whole')",
    'write': '(path, result)',
}

RESULTS = ('BasePoses', 'Evaluation', 'Motion', 'Person3D', 'PoseSequence')  # not created by their constructors
# Members that give objects of classes that are not exported.
PRIVATE_MEMBERS = {'BasePoses': ['skeleton'], 'KeypointSequence': ['intrinsics', 'person']}

HEAVY_LIBRARIES = ('numpy', 'scipy', 'matplotlib', 'rosbags', 'mcap', 'yaml')


def describe(name: str) -> dict[str, str] | str:
    """Return the signature of a public function, or the members of a public class with theirs."""
    value = getattr(mocap_ros, name)
    if inspect.isfunction(value):
        return describe_signature(value)
    if issubclass(value, Exception):
        return value.__base__.__name__
    if issubclass(value, enum.Enum):
        return {member.name: str(member.value) for member in value}
    fields = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
    members = {
        key: describe_signature(getattr(value, key)) if callable(getattr(value, key)) else 'attribute'
        for owner in value.__mro__[:-1]
        for key in vars(owner)
        if key not in fields and not key.startswith('_')
    }
    if name in RESULTS:
        members |= dict.fromkeys(fields, 'attribute')
    private = PRIVATE_MEMBERS.get(name, [])
    shown = {k: members[k] for k in sorted(members) if k not in private}
    return shown if name in RESULTS else {'': describe_signature(value), **shown}


def describe_signature(function: Callable[..., object]) -> str:
    """Return names, kinds and defaults of the parameters, groups of parameters as dots."""
    signature = inspect.signature(function)
    plain = [
        p.replace(annotation=p.empty, default=... if dataclasses.is_dataclass(p.default) else p.default)
        for p in signature.parameters.values()
    ]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty)).replace('Ellipsis', '...')


def test_public_names_are_listed_once_more_here() -> None:
    assert list(mocap_ros.__all__) == sorted(mocap_ros.__all__) == list(PUBLIC)
    assert set(PUBLIC) <= set(dir(mocap_ros))


@pytest.mark.parametrize('name', PUBLIC)
def test_signatures_are_those_of_this_list(name: str) -> None:
    assert describe(name) == PUBLIC[name]


def test_type_checkers_know_the_same_names_from_the_same_modules() -> None:
    tree = ast.parse(Path(mocap_ros.__file__).read_text(encoding='utf-8'))
    (block,) = (
        node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == 'TYPE_CHECKING'
    )
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert {node.module: tuple(alias.name for alias in node.names) for node in imports} == mocap_ros._MODULES


@pytest.mark.parametrize('name', [n for n, public in PUBLIC.items() if not isinstance(public, str)])
def test_public_members_are_documented(name: str) -> None:
    value = getattr(mocap_ros, name)
    documentation = inspect.getdoc(value) or ''
    assert documentation
    if issubclass(value, enum.Enum):
        return
    for member in PUBLIC[name]:
        is_field = member in getattr(value, '__dataclass_fields__', {})
        own = f' {member}: ' in documentation if is_field else inspect.getdoc(getattr(value, member or '__doc__'))
        assert own, f'{name}.{member}'


def test_functions_document_every_argument() -> None:
    for owner in ('reconstruct', 'evaluate', 'read', 'write', 'Tracker', 'Tracker.update', 'BasePoses.fit'):
        value: Any = mocap_ros
        for part in owner.split('.'):
            value = getattr(value, part)
        documentation = inspect.getdoc(value) or ''
        arguments = documentation.partition('Args:')[2].partition('Raises:')[0]
        for parameter in inspect.signature(value).parameters:
            assert parameter == 'self' or f' {parameter}: ' in arguments, f'{owner}: {parameter}'
        assert 'Raises:' in documentation, owner


def test_a_name_that_does_not_exist_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'mocap_ros' has no attribute 'reconstuct'"):
        mocap_ros.reconstuct  # type: ignore[attr-defined]  # noqa: B018


def run_python(code: str) -> str:
    process = subprocess.run(
        [sys.executable, '-c', code], env=os.environ, capture_output=True, text=True, check=True
    )
    return process.stdout


def test_importing_the_package_imports_no_library() -> None:
    count = f'sum(name in sys.modules for name in {HEAVY_LIBRARIES})'
    loaded = run_python(f'import mocap_ros, sys; dir(mocap_ros); print({count}); mocap_ros.read; print({count})')
    first, after_use = map(int, loaded.split())
    assert first == 0
    assert after_use > 0


def test_all_public_names_can_be_imported_together() -> None:
    names = run_python('from mocap_ros import *; print(*[n for n in dir() if not n.startswith("_")])').split()
    assert names == list(PUBLIC)


def test_reconstruction_and_evaluation_do_not_import_matplotlib() -> None:
    code = 'import mocap_ros, sys; [getattr(mocap_ros, n) for n in mocap_ros.__all__]; print(*sys.modules)'
    assert not {'matplotlib', 'rclpy'} & set(run_python(code).split())
