# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a worker does with one recording: the work of a single command, and a record that it is done.

The record is removed before a result is put in its place, and written after it. A result without one is not
finished.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from upath import UPath

from mocap_ros import Config, MocapError
from mocap_ros.bags.reader import Bag
from mocap_ros.batch.recordings import BatchInput, list_files
from mocap_ros.config import to_yaml, with_values
from mocap_ros.formats.reading_options import NO_OPTIONS, ReadingOptions
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.recordings.input_kind import BAG_FORMATS, InputKind, find_input_kind, require_kind, select_options
from mocap_ros.recordings.load_keypoints import load_input
from mocap_ros.recordings.reconstruct import ReconstructionOptions, reconstruct
from mocap_ros.recordings.save_keyframes import describe_keyframes
from mocap_ros.recordings.save_results import save
from mocap_ros.runtime.cpu_setup import configure_process
from mocap_ros.runtime.provenance import provenance_attachments
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing import plots

RESULTS = 'results'  # folder of the results, below that of the run
RECORDS = 'records'  # folder of what is known of each result
UNFINISHED = '.unfinished'  # folder of local results that are being made
READ_BYTES = 1 << 20  # bytes of a file that are read at a time for its checksum; bounds the memory
KEY_DIGITS = 12  # hexadecimals of a checksum in the table, as in the short names of commits
Row = dict[str, Any]  # of the table, by column


@dataclass(frozen=True)
class Settings:
    """What a run does with every recording."""

    work: str  # name of a function of `WORK`
    out: Path  # folder of the run, on any file system
    options: ReplayOptions = ReplayOptions()  # noqa: RUF009 # is frozen; parameters and topics, also of other work
    # How recordings are read; what does not apply to the kind of one is left out for it
    reading: ReadingOptions = NO_OPTIONS
    suffix: str = '.npz'  # of reconstructions
    # Of this package, which the workers must have
    version: str = field(default_factory=lambda: version('mocap_ros'))

    @property
    def parameters(self) -> Config:
        """Parameters of all work but the replay of a bag that has its own."""
        return with_values(self.options.config or Config(), self.options.changes)

    def compute_key(self) -> str:
        """Return a checksum of all that results depend on but the recording, as the content of models.

        Raises an error if a model cannot be read.
        """
        config, detector = self.parameters, self.reading.detector
        _, provenance = provenance_attachments(config, load_base_pose_models(config.tracker.model))
        models = json.loads(provenance.data) | {'versions': None}
        content = detector.read_bytes() if detector else b''
        return _compute_key(replace(self, out=Path()), models, hashlib.sha256(content).digest())


class Outcome(NamedTuple):
    """What became of a recording."""

    status: Literal['done', 'done before', 'failed']
    rows: list[Row]  # of the table, one for each appearance of a person, or with `error`


def process(recording: BatchInput, settings: Settings, key: str) -> Outcome:
    """Do the work on one recording and put its result in its place.

    What was done before, of the same content with settings of the same `key`, is not done again.
    """
    configure_process()
    if version('mocap_ros') != settings.version:
        raise MocapError(f'the worker has version {version("mocap_ros")} of mocap_ros, not {settings.version}')
    for path in (recording.path, settings.out):
        if isinstance(path, UPath):
            path.fs.invalidate_cache()
    result = settings.out / RESULTS / recording.name
    record = settings.out / RECORDS / settings.work / f'{recording.name}.json'
    key = _compute_key(key, _compute_content_key(recording.path))
    known = _read_record(record)
    old = [result.parent / name for name in known.get('files', ())]
    if known.get('key') == key and all(file.exists() for file in old):
        return Outcome('done before', known['rows'])
    parent = None
    if not isinstance(settings.out, UPath):  # a result on the same file system is renamed to its place
        parent = settings.out / UNFINISHED
        parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=parent, ignore_cleanup_errors=True) as folder:
        made, finished = Path(folder, RESULTS), Path(folder, RECORDS)
        made.mkdir()
        path = provide_locally(recording.path, Path(folder))
        start = time.thread_time()
        rows = WORK[settings.work](path, made / result.name, settings)
        seconds = time.thread_time() - start
        rows = [{**row, 'bag_work_s': seconds} for row in rows]
        files = [str(file.relative_to(made)) for file in made.rglob('*') if file.is_file()]
        finished.write_text(json.dumps({'key': key, 'files': files, 'rows': rows}, indent=1))
        for file in (*old, record):
            file.unlink(missing_ok=True)
        for name in files:
            _move(made / name, result.parent / name)
        _move(finished, record)
    return Outcome('done', rows)


