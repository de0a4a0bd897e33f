# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is kept of a run when a recording starts, which resets the tracker; the journal holds it for the replay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import naming
from mocap_ros.keypoints.association import SeenPeople
from mocap_ros.keypoints.identities import FormerPerson, Names
from mocap_ros.skeleton import CORE_COUNT


class RunMemory(NamedTuple):
    """What a reset may keep."""

    has_waited: bool = False  # whether people wait no more for a CameraInfo
    names: Names = Names()

    def encode(self) -> dict[str, Any]:
        """Return what is kept as values for JSON, by name; none where nothing is."""
        people = [
            (name, stamp_ns, np.column_stack((seen.points[0], seen.weight[0])).tolist())
            for name, stamp_ns, seen in self.names.people
        ]
        known = {'has_waited': self.has_waited, 'numbered': self.names.numbered, 'people': people}
        return {key: value for key, value in known.items() if value}

    @classmethod
    def decode(cls, values: Mapping[str, Any]) -> RunMemory:
        """Return what `encode` has encoded; InputError if the values are no such."""
        with naming('people', 'not the people who were known at a reset'):
            people = [
                FormerPerson(str(name), int(stamp_ns), _read_seen(np.array(rows, float)))
                for name, stamp_ns, rows in values.get('people', ())
            ]
            names = Names(int(values.get('numbered', 0)), tuple(people))
        return cls(bool(values.get('has_waited')), names)


def _read_seen(rows: Array) -> SeenPeople:
    if rows.shape != (CORE_COUNT, 3) or not np.isfinite(rows).all():
        raise ValueError
    return SeenPeople(rows[None, :, :2], rows[None, :, 2])


NOTHING = RunMemory()
