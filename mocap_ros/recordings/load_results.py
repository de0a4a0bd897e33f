# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load reconstructions from result files of `reconstruct`, and from bags that hold skeletons."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.reader import Bag, is_bag
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.sequence_file import StoredResult, is_result_file, load_result_file
from mocap_ros.messages.skeletons import SKELETONS, RecordedPerson, RecordedSkeletons, decode_skeletons
from mocap_ros.skeleton import CMU15, Skeleton
from mocap_ros.units import NS_PER_S


class RecordedPeople:
    """The people in the messages of skeletons of a bag, who all have the same joints."""

    def __init__(self) -> None:
        self.skeleton: Skeleton = CMU15
        self.stamps_ns: set[int] = set()
        self.by_id: dict[str, dict[int, RecordedPerson]] = {}

    def add(self, raw: bytes) -> RecordedSkeletons:
        """Add a message; raises InputError, which names the field, if it does not fit those before."""
        array = decode_skeletons(raw)
        self.stamps_ns.add(array.stamp_ns)
        for person in array.people:
            if self.by_id and person.skeleton != self.skeleton:
                names = ', '.join(sorted({person.skeleton.name, self.skeleton.name}))
                raise InputError(f'skeletons of several layouts: {names}')
            self.skeleton = person.skeleton
            self.by_id.setdefault(person.id, {})[array.stamp_ns] = person
        return array


def holds_result(path: Path) -> bool:
    """Return whether a path is a result file, or a bag in which there are skeletons."""
    if is_bag(path):
        with Bag(path) as bag:
            return bool(bag.topics_of_type([SKELETONS]))
    return path.is_file() and is_result_file(path)


def find_skeletons_topic(bag: Bag) -> str:
    """Return the topic of skeletons; raises InputError unless there is exactly one."""
    topics = bag.topics_of_type([SKELETONS])
    if len(topics) != 1:
        found = f'several topics of skeletons: {", ".join(topics)}' if topics else 'no skeletons'
        raise InputError(f'{bag.path}: the bag has {found}')
    return topics[0]


def load_result(path: Path, person: str | None = None) -> tuple[StoredResult, str]:
    """Load a reconstruction from a result file or a bag, of the person with id `person` or with most skeletons.

    It has a frame for each message of a bag. The id of the person is returned as well, empty for a result file.
    """
    if not is_bag(path):
        if person is not None:
            raise InputError(f'{path}: --person does not apply to a result of reconstruct')
        result, chosen = load_result_file(path), ''
    else:
        recorded = RecordedPeople()
        with Bag(path) as bag:
            topic = find_skeletons_topic(bag)
            with naming(f'{path}: {topic}'):
                for message in bag.messages([topic]):
                    recorded.add(message.raw)
        counts = {person_id: len(own) for person_id, own in recorded.by_id.items()}
        if not counts:
            raise InputError(f'{path}: {topic}: no person is in any message')
        chosen = max(counts, key=counts.__getitem__) if person is None else person
        if chosen not in counts:
            people = ', '.join(f'{i} ({n})' for i, n in sorted(counts.items(), key=lambda item: -item[1]))
            raise InputError(f'{path}: no person {person!r}; there are {people}')
        result = _collect(recorded, chosen)
    if not np.isfinite(result.joints).all(axis=(1, 2)).any():
        raise InputError(f'{path}: no frame has a skeleton')
    return result, chosen


def _collect(recorded: RecordedPeople, person: str) -> StoredResult:
    stamps, own = sorted(recorded.stamps_ns), recorded.by_id[person]
    frames, count = np.searchsorted(stamps, sorted(own)), len(recorded.skeleton.joints)

    def fill(field: str, missing: float, *shape: int) -> NDArray[Any]:
        values = np.full((len(stamps), *shape), missing)
        values[frames] = [getattr(own[stamp], field) for stamp in sorted(own)]
        return values

    return StoredResult(
        np.array(stamps) / NS_PER_S,
        fill('joints', np.nan, count, 3),
        ~fill('inferred', True, count),
        fill('residual', np.nan),
        recorded.skeleton,
        tuple(stamps),
        fill('std', np.nan, count),
        fill('root_covariance', np.nan, 3, 3),
    )
