# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a second camera is worth: the people of several cameras merged, against those of the first alone.

Motion capture of people on whom no model was trained, 3 m from the nearest camera, seen from several headings by
the protocol's models of detectors, whose errors are independent but whose joints are defined alike; and the
recorded detections of a balance beam, by three calibrated cameras. Where the cameras are is known. Live, one
camera may see at a third of the rate. Measures: MPJPE and PA-MPJPE in mm after one scale, absolute error in mm,
error of acceleration in m/s^2 (of the beam, whose truth jitters at 60 Hz, it says nothing), the shares of true
errors within the ellipsoids of 95 % of joints and roots, and the CPU time in ms a frame, live with messages.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import common
import numpy as np
from common import WAYS, View
from detected import choose_trials, load_middle, load_motion
from numpy.typing import NDArray
from report import Report, group, run

import mocap_ros
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.geometry.rotations import centre_poses, fit_rotation, quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.skeletons import decode_skeletons, encode_skeletons
from mocap_ros.people import PoseSequence, TrackedFrame
from mocap_ros.recordings.merge_people import merge_recordings
from mocap_ros.runtime.skeleton_merging import SkeletonMerger
from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.coverage import compute_coverage

Array = NDArray[np.float64]

HEADINGS_DEG = 0.0, 90.0, 45.0, 180.0  # from which the cameras look, from the first one
CAMERA_SETS = (0,), (0, 1), (0, 2), (0, 3), (0, 1, 2), (0, 1, 2, 3)
POINTS = 'openpose', 'mediapipe'
FRAMES, MIN_FRAMES, DISTANCE_M, ELEVATION_DEG = 200, 150, 3.0, 10.0
TRIALS, QUICK_TRIALS = 10, 2
TOLERANCE_S = 0.15  # s, as of `mocap_merge`
MEASURES = {
    'mpjpe_mm': 'MPJPE', 'pa_mpjpe_mm': 'PA', 'abs_mpjpe_mm': 'absolute', 'accel': 'acceleration',
    'joints95': 'joints within', 'roots95': 'roots within', 'ms': 'ms',
}  # fmt: skip


class Seen(NamedTuple):
    """A motion seen by several cameras."""

    about: dict[str, str]
    views: Sequence[View]
    poses: Array  # (C, 4, 4) m, from the optical frames to that of the first camera


def list_simulated(report: Report) -> Iterator[Seen]:
    names, count = load_motion()[1], QUICK_TRIALS if report.quick else TRIALS
    trials = sorted({t.partition('_')[0]: t for t in choose_trials('held-out', 1, MIN_FRAMES)}.values())[:count]
    for number, trial in common.show_progress([*enumerate(trials)], 'trials'):
        for points in POINTS:
            views = []
            for camera, heading in enumerate(HEADINGS_DEG):
                turned = (77 * number + heading) % 360
                options = {'distance': DISTANCE_M, 'detector': points, 'seed': 10 * number + camera}
                made = common.load_protocol().make_view(
                    load_middle(trial, FRAMES), names, turned, ELEVATION_DEG, frames=FRAMES, **options
                )
                views.append(View(made, turned))
            truth = views[0].truth
            turns = [
                fit_rotation(*(centre_poses(t.reshape(1, -1, 3)) for t in (v.truth, truth)))[0] for v in views
            ]
            poses = np.tile(np.eye(4), (len(views), 1, 1))
            poses[:, :3, :3] = turns
            poses[:, :3, 3] = [truth[0, 0] - turn @ v.truth[0, 0] for turn, v in zip(turns, views, strict=True)]
            yield Seen({'points': points, 'trial': trial}, views, poses)


