# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The people of a recording, each reconstructed as a whole sequence: the one way of all commands and of Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline.floor import share_floor
from mocap_ros.offline.whole_sequence import Report, Solved, report_part, solve_sequence
from mocap_ros.recordings.input_kind import RESULT_KINDS, InputKind, find_kind_with_results
from mocap_ros.recordings.load_keypoints import load_people
from mocap_ros.recordings.load_results import load_recording
from mocap_ros.recordings.recording import Recording
from mocap_ros.verdict.summary import summarise

MAX_PEOPLE = 16  # of a recording, those who are seen most, since each one takes seconds
# With the arguments of `solve_sequence`
Method = Callable[[KeypointSequence, Mapping[str, PoseModel], Config, Report], Solved]


class ReconstructionOptions(NamedTuple):
    """How an input is read and reconstructed."""

    config: Config  # parameters of tracker, solver and node
    models: Mapping[str, PoseModel]  # base poses by name
    reading: ReadingOptions = ReadingOptions()  # how the input is read
    max_people: int | None = 1  # people who are reconstructed, those who are seen most; None for all
    method: Method = solve_sequence


def reconstruct(
    source: Path | Sequence[KeypointSequence], options: ReconstructionOptions, report: Report = lambda _: None
) -> Recording:
    """Reconstruct the people of an input, who share the floor; one who fails does not stop the others.

    `report` gets the share, 0 to 1, of the work after the input is read.

    Raises:
        InputError: the input cannot be read, or nobody in it can be reconstructed; it names the path, if one is
            given.
    """
    if isinstance(source, Path):
        sequences, read = load_people(source, options.reading, only_one=options.max_people == 1)
        try:
            recording = reconstruct(sequences, options, report)
        except InputError as error:
            raise InputError(f'{source}: {error}') from None
        return recording._replace(notes=(*read, *(f'{source}: {note}' for note in recording.notes)))
    config, models, notes = options.config, options.models, list[str]()
    sequences = list(source)
    if options.max_people is not None and len(sequences) > options.max_people:
        sequences = sorted(sequences, key=lambda s: -int((s.keypoints[..., 2] > 0).any(axis=1).sum()))
        notes.append(f'{len(sequences) - options.max_people} more people are left out, who are seen less')
    sequences = sequences[: options.max_people]
    found: list[Solved] = []
    for index, sequence in enumerate(sequences):
        person_id = sequence.person_id or f'person_{index + 1}'
        try:
            solved = options.method(sequence, models, config, report_part(report, index, len(sequences)))
        except (InputError, np.linalg.LinAlgError) as error:
            if len(sequences) == 1:
                raise InputError(str(error)) from None
            notes.append(f'person {person_id!r} is left out: {error}')
            continue
        found.append(solved._replace(poses=replace(solved.poses, id=person_id)))
    if not found:
        raise InputError('\n'.join(notes) or 'the recording shows no person')
    people, faults = share_floor(found, config.tracker)
    notes += (f'tracker.camera_height {fault}' for fault in faults)
    summaries = [summarise([poses], config) for poses in people]
    together = summaries[0] if len(people) == 1 else summarise(people, config)
    judged = [replace(poses, summary=summary) for poses, summary in zip(people, summaries, strict=True)]
    return Recording(tuple(judged), together, tuple(notes))


def load_or_reconstruct(path: Path, options: ReconstructionOptions, report: Report = lambda _: None) -> Recording:
    """Load the people of a result, or of a bag with skeletons, as they are; reconstruct those of another input."""
    kind = find_kind_with_results(path)
    if kind in RESULT_KINDS:
        return load_recording(path, options.reading, options.config, report)
    if kind is InputKind.SEQUENCE:  # of one person
        options = options._replace(max_people=1)
    return reconstruct(path, options, report)
