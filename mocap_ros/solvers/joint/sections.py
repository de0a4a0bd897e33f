# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A long sequence, solved in sections one after the other, so that the memory of the solver has a bound.

A section is solved with the frames of `MARGIN_S` before and after it, on which its poses depend, and hardly on
others. What all frames share are the image noise and the mean lengths l of the bones (TPAMI 2016, eq. 20). So each
section is solved twice: first with its own, and then with those of all,

    misfit^2 = sum_s n_s misfit_s^2 / sum_s n_s,    l = sum_s F_s l_s / sum_s F_s

with n_s the joints that are seen in section s and F_s its frames. The least noise that the points show by
themselves is always that of all frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import SolverConfig
from mocap_ros.geometry.interpolation import find_nearest
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers.joint.batch import Batch
from mocap_ros.solvers.joint.solver import (
    JointReconstruction,
    SharedValues,
    solve,
    solve_hypotheses,
    start_from_lifted_poses,
)
from mocap_ros.solvers.window import MIN_JOINTS_FOR_CAMERA, InitialValues, Window, choose_initial_values

MAX_SECTION_FRAMES = 3600  # without margins; two minutes at 30 Hz, which take 350 MB
MARGIN_S = 3.0  # s; many times as long as what velocities and accelerations connect


class Section(NamedTuple):
    """Frames of a sequence that are solved together."""

    own: slice  # of which the solution is kept
    padded: slice  # with the margins

    @property
    def kept(self) -> slice:
        """The own frames among the padded ones."""
        return slice(self.own.start - self.padded.start, self.own.stop - self.padded.start)


def solve_in_sections(
    window: Window,
    model: PoseModel,
    config: SolverConfig,
    report: Callable[[float], None] = lambda _: None,
    max_frames: int = MAX_SECTION_FRAMES,
) -> JointReconstruction:
    """Reconstruct a sequence as `solve_hypotheses` does; one of more than `max_frames` frames in sections.

    `report` is called with the share, 0 to 1, that is done.

    Raises:
        InputError: no frame of the window has four seen joints.
    """
    if len(window.times) <= max_frames:
        (solution,) = solve_hypotheses([window], model, config)
        report(1.0)
        return solution
    model = model.truncate(config.components)
    start, unit = choose_initial_values(start_from_lifted_poses(window, model), model, config.start_window)
    window = replace(window, start=start, unit=unit)
    least_noise = float(Batch.build([window], np.array([unit]), [start]).sequences['least_noise'][0])
    sections, shared = choose_sections(window, max_frames), SharedValues(least_noise)
    first_pass: list[JointReconstruction] = []
    for index, section in enumerate(sections):
        first_pass += solve_hypotheses([select_frames(window, section.padded)], model, config, shared)
        report((index + 1) / len(sections) / 2)
    joined, activities = _join(window, sections, first_pass, least_noise), [s.activity for s in first_pass]
    del first_pass  # which is as large as the joined one
    shared = shared._replace(bone_lengths=model.skeleton.bone_lengths(joined.joints).mean(axis=0))
    window = replace(window, start=InitialValues(joined.theta, joined.cameras), noise=joined.noise)
    second_pass: list[JointReconstruction] = []
    for index, (section, activity) in enumerate(zip(sections, activities, strict=True)):
        known = shared._replace(activity=activity)
        second_pass += solve([select_frames(window, section.padded)], model, config, known)
        report((1 + (index + 1) / len(sections)) / 2)
    return _join(window, sections, second_pass, least_noise)


def choose_sections(window: Window, max_frames: int) -> list[Section]:
    """Return sections of about equal lengths, without those in which nobody is seen well enough to be solved."""
    times, count = window.times, len(window.times)
    edges = np.linspace(0, count, math.ceil(count / max_frames) + 1).astype(int)
    is_seen = (window.weight > 0).sum(axis=1) >= MIN_JOINTS_FOR_CAMERA
    sections = []
    for first, end in pairwise(edges.tolist()):
        padded = np.searchsorted(times, [times[first] - MARGIN_S, times[end - 1] + MARGIN_S])
        padded = np.clip(padded, [first - max_frames, end], [first, end + max_frames]).tolist()
        section = Section(slice(first, end), slice(max(padded[0], 0), min(padded[1], count)))
        if (window.weight[section.own] > 0).any() and is_seen[section.padded].any():
            sections.append(section)
    return sections


def select_frames(window: Window, frames: slice) -> Window:
    """Return the window of some frames."""
    start, lifted = window.start, window.lifted
    if start is not None:
        cameras = WeakPerspectiveCameras(start.cameras.scale[frames], start.cameras.rotation[frames])
        start = InitialValues(start.theta[frames], cameras)
    return replace(
        window,
        points=window.points[frames],
        weight=window.weight[frames],
        times=window.times[frames],
        start=start,
        lifted=None if lifted is None else lifted.select_frames(frames),
    )


def _join(
    window: Window,
    sections: Sequence[Section],
    solutions: Sequence[JointReconstruction],
    least_noise: float,
) -> JointReconstruction:
    """Return one solution for all frames; those of no section have that of the nearest one.

    Where two sections overlap, their solutions are blended linearly over the middle half, but for rotations, which
    only the cameras of the result have.
    """
    nearest = find_nearest(window.times, np.concatenate([window.times[section.own] for section in sections]))

    def cut(values: Sequence[Array]) -> Array:
        kept = [of_section[section.kept] for of_section, section in zip(values, sections, strict=True)]
        return np.asarray(np.concatenate(kept)[nearest])

    def fade(values: Sequence[Array]) -> Array:
        joined = cut(values)
        for (before, old), (after, new) in pairwise(zip(sections, values, strict=True)):
            quarter = (before.padded.stop - after.padded.start) // 4
            first, end = after.padded.start + quarter, before.padded.stop - quarter
            if before.own.stop == after.own.start and first < end:
                share = np.linspace(0.0, 1.0, end - first).reshape(-1, *[1] * (joined.ndim - 1))
                old_frames = old[first - before.padded.start : end - before.padded.start]
                new_frames = new[first - after.padded.start : end - after.padded.start]
                joined[first:end] = (1 - share) * old_frames + share * new_frames
        return joined

    seen = [np.count_nonzero(window.weight[section.own]) for section in sections]
    misfit = math.sqrt(np.average(np.square([s.misfit for s in solutions]), weights=seen))
    residual = cut([s.residual for s in solutions])
    return replace(
        solutions[-1],
        joints=fade([s.joints for s in solutions]),
        theta=fade([s.theta for s in solutions]),
        cameras=WeakPerspectiveCameras(
            fade([s.cameras.scale for s in solutions]), cut([s.cameras.rotation for s in solutions])
        ),
        translation=fade([s.translation for s in solutions]),
        residual=np.where((window.weight > 0).any(axis=1), residual, np.nan),
        status=min(s.status for s in solutions),
        history=(sum(s.history[0] for s in solutions), sum(s.cost for s in solutions)),
        iterations=max(s.iterations for s in solutions),
        noise=max(misfit, least_noise),
        misfit=misfit,
        activity=None,
    )
