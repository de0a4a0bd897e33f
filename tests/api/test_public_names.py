# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The public names and their signatures, what importing them costs, and the examples of docs/python.md."""

import ast
import contextlib
import dataclasses
import inspect
import io
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mocap_ros
from tests.support.paths import ROOT

# Every public name: bases of exceptions, members of classes, and signatures without types. A change here changes
# the public API: name it in CHANGELOG.md, and raise the version as semantic versioning says.
PUBLIC: dict[str, str] = {
    'BasePoses': 'aligned_by_heading components explained fit joint_names load mean name poses provenance rescale '
    'save skeleton stature std truncate weights',
    'Config': '(solver=..., classifier=..., tracker=..., node=..., recorder=..., keyframes=...)',
    'ConfigError': 'MocapError',
    'Evaluation': 'abs_mpjpe_mm accel_mm_s2 as_dict bone_std_mm e_paper_cm failed_frames fps frames joints '
    'metric_mpjpe_mm mpjpe_mm pa_mpjpe_mm residual_px root_mm seq_mpjpe_mm',
    'FrameDropped': 'MocapError',
    'GroundTruth': '(joints, joint_names)',
    'InputError': 'MocapError',
    'KeypointSequence': '(keypoints, joint_names, timestamps, image_size, camera_matrix=None, distortion=None, '
    "truth=None, person_id='', frame_id='', recorded_ns=(), calibration=None, focal_source='', notes=())",
    'MocapError': 'Exception',
    'ModelError': 'MocapError',
    'Motion': 'cadence category kind residual',
    'Person3D': 'age contact core id inferred joint_names joints motion orientation predicted residual root '
    'root_covariance root_velocity root_velocity_covariance rotation scale scale_known skeleton std tentative '
    'translation turn_inferred unseen_for velocity velocity_std',
    'PoseSequence': 'base_poses contact cost floor_std is_scale_known iterations joint_names joints message '
    'orientation parents residual rotation scale seen sequence success summary times translation turn_inferred '
    'vertical vertical_std weights world_from_camera',
    'RecordingError': 'MocapError',
    'SkeletonError': 'MocapError',
    'Tracker': "(joint_names, *, image_size, camera_matrix=None, distortion=None, model='auto', parameters=None)",
    'evaluate': "(joints, truth=None, *, truth_names='cmu15', times=None, limbs_only=False)",
    'read': "(path, *, person=None, topic=None, camera_info=None, fps=None, image_size=None, layout='', "
    'detector=None, hfov=None, focal=None)',
    'reconstruct': '(keypoints, joint_names=None, times=None, *, image_size=None, camera_matrix=None, '
    "distortion=None, model='auto', parameters=None, method='whole')",
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
