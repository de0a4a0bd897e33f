# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a worker does with one recording. Results are put in their place when they are complete."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np
from upath import UPath

from mocap_ros.api.files import write
from mocap_ros.api.reconstruct import reconstruct
from mocap_ros.bags.reader import ROS2_SUFFIXES, Bag
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.batch.recordings import Recording, Work, compute_content_key, is_local, open_file_system
from mocap_ros.config import Config, Value, to_yaml, with_values
from mocap_ros.errors import InputError, MocapError, RecordingError, make_printable_line
from mocap_ros.formats.detections import Video
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.keyframes.keyframe_method import find_keyframes, observe_plausible_points
from mocap_ros.people import MotionKind
from mocap_ros.runtime.appearances import Appearance
from mocap_ros.runtime.cpu_setup import configure_process
from mocap_ros.runtime.input_kind import BAG_FORMATS, InputKind, find_input_kind, require_kind
from mocap_ros.runtime.load_keypoints import InputOptions, load_input
from mocap_ros.runtime.provenance import provenance_attachments
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.runtime.save_results import SUFFIXES, format_yaml
from mocap_ros.runtime.summary import Summary
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing import plots
from mocap_ros.viewing.keyframe_plots import draw_distances_figure, draw_keyframes_figure

RESULTS = 'results'  # folder of the results, below that of the run
RECORDS = 'records'  # folder of what is known of each result; a result without a record is not finished
UNFINISHED = '.unfinished'  # folder of local results that are being written
OWN_FOLDERS = (RESULTS, RECORDS, UNFINISHED)  # they are not part of the corpus
# Ends of the names of files that a result may consist of; nothing else is ever removed.
RESULT_SUFFIXES = (*ROS2_SUFFIXES, '.yaml', '.png', '.json', *SUFFIXES)
KEY_DIGITS = 12  # hexadecimals of a checksum in the table, as in the short names of commits
# The columns of the table, and the type of each in Arrow. `bag_` begins what counts for the whole bag, and is the
# same in all its rows.
COLUMNS = {
    'bag': 'string',
    'url': 'string',
    'person': 'string',
    'from_ns': 'int64',
    'to_ns': 'int64',
    **{f'{kind.name.lower()}_s': 'float64' for kind in MotionKind},
    'cadence_hz': 'float64',
    'residual_px': 'float64',
    'bag_frames': 'int64',
    'bag_dropped': 'int64',
    'bag_invalid': 'int64',
    'bag_swaps': 'int64',
    'bag_work_s': 'float64',
    'grade': 'string',
    'note': 'string',
    'error': 'string',
    'version': 'string',
    'configuration': 'string',
}
Rows = list[dict[str, Any]]  # rows of the table, a row for each appearance of a person


@dataclass(frozen=True)
class Settings:
    """What a run does with every recording."""

    work: Work
    out: str  # path or URL of the folder of the run
    config: Config | None = None  # parameters; None for those of the recorded runs, or the defaults
    # Values of single parameters by name, which replace those of `config` or of the recorded runs
    changes: Mapping[str, Value] = field(default_factory=dict)
    # Topic of the keypoints, and `camera_info` that of the CameraInfo; needed for bags with several
    topic: str | None = None
    camera_info: str | None = None
    # What JSON files do not state
    video: Video = Video()  # noqa: RUF009 # is frozen
    suffix: str = '.npz'  # of reconstructions, such as `.npz`
    version: str = ''  # version of this package, which the workers must have
    key: str = ''  # checksum of all that results depend on but the recording

    @property
    def parameters(self) -> Config:
        """Parameters of all work but the replay of a bag that has its own."""
        return with_values(self.config or Config(), self.changes)

    def place(self, *parts: str) -> str:
        """Return the path or URL of something in the folder of the run."""
        return '/'.join((self.out.rstrip('/'), *parts))

    def seal(self) -> Settings:
        """Return the settings with the version of this package and the checksum."""
        config, detector = self.parameters, self.video.detector
        try:
            detector_key = hashlib.sha256(detector.read_bytes()).hexdigest() if detector else ''
        except OSError as error:
            raise InputError(f'{detector}: {error.strerror}') from None
        _, provenance = provenance_attachments(config, load_base_pose_models(config.tracker.model))
        models = json.loads(provenance.data) | {'versions': None}
        own = replace(self, out='', video=replace(self.video, detector=None), version=version('mocap_ros'))
        return replace(self, version=own.version, key=_compute_key([repr(own), models, detector_key]))