def list_recorded() -> Iterator[Seen]:
    with np.load(common.data_path('data', 'cameras', 'balance.npz')) as archive:
        poses = np.tile(np.eye(4), (len(common.CAMERAS), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = archive['rotation'], archive['translation']
    for detector in common.RECORDED_DETECTORS:
        views = [common.load_recording(detector, camera) for camera in common.CAMERAS]
        yield Seen({'points': detector, 'trial': 'balance'}, views, np.asarray(np.linalg.inv(poses), np.float64))


def merge_whole(seen: Seen, results: Sequence[PoseSequence], cameras: Sequence[int]) -> tuple[Any, float]:
    """Return one merged person, and the time in ms a frame."""
    people = [[results[camera]] for camera in cameras]
    found, seconds = common.measure_time(
        lambda: merge_recordings(people, seen.poses[[*cameras]], np.zeros(len(cameras)))
    )
    return found[0].poses, 1e3 * seconds / seen.views[0].frames


def merge_live(
    seen: Seen, tracked: Sequence[Sequence[TrackedFrame]], cameras: Sequence[int], step: int
) -> tuple[Any, float]:
    """Return the people merged as messages arrive, of others than the first camera one in `step`, likewise."""
    merger = SkeletonMerger([str(camera) for camera in cameras], TOLERANCE_S)
    inverse, times = np.linalg.inv(seen.poses[cameras[0]]), seen.views[0].times
    placements = {}
    for camera in cameras:
        matrix = seen.poses[camera]
        pose = RigidTransform(matrix[:3, 3], quaternion_from_rotation(matrix[:3, :3]))
        placements[camera] = CameraPlacement(f'camera_{camera}', pose)
    shape = len(times), len(BODY26.joints)
    joints, std, covariance = (
        np.full((*shape, 3), np.nan),
        np.full(shape, np.nan),
        np.full((shape[0], 3, 3), np.nan),
    )

    def feed() -> None:
        for frame in range(len(times)):
            for camera in (*cameras[1:], cameras[0]):
                if camera != cameras[0] and frame % step:
                    continue
                given, placement = tracked[camera][frame], placements[camera]
                header = Header(given.stamp_ns + NS_PER_S, 'map')
                raw = encode_skeletons(header, placement.place(given.people), None, placement)
                for output in merger.feed(str(camera), raw):
                    if output.topic == 'skeletons' and len(people := decode_skeletons(output.data).people):
                        joints[frame], std[frame] = people.joints[0], people.joint_std[0]
                        covariance[frame] = people.root_covariance[0]

    seconds = common.measure_time(feed)[1]
    to_first = inverse @ seen.poses[cameras[0]]
    found = joints @ to_first[:3, :3].T + to_first[:3, 3]
    return common.TrackedSequence(found, std, joints, np.isnan(std), covariance), 1e3 * seconds / len(times)


def measure(view: View, found: Any) -> dict[str, float]:
    """Return the errors of a merged person in the optical frame of the first camera."""
    errors = common.compute_errors(view, found.joints, CMU15.joints, 'common')
    names = [str(name) for name in view.sequence['joints3d_names']]
    std = found.joint_std if isinstance(found, PoseSequence) else found.std
    coverage = compute_coverage(found.joints, std, found.root_covariance, BODY26, view.truth, names)
    return {**errors, 'accel': errors['accel_mm_s2'] / 1e3, **coverage}


def report_way(report: Report, way: str) -> dict[str, Any]:
    model, parameters = common.provide_held_out()
    records: list[dict[str, Any]] = []
    for seen in (*list_simulated(report), *list_recorded()):
        if way == 'whole':
            given: Any = [
                mocap_ros.reconstruct(
                    v.keypoints, v.joint_names, v.times, **v.camera, model=model, parameters=parameters
                )
                for v in seen.views
            ]
        else:
            given = []
            for v in seen.views:
                tracker = mocap_ros.Tracker(v.joint_names, **v.camera, model=model, parameters=parameters)
                frames = zip(v.times.tolist(), v.keypoints, strict=True)
                given.append([tracker.update(time_s, [points], ids=['p']) for time_s, points in frames])
        for cameras in CAMERA_SETS:
            if max(cameras) >= len(seen.views):
                continue
            for step in (1,) if way == 'whole' or len(cameras) != 2 else (1, 3):
                merge: Callable[..., tuple[Any, float]] = (
                    merge_whole if way == 'whole' else partial(merge_live, step=step)
                )
                found, ms = merge(seen, given, cameras)
                headings = ', '.join(f'{HEADINGS_DEG[c]:g}' for c in cameras)
                name = headings if 'balance' not in seen.about['trial'] else ', '.join(str(c + 1) for c in cameras)
                rate = '' if step == 1 else ', second at 10 Hz'
                about = {**seen.about, 'cameras': name + rate, 'way': way, 'ms': ms}
                records.append({**about, **measure(seen.views[cameras[0]], found)})
    for kind, own in (
        ('simulated', [r for r in records if r['trial'] != 'balance']),
        ('recorded', [r for r in records if r['trial'] == 'balance']),
    ):
        rows = (
            [*names, *(f'{np.mean([r[key] for r in rs]):.3g}' for key in MEASURES), len(rs)]
            for names, rs in group(own, 'cameras', 'points').items()
        )
        header = ['cameras', 'points', *MEASURES.values(), 'number']
        report.table(header, rows, f'{way}, {kind}', f'merging.{way}.{kind}')
    return {way: records}


if __name__ == '__main__':
    run(__doc__, {way: partial(report_way, way=way) for way in WAYS})