def _replay(path: Path, result: Path, settings: Settings) -> list[Row]:
    require_kind(path, [InputKind.BAG], BAG_FORMATS)
    with Bag(path) as bag:
        found = replay(bag, result, settings.options)
    row = {
        'bag_frames': found.counters.accepted,
        'bag_dropped': found.counters.dropped.total(),
        'bag_invalid': found.counters.invalid,
        'bag_swaps': found.swapped_frames,
        'grade': found.summary.grade,
        'note': '; '.join(
            filter(None, (str(found.summary), found.first_rejection, *found.tracebacks, *found.notes))
        ),
        'configuration': _compute_key(to_yaml(found.config))[:KEY_DIGITS],
    }
    rows = [
        {
            **row,
            'person': seen.person,
            'from_ns': seen.from_ns,
            'to_ns': seen.to_ns,
            **{f'{kind}_s': seconds for kind, seconds in seen.seconds.items()},
            'cadence_hz': _drop_nan(seen.cadence),
            'residual_px': _drop_nan(seen.residual),
        }
        for seen in found.appearances
    ]
    return rows or [row]


def _reconstruct(path: Path, result: Path, settings: Settings) -> list[Row]:
    config = settings.parameters
    models = load_base_pose_models(config.tracker.model)
    recording = reconstruct(path, ReconstructionOptions(config, models, _choose_reading(path, settings)))
    (poses,) = recording.people
    save(Path(f'{result}{settings.suffix}'), poses)
    row = _describe(poses.id, poses.stamps_ns, settings)
    row['residual_px'] = _drop_nan(float(np.nanmean(poses.reprojection_residual)))
    summary = recording.summary
    return [{**row, 'grade': summary.grade, 'note': '; '.join((str(summary), *recording.notes))}]


def _find_keyframes(path: Path, result: Path, settings: Settings) -> list[Row]:
    sequence, notes = load_input(path, _choose_reading(path, settings))
    found = describe_keyframes(sequence, path.name, settings.parameters)
    Path(f'{result}.yaml').write_text(found.listed, encoding='utf-8')
    plots.save_figure(found.poses, Path(f'{result}.png'))
    plots.save_figure(found.distances, Path(f'{result}_distances.png'))
    return [{**_describe(sequence.person_id, sequence.stamps_ns, settings), 'note': '; '.join(notes)}]


# What is done with a recording: functions that get its path, that of the result without a suffix, and settings,
# and return rows of the table
WORK = {'replay': _replay, 'reconstruct': _reconstruct, 'keyframes': _find_keyframes}


def _choose_reading(path: Path, settings: Settings) -> ReadingOptions:
    config = settings.parameters
    options = select_options(settings.reading, find_input_kind(path))
    return options._replace(node=config.node, tracker=config.tracker)


def _describe(person: str, stamps_ns: Sequence[int], settings: Settings) -> Row:
    """Return what the table has of the keypoints of a person."""
    start_ns, *_, end_ns = map(int, stamps_ns)
    return {
        'person': person,
        'from_ns': start_ns,
        'to_ns': end_ns,
        'unknown_s': (end_ns - start_ns) / NS_PER_S,
        'bag_frames': len(stamps_ns),
        'configuration': _compute_key(to_yaml(settings.parameters))[:KEY_DIGITS],
    }


def _drop_nan(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _compute_key(*parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _compute_content_key(path: Path) -> str:
    """Return a checksum of the content of a recording; times of change do not matter on the local file system.

    Of a file on another one counts what identifies it there, such as the ETag of S3, so that it is not read.
    """
    digest = hashlib.sha256()
    for file in list_files(path):
        digest.update(os.fsencode(file.name) + b'\0')
        if isinstance(file, UPath):
            digest.update(str(file.fs.checksum(file.path)).encode())
            continue
        with file.open('rb') as stream:
            while block := stream.read(READ_BYTES):
                digest.update(block)
    return digest.hexdigest()


def provide_locally(path: Path, folder: Path) -> Path:
    """Return a path under which a recording can be read: of a remote one that is no MCAP, that of a local copy.

    Remote MCAP is read where it is, by ranges.
    """
    if not isinstance(path, UPath) or any(file.suffix == '.mcap' for file in list_files(path)):
        return path
    copy = folder / path.name
    path.fs.get(path.path, str(copy), recursive=True)
    return copy


def _move(finished: Path, place: Path) -> None:
    """Move a file of the local disk to its place, whole: renamed, or sent to another file system."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(place, UPath):
        place.fs.put_file(str(finished), place.path)
    else:
        finished.replace(place)


def _read_record(path: Path) -> dict[str, Any]:
    """Return what is known of a result; empty if there is no record, or if it is damaged."""
    try:
        return dict(json.loads(path.read_text()))
    except (OSError, ValueError):
        return {}