class Status(str, Enum):
    """What became of a recording."""

    DONE = 'done'
    DONE_BEFORE = 'done before'
    FAILED = 'failed'


@dataclass(frozen=True)
class Job:
    """The work on a recording, with sealed settings."""

    recording: Recording
    settings: Settings

    @property
    def result_url(self) -> str:
        """URL of the result, without the suffix of a file."""
        return self.settings.place(RESULTS, self.recording.name)

    @property
    def record_url(self) -> str:
        """URL of the record of the result."""
        return self.settings.place(RECORDS, self.settings.work.value, f'{self.recording.name}.json')

    @property
    def columns(self) -> dict[str, Any]:
        """A row of the table with what is known before the work."""
        known = {'bag': self.recording.name, 'url': self.recording.url, 'version': self.settings.version}
        return {**dict.fromkeys(COLUMNS), **known}

    def fail(self, reason: str) -> Outcome:
        """Return the outcome of work that failed for a reason, one line of text."""
        url = make_printable_line(self.recording.url)
        reason = reason if url in reason else f'{url}: {reason}'
        return Outcome(self, Status.FAILED, reason, [{**self.columns, 'error': reason}])


@dataclass(frozen=True)
class Outcome:
    """What became of a recording: why it failed, rows of the table, and CPU seconds of work."""

    job: Job
    status: Status
    reason: str = ''
    rows: Rows = field(default_factory=list)
    seconds: float = 0.0


def process(job: Job) -> Outcome:
    """Do the work on one recording and put its result in its place; why that failed is in the outcome.

    What was done before, of the same content with the same settings, is not done again.
    """
    configure_process()
    try:
        return _process(job)
    except Exception as error:  # whatever a recording causes, the others are done
        reason = ' '.join(str(error).split())
        if isinstance(error, OSError):
            reason = error.strerror or reason or type(error).__name__
        elif not isinstance(error, MocapError):
            reason = f'internal error: {type(error).__name__}: {reason}'
        return job.fail(reason)


def _process(job: Job) -> Outcome:
    settings = job.settings
    if version('mocap_ros') != settings.version:
        raise MocapError(f'the worker has version {version("mocap_ros")} of mocap_ros, not {settings.version}')
    key = f'{settings.key} {compute_content_key(job.recording)}'
    known = read_record(job.record_url)
    if known.get('key') == key and all(list_sizes(url) == sizes for url, sizes in known['results'].items()):
        return Outcome(job, Status.DONE_BEFORE, '', known['rows'], known['seconds'])
    parent = None
    if is_local(settings.out):  # a result on the same file system is renamed to its place
        parent = Path(open_file_system(settings.out)[1]) / UNFINISHED
        parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=parent, ignore_cleanup_errors=True) as folder:
        scratch = Path(folder)
        path = provide_locally(job.recording, scratch)
        start = time.thread_time()
        files, rows = _FUNCTIONS[settings.work](path, job, scratch)
        seconds = time.thread_time() - start
        for url, finished in files.items():
            publish(finished, url)
    rows = [{**job.columns, **row, 'bag_work_s': seconds} for row in rows]
    record = {'key': key, 'results': {url: list_sizes(url) for url in files}, 'rows': rows, 'seconds': seconds}
    write_file(job.record_url, json.dumps(record, indent=1).encode())
    return Outcome(job, Status.DONE, '', rows, seconds)


