# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Load a person's reconstruction from a result file of `reconstruct`, or from a bag that holds skeletons."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from mocap_ros.bags.reader import Bag, is_bag
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.sequence_file import StoredResult, is_result_file, load_result_file
from mocap_ros.messages.skeletons import SKELETONS, RecordedSkeletons, decode_skeletons
from mocap_ros.units import NS_PER_S


def holds_result(path: Path) -> bool:
    """Return whether a path is a result file, or a bag in which there are skeletons.

    Raises:
        InputError: the path is a bag that cannot be read.
    """
    if is_bag(path):
        with Bag(path) as bag:
            return bool(bag.topics_of_type([SKELETONS]))
    return path.is_file() and is_result_file(path)


def load_result(path: Path, person: str | None = None) -> tuple[StoredResult, str]:
    """Load a reconstruction from a result file or a bag.

    Args:
        path: The file or bag.
        person: Id of the person in a bag; by default the person with most skeletons.

    Returns:
        The reconstruction, with a frame for each message of a bag, and the id of the person, which is empty for a
        result file.

    Raises:
        InputError: The file or bag holds no reconstruction or no skeleton, is damaged, or has no person of that
            id; the error names the place.
    """
    if not is_bag(path):
        if person is not None:
            raise InputError(f'{path}: --person does not apply to a result of reconstruct')
        result, chosen = load_result_file(path), ''
    else:
        result, chosen = _load_bag(path, person)
    if not np.isfinite(result.joints).all(axis=(1, 2)).any():
        raise InputError(f'{path}: no frame has a skeleton')
    return result, chosen


def _load_bag(path: Path, person: str | None) -> tuple[StoredResult, str]:
    with Bag(path) as bag:
        topics = bag.topics_of_type([SKELETONS])
        if len(topics) != 1:
            found = f'several topics of skeletons: {", ".join(topics)}' if topics else 'no skeletons'
            raise InputError(f'{path}: the bag has {found}')
        with naming(f'{path}: {topics[0]}'):
            arrays = [decode_skeletons(message.raw) for message in bag.messages(topics)]
    array_by_stamp = {array.stamp_ns: array for array in arrays}
    counts = Counter(skeleton.id for array in array_by_stamp.values() for skeleton in array.people)
    if not counts:
        raise InputError(f'{path}: {topics[0]}: nobody is in any message')
    if person is not None and person not in counts:
        people = ', '.join(f'{person_id} ({n})' for person_id, n in counts.most_common())
        raise InputError(f'{path}: no person {person!r}; there are {people}')
    chosen = counts.most_common(1)[0][0] if person is None else person
    with naming(f'{path}: {topics[0]}'):
        return _collect(array_by_stamp, chosen), chosen


def _collect(array_by_stamp: dict[int, RecordedSkeletons], person: str) -> StoredResult:
    """Return the skeletons of a person in messages by their stamps in ns, in the order of the stamps."""
    stamps = sorted(array_by_stamp)
    found = [next((s for s in array_by_stamp[t].people if s.id == person), None) for t in stamps]
    skeletons = {s.skeleton.name: s.skeleton for s in found if s is not None}
    if len(skeletons) > 1:
        raise InputError(f'skeletons of several layouts: {", ".join(sorted(skeletons))}')
    skeleton = next(iter(skeletons.values()))
    shape = (len(stamps), len(skeleton.joints))
    joints, seen, residual = np.full((*shape, 3), np.nan), np.zeros(shape, bool), np.full(len(stamps), np.nan)
    std, covariance = np.full(shape, np.nan), np.full((len(stamps), 3, 3), np.nan)
    for frame, recorded in enumerate(found):
        if recorded is None:
            continue
        joints[frame], seen[frame], std[frame] = recorded.joints, ~recorded.inferred, recorded.std
        residual[frame] = recorded.residual
        if np.any(recorded.root_covariance):  # version 0.1 recorded none, which is converted to zeros
            covariance[frame] = recorded.root_covariance
    times = np.array(stamps) / NS_PER_S
    return StoredResult(times, joints, seen, residual, skeleton, tuple(stamps), std, covariance)
