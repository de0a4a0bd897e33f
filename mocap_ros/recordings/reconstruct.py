# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The people of a recording, each reconstructed as a whole sequence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import (
    Report,
    SequenceResult,
    reconstruct_without_floor,
    report_part,
    share_floor,
)

# With the arguments of `reconstruct_without_floor`
Method = Callable[
    [Array, tuple[str, ...], Array, Intrinsics, Mapping[str, BasePoses], Config, Report], SequenceResult
]


class Reconstructed(NamedTuple):
    """A person of a recording."""

    place: int  # index among the people of the recording
    sequence: KeypointSequence
    person_id: str
    result: SequenceResult


def reconstruct_people(
    sequences: Sequence[KeypointSequence],
    models: Mapping[str, BasePoses],
    config: Config,
    report: Report,
    method: Method = reconstruct_without_floor,
) -> tuple[list[Reconstructed], list[str]]:
    """Reconstruct the people of a recording, who share the floor; one who fails does not stop the others.

    Returns those who were reconstructed, and a line for each of the others.
    """
    found: list[Reconstructed] = []
    left_out: list[str] = []
    for index, sequence in enumerate(sequences):
        person_id = sequence.person_id or f'person_{index + 1}'
        try:
            observations = extract_observations(sequence, config.tracker.nominal_focal_length)
            result = method(*observations, models, config, report_part(report, index, len(sequences)))
        except (InputError, np.linalg.LinAlgError) as error:
            if len(sequences) == 1:
                raise InputError(str(error)) from None
            left_out.append(f'person {person_id!r} is left out: {error}')
            continue
        found.append(Reconstructed(index, sequence, person_id, result))
    if not found:
        raise InputError('\n'.join(left_out) or 'the recording shows no person')
    results = share_floor(
        [person.result for person in found], [person.sequence.timestamps for person in found], config.tracker
    )
    return [p._replace(result=result) for p, result in zip(found, results, strict=True)], left_out