def _replay(path: Path, job: Job, scratch: Path) -> tuple[dict[str, Path], Rows]:
    settings = job.settings
    require_kind(path, [InputKind.BAG], BAG_FORMATS)
    out = scratch / PurePosixPath(job.recording.name).name
    with Bag(path) as bag:
        options = ReplayOptions(settings.config, settings.topic, settings.camera_info, changes=settings.changes)
        found = replay(bag, out, options)
    note = ' '.join(
        (
            describe_unsound(found.summary)
            or found.first_rejection
            or ' '.join(found.tracebacks)
            or ' '.join(found.notes)
        ).split()
    )
    columns = {
        'bag_frames': found.counters.accepted,
        'bag_dropped': found.counters.dropped.total(),
        'bag_invalid': found.counters.invalid,
        'bag_swaps': found.swapped_frames,
        'configuration': _compute_key(to_yaml(found.config))[:KEY_DIGITS],
        'grade': found.summary.grade,
        'note': note,
    }
    return {job.result_url: out}, [{**columns, **_describe(a)} for a in found.appearances] or [columns]


def _reconstruct(path: Path, job: Job, scratch: Path) -> tuple[dict[str, Path], Rows]:
    sequence, columns = _load_sequence(path, job)
    poses = reconstruct(sequence, parameters=job.settings.parameters)
    out = scratch / f'result{job.settings.suffix}'
    write(out, poses)
    residual = _drop_nan(float(np.nanmean(poses.residual)))
    columns |= {'residual_px': residual, 'grade': poses.summary.grade}
    columns['note'] = '; '.join(filter(None, (describe_unsound(poses.summary), columns['note'])))
    return {job.result_url + job.settings.suffix: out}, [columns]


def describe_unsound(summary: Summary) -> str:
    """Return the grade and the reason of an input that is not sound; empty if it is."""
    return summary.reason and f'{summary.grade}: {summary.reason}'


def _find_keyframes(path: Path, job: Job, scratch: Path) -> tuple[dict[str, Path], Rows]:
    config, name = job.settings.parameters, PurePosixPath(job.recording.name).name
    sequence, columns = _load_sequence(path, job)
    observations = extract_observations(sequence, config.tracker.nominal_focal_length)
    observed = observe_plausible_points(*observations, config.tracker)
    keyframes = find_keyframes(observed, config.keyframes)
    listed, poses, distances = (scratch / f'result{suffix}' for suffix in ('.yaml', '.png', '_distances.png'))
    text = format_yaml(observed, keyframes, plots.make_printable(name), sequence.stamps_ns[0])
    listed.write_text(text, encoding='utf-8')
    plots.save_figure(draw_keyframes_figure(observed, keyframes, name), poses)
    plots.save_figure(draw_distances_figure(observed, keyframes, config.keyframes.beta, name), distances)
    return {job.result_url + p.name.removeprefix('result'): p for p in (listed, poses, distances)}, [columns]


_FUNCTIONS = {Work.REPLAY: _replay, Work.RECONSTRUCT: _reconstruct, Work.KEYFRAMES: _find_keyframes}


def _load_sequence(path: Path, job: Job) -> tuple[KeypointSequence, dict[str, Any]]:
    """Load the keypoints of the person who is seen most; return them, and the columns that describe them.

    Options that do not apply to a kind of input are left out, because a corpus may hold several kinds.
    """
    settings, kind, config = job.settings, find_input_kind(path), job.settings.parameters
    video = replace(settings.video, detector=settings.video.detector if kind is InputKind.VIDEO else None)
    if kind in (InputKind.SEQUENCE, InputKind.VIDEO, InputKind.BAG):
        video = Video(detector=video.detector, hfov=video.hfov, focal=video.focal)
    if kind is InputKind.SPORTS2D:
        video = replace(video, fps=None, layout='')
    topics = (settings.topic, settings.camera_info) if kind is InputKind.BAG else (None, None)
    sequence, lines = load_input(path, InputOptions(video, config.node, None, *topics, tracker=config.tracker))
    stamps = sequence.stamps_ns
    appearance = Appearance(sequence.person_id or '', int(stamps[0]), int(stamps[-1]))
    appearance.seconds['unknown'] = (stamps[-1] - stamps[0]) / NS_PER_S
    return sequence, {
        'bag_frames': len(sequence),
        'configuration': _compute_key(to_yaml(config))[:KEY_DIGITS],
        'note': '; '.join(lines),
        **_describe(appearance),
    }


