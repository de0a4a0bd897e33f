# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People who are none: what is published of a person whom the detector breaks in two or names anew.

In 1 % of the frames the detector breaks the person into upper and lower body or adds one of these as a second
detection, and in 1 % of the frames it gives the person an id that it never used before and never will again. A
published person of another id than that of the first frame is a ghost. People without ids are tested likewise; and
pairs of people who cross in the image, whose ids must stay theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reconstruction import Models, list_people, track_people

from experiments.detector_views import DetectedView
from mocap_ros.config import Config
from mocap_ros.keypoints.person import Person2D

Array = NDArray[np.float64]

SHARE = 0.01  # share of the frames with fragments, and of those with a fresh id
LOWER_BODY = ('hip', 'knee', 'ankle', 'toe', 'heel', 'foot_index', 'pelvis')  # ends of the names of its joints
CROSSING_OFFSET = 0.35  # image widths between the centre of the image and each of two people, who cross, at first


def take_part(person: Person2D, person_id: str, lower: bool) -> Person2D:
    """Return the lower or the upper body of a person as another one."""
    is_out = np.array([name.endswith(LOWER_BODY) != lower for name in person.joints])
    points = np.where(is_out[:, None], np.nan, person.points)
    return replace(person, id=person_id, points=points, score=np.where(is_out, 0.0, person.score))


def disturb(person: Person2D, frame: int, rng: np.random.Generator) -> list[Person2D]:
    """Return what a detector makes of a person in a frame; see the module's text."""
    fresh = f'new_{frame}' if person.id else ''
    has_fragments, is_broken, lower, has_fresh_id = rng.random(4) < (SHARE, 0.5, 0.5, SHARE)
    if has_fragments:
        known = take_part(person, person.id, not lower) if is_broken else person
        return [known, take_part(person, fresh, lower)]
    return [replace(person, id=fresh)] if has_fresh_id and person.id else [person]


def count_ghosts(seen: DetectedView, person_id: str, seed: int, models: Models, config: Config) -> dict[str, int]:
    """Count the disturbed frames, the ghosts by how they are published, and the frames without the true person."""
    rng = np.random.default_rng(seed)
    # the first frame is undisturbed, so that it is known who the true person is
    people = list_people(seen.view, person_id)
    frames = [people[:1], *(disturb(p, i, rng) for i, p in enumerate(people[1:], 1))]
    published = [out for _, out in track_people(frames, seen.times, seen.view.intrinsics, models, config)]
    first = next((p.id for people_now in published for p in people_now), '')
    ghosts = [p for people_now in published for p in people_now if p.id != first]
    tentative = [p for p in ghosts if getattr(p, 'tentative', False)]
    others = [p for p in ghosts if not getattr(p, 'tentative', False)]
    return {
        'frames': len(frames),
        'fragments': sum(len(f) > 1 for f in frames),
        'fresh ids': sum(f[0].id != person_id for f in frames),
        'tentative': len(tentative),
        'predicted': sum(p.predicted for p in others),
        'other': sum(not p.predicted for p in others),
        'without the person': sum(first not in [p.id for p in now] for now in published),
        'person predicted': sum(p.id == first and p.predicted for now in published for p in now),
    }


def cross(views: Sequence[DetectedView], models: Models, config: Config) -> bool:
    """Return whether two people without ids, who change places in the image, keep their ids."""
    count = min(len(v.times) for v in views)
    width = float(views[0].view.sequence['image_size'][0])
    shift = np.linspace(-CROSSING_OFFSET, CROSSING_OFFSET, count) * width
    tracks = []
    for view, sign in zip(views, (1, -1), strict=True):
        people = list_people(view.view, '')[:count]
        tracks.append([replace(p, points=p.points + [sign * s, 0]) for p, s in zip(people, shift, strict=True)])
    frames = [list(pair) for pair in zip(*tracks, strict=True)]
    tracked = track_people(frames, views[0].times[:count], views[0].view.intrinsics, models, config)
    # the person who starts on the left has the larger x in the end
    order = [[p.id for p in sorted(now, key=lambda p: p.joints[:, 0].mean())] for _, now in tracked]
    first = next(o for o in order if len(o) == 2)
    return order[-1] == first[::-1]


def measure_ghosts(views: Sequence[DetectedView], models: Models, config: Config) -> dict[str, Any]:
    """Count the ghosts of people with and without ids, and the crossing people who keep their ids."""
    out: dict[str, Any] = {}
    for label, person_id in (('with ids', 'p'), ('without ids', '')):
        counts = [count_ghosts(v, person_id, i, models, config) for i, v in enumerate(views)]
        out[label] = {k: sum(c[k] for c in counts) for k in counts[0]}
    by_size: dict[bytes, list[DetectedView]] = {}
    for view in views:
        by_size.setdefault(view.view.sequence['image_size'].tobytes(), []).append(view)
    pairs = [pair for same in by_size.values() for pair in zip(same[::2], same[1::2], strict=False)]
    kept = [cross(pair, models, config) for pair in pairs]
    out['crossing'] = {'pairs': len(kept), 'kept': sum(kept)}
    return out