def _describe(appearance: Appearance) -> dict[str, Any]:
    return {
        'person': appearance.person,
        'from_ns': appearance.from_ns,
        'to_ns': appearance.to_ns,
        **{f'{kind}_s': seconds for kind, seconds in appearance.seconds.items()},
        'cadence_hz': _drop_nan(appearance.cadence),
        'residual_px': _drop_nan(appearance.residual),
    }


def _drop_nan(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _compute_key(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def provide_locally(recording: Recording, scratch: Path) -> Path:
    """Return a path under which a recording can be read.

    This is the place of a local recording. A remote one in MCAP is read where it is, by ranges. Any other remote
    one is copied into a temporary folder first.
    """
    if is_local(recording.url):
        return Path(open_file_system(recording.url)[1])
    if all(url.endswith(('.mcap', f'/{METADATA}')) for url in recording.files):
        return cast(Path, UPath(recording.url))  # has the methods of a path that the reader of bags uses
    if recording.size_bytes > shutil.disk_usage(scratch).free:
        size = f'{recording.size_bytes / 1e9:.2f} GB'
        raise InputError(f'{recording.url}: {size} must be copied to be read, more than is free at {scratch}')
    copy = scratch / recording.url.rpartition('/')[2]
    fs, path = open_file_system(recording.url)
    fs.get(path, str(copy), recursive=True)
    return copy


def publish(finished: Path, url: str) -> None:
    """Move a finished file or folder of the local disk to its place, and replace what is there.

    On the local file system it is renamed. On others the files are sent one by one, each of them whole, and the
    description of a bag last, without which its other files are no bag. What no run writes is never replaced.
    """
    fs, path = open_file_system(url)
    old = list_sizes(url)
    if foreign := [file for file in old if not f'{url}{file}'.endswith(RESULT_SUFFIXES)]:
        raise RecordingError(f'{url}: not replaced, because no run writes the file {path}{foreign[0]}')
    if old:
        fs.rm(path, recursive=True)
    if is_local(url):
        fs.makedirs(path.rpartition('/')[0], exist_ok=True)
        finished.replace(path)
        return
    files = [finished] if finished.is_file() else [f for f in finished.rglob('*') if f.is_file()]
    for file in sorted(files, key=lambda f: f.name == METADATA):
        target = path + str(file)[len(str(finished)) :]
        fs.makedirs(target.rpartition('/')[0], exist_ok=True)
        fs.put_file(str(file), target)


def list_sizes(url: str) -> dict[str, int]:
    """Return the size in bytes of every file at or below a URL, by its path below it; empty if there is none."""
    fs, path = open_file_system(url)
    fs.invalidate_cache()
    if not fs.exists(path):
        return {}
    return {
        file[len(path) :]: int(info['size'] if 'size' in info else fs.size(file))
        for file, info in fs.find(path, detail=True).items()
    }


def write_file(url: str, data: bytes) -> None:
    """Write a file, and make the folders that it is in."""
    fs, path = open_file_system(url)
    fs.makedirs(path.rpartition('/')[0], exist_ok=True)
    fs.pipe_file(path, data)


def read_record(url: str) -> dict[str, Any]:
    """Return what is known of a result; empty if there is no record, or if it is damaged."""
    fs, path = open_file_system(url)
    try:
        content = json.loads(fs.cat_file(path))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
