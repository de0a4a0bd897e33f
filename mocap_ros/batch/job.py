# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a worker does with one recording."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, field, replace
from enum import Enum
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import yaml
from distributed import get_worker

from mocap_ros.api.files import write
from mocap_ros.api.reconstruct import reconstruct
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA, encode_yaml, join_descriptions
from mocap_ros.batch.file_systems import find_file_system, is_local
from mocap_ros.batch.recordings import DISTANCES_SUFFIX, Recording, Work, compute_content_key
from mocap_ros.batch.storage import (
    is_disk_full,
    join_url,
    list_sizes,
    provide_locally,
    publish,
    read_json_file,
    remove_result,
    write_whole,
)
from mocap_ros.config import Config, Value, to_yaml, with_values
from mocap_ros.errors import InputError, MocapError, make_printable_line
from mocap_ros.formats.detections import Video
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.keyframes.reconstruct import find_keyframes, observe_plausible_points
from mocap_ros.people import MotionKind
from mocap_ros.runtime.appearances import Appearance
from mocap_ros.runtime.cpu_setup import configure_process
from mocap_ros.runtime.input_kind import BAG_FORMATS, InputKind, find_input_kind, require_kind
from mocap_ros.runtime.load_keypoints import load_input
from mocap_ros.runtime.parts import Part, find_parts
from mocap_ros.runtime.provenance import provenance_attachments
from mocap_ros.runtime.replay import ReplayOptions, read_recorded_config, replay
from mocap_ros.runtime.save_keyframes import format_yaml
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing import plots
from mocap_ros.viewing.keyframe_plots import draw_distances_figure, draw_keyframes_figure

RESULTS = 'results'  # folder of the results, below that of the run
RECORDS = 'records'  # folder of what is known of each result; a result without a record is not finished
PARTS = 'parts'  # folder of the parts of bags that were cut, until they are joined
UNFINISHED = '.unfinished'  # folder of local results that are being written
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
    'remark': 'string',
    'error': 'string',
    'version': 'string',
    'configuration': 'string',
}
KEY_DIGITS = 12  # hexadecimals of a checksum in the table, as in the short names of commits


@dataclass(frozen=True)
class Settings:
    """What a run does with every recording.

    Attributes:
        work: what is done.
        out: path or URL of the folder of the run.
        config: parameters; None for those of the recorded runs, or the defaults.
        changes: values of single parameters by name, which replace those of `config` or of the recorded runs.
        topic: topic of the keypoints; needed only for bags with several.
        camera_info: topic of the CameraInfo; needed only for bags with several.
        video: what JSON files do not state.
        suffix: of reconstructions, such as `.npz`.
        cut_seconds: s, length from which on a bag may be cut into parts of at least this length; 0: never.
        copy_limit_bytes: size of a remote recording above which it is not copied to be read.
        version: version of this package, which the workers must have.
        key: checksum of all that results depend on but the recording: work, parameters, models (also that of a
            detector) and version.
    """

    work: Work
    out: str
    config: Config | None = None
    changes: Mapping[str, Value] = field(default_factory=dict)
    topic: str | None = None
    camera_info: str | None = None
    video: Video = Video()  # noqa: RUF009 # is frozen
    suffix: str = '.npz'
    cut_seconds: float = 0.0
    copy_limit_bytes: int = 20_000_000_000
    version: str = ''
    key: str = ''

    @property
    def parameters(self) -> Config:
        """Parameters of all work but the replay of a bag that has its own."""
        return with_values(self.config or Config(), self.changes)

    def seal(self) -> Settings:
        """Return the settings with the version of this package and the checksum.

        Raises:
            ModelError: the models that the parameters name cannot be loaded.
            ConfigError: a parameter of `changes` is unknown, or its value is wrong.
            InputError: the model of the detector cannot be read.
        """
        config = self.parameters
        _, provenance = provenance_attachments(config, load_base_pose_models(config.tracker.model))
        models = json.loads(provenance.data)
        content = {
            'work': self.work.value,
            'version': version('mocap_ros'),
            'parameters': to_yaml(self.config) if self.config else '',
            'changes': dict(self.changes),
            'models': [models['models'], models.get('lifter')],
            'input': [self.topic, self.camera_info, asdict(replace(self.video, detector=None))],
            'detector': _compute_file_checksum(self.video.detector),
            'suffix': self.suffix,
        }
        key = hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()
        return replace(self, version=version('mocap_ros'), key=key)


def _compute_file_checksum(path: Path | None) -> str:
    """Return the checksum of a file, or nothing where there is none."""
    if path is None:
        return ''
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f'{path}: {error.strerror}') from None


class Status(str, Enum):
    """What became of a recording."""

    DONE = 'done'
    DONE_BEFORE = 'done before'
    CUT = 'cut'  # its parts are to be done
    FAILED = 'failed'
    DISK_FULL = 'disk full'  # of this worker


@dataclass(frozen=True)
class Job:
    """The work on a recording, or on a part of it.

    Attributes:
        recording: the recording.
        settings: what is done, sealed.
        part: the part; None for the whole recording.
        run: id of the run, by which it knows what it has done itself; empty where it does not matter.
    """

    recording: Recording
    settings: Settings
    part: Part | None = None
    run: str = ''

    @property
    def result_url(self) -> str:
        """URL of the result, without the suffix of a file."""
        if self.part is None:
            return join_url(self.settings.out, RESULTS, self.recording.name)
        return join_url(self.settings.out, PARTS, self.recording.name, str(self.part.number))

    @property
    def record_url(self) -> str:
        """URL of the record of the result."""
        if self.part is None:
            return join_url(self.settings.out, RECORDS, self.settings.work.value, f'{self.recording.name}.json')
        return join_url(self.settings.out, PARTS, self.recording.name, f'{self.part.number}.json')

    @property
    def bounds(self) -> str:
        """Checksum of where the part begins and ends and of what it begins with; empty for the whole recording."""
        return '' if self.part is None else hashlib.sha256(repr(astuple(self.part)).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """What became of a recording, or of a part of it.

    Attributes:
        job: the work.
        status: what became of it.
        reason: why it failed, in one line.
        rows: the rows of the table, a row for each appearance of a person.
        seconds: CPU seconds of work.
        worker: address of the worker.
        parts: the parts of a recording that is to be cut.
    """

    job: Job
    status: Status
    reason: str = ''
    rows: tuple[dict[str, Any], ...] = ()
    seconds: float = 0.0
    worker: str = ''
    parts: tuple[Part, ...] = ()


@dataclass
class _Result:
    """What the work on a recording gave.

    Attributes:
        files: files and folders in a temporary folder, by the URL of their place.
        rows: rows of the table.
    """

    files: dict[str, Path]
    rows: list[dict[str, Any]]


def process(job: Job) -> Outcome:
    """Do the work on one recording, or on a part of it, and put its result in its place.

    What was done before, of the same content with the same settings, is not done again. Nothing is raised.
    """
    configure_process()
    return _report_errors(job, _process)


def join_parts(job: Job, outcomes: Sequence[Outcome]) -> Outcome:
    """Make one bag of the parts of a recording; if a part failed, the whole has failed. Nothing is raised.

    Args:
        job: the work on the whole recording.
        outcomes: what became of its parts, in their order.
    """
    failed = next((o for o in outcomes if o.status not in (Status.DONE, Status.DONE_BEFORE)), None)
    if failed is not None:
        return replace(describe_failure(job, failed.reason, failed.status), worker=failed.worker)
    return _report_errors(job, lambda _: _join(job, outcomes))


def _report_errors(job: Job, work: Callable[[Job], Outcome]) -> Outcome:
    """Return the outcome of the work, or that which describes its error."""
    try:
        return replace(work(job), worker=_find_worker_address())
    except Exception as error:
        status = Status.DISK_FULL if is_disk_full(error) else Status.FAILED
        outcome = describe_failure(job, _describe_error(error, job.recording.url), status)
        return replace(outcome, worker=_find_worker_address())


def describe_failure(job: Job, reason: str, status: Status = Status.FAILED) -> Outcome:
    """Return the outcome of a job that failed for a reason, one line of text."""
    return Outcome(job, status, reason, (_describe_bag(job, error=reason),))


def _describe_error(error: Exception, url: str) -> str:
    """Return in one line why the work on a recording failed."""
    text = ' '.join(str(error).split())
    if isinstance(error, MocapError):
        return text if make_printable_line(url) in text else f'{url}: {text}'
    if isinstance(error, OSError):
        return f'{url}: {error.strerror or text or type(error).__name__}'
    return f'{url}: internal error: {type(error).__name__}: {text}'


def _find_worker_address() -> str:
    """Return the address of the worker that runs this task; empty outside a worker."""
    try:
        return str(get_worker().address)
    except ValueError:
        return ''


def _process(job: Job) -> Outcome:
    settings = job.settings
    if version('mocap_ros') != settings.version:
        raise MocapError(f'the worker has version {version("mocap_ros")} of mocap_ros, not {settings.version}')
    content = compute_content_key(job.recording)
    if (known := _find_known_outcome(job, content)) is not None:
        return known
    with _open_scratch(settings.out) as scratch:
        path = provide_locally(job.recording, scratch, settings.copy_limit_bytes)
        parts = _find_parts(path, settings) if job.part is None else []
        if len(parts) > 1:
            return Outcome(job, Status.CUT, parts=tuple(parts))
        start = time.thread_time()
        result = _FUNCTIONS[settings.work](path, job, scratch)
        seconds = time.thread_time() - start
        for url, finished in result.files.items():
            publish(finished, url)
    rows = [{**_describe_bag(job), **row, 'bag_work_s': seconds} for row in result.rows]
    _write_record(job, content, list(result.files), rows, seconds)
    return Outcome(job, Status.DONE, '', tuple(rows), seconds)


def _find_known_outcome(job: Job, content: str) -> Outcome | None:
    """Return the outcome of the same work on the same content, done before, if its result is still there.

    Where this run has done it, its worker was lost before it could tell.
    """
    record = read_json_file(job.record_url)
    if [record.get(key) for key in ('content', 'settings', 'part')] != [content, job.settings.key, job.bounds]:
        return None
    if any(list_sizes(url) != sizes for url, sizes in record['results'].items()):
        return None
    status = Status.DONE if job.run and record.get('run') == job.run else Status.DONE_BEFORE
    return Outcome(job, status, '', tuple(record['rows']), record['seconds'])


def _write_record(
    job: Job, content: str, urls: Sequence[str], rows: Sequence[dict[str, Any]], seconds: float
) -> None:
    """Write what is known of a result, which makes it finished."""
    record = {
        'content': content,
        'settings': job.settings.key,
        'part': job.bounds,
        'run': job.run,
        'results': {url: list_sizes(url) for url in urls},
        'rows': list(rows),
        'seconds': seconds,
    }
    write_whole(job.record_url, json.dumps(record, indent=1).encode())


@contextmanager
def _open_scratch(out: str) -> Iterator[Path]:
    """Provide a temporary folder: beside the results if they are local, else in the folder of the worker."""
    if is_local(out):
        parent = Path(find_file_system(out)[1]) / UNFINISHED
        parent.mkdir(parents=True, exist_ok=True)
    else:
        try:
            parent = Path(get_worker().local_directory)
        except ValueError:
            parent = Path(tempfile.gettempdir())
    with tempfile.TemporaryDirectory(dir=parent, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def list_own_folders(settings: Settings) -> list[str]:
    """Return the URLs of the folders of a run that hold bags, which are no recordings of the corpus."""
    return [join_url(settings.out, folder) for folder in (RESULTS, RECORDS, PARTS, UNFINISHED)]


def remove_unfinished(settings: Settings) -> None:
    """Remove what lost workers have left in the folder of a run that has ended."""
    if is_local(settings.out):
        shutil.rmtree(Path(find_file_system(settings.out)[1]) / UNFINISHED, ignore_errors=True)


def _find_parts(path: Path, settings: Settings) -> list[Part]:
    """Return the parts into which a bag is cut; none if it is not to be cut."""
    if not settings.cut_seconds or settings.work is not Work.REPLAY:
        return []
    require_kind(path, [InputKind.BAG], BAG_FORMATS)
    with Bag(path) as bag:
        if bag.duration_s < settings.cut_seconds:
            return []
        config = settings.parameters
        if settings.config is None:
            config = read_recorded_config(bag, settings.changes)
        return find_parts(bag, config, settings.topic, settings.camera_info, min_seconds=settings.cut_seconds)


def _replay(path: Path, job: Job, scratch: Path) -> _Result:
    """Replay a bag, or a part of it."""
    settings, part = job.settings, job.part
    require_kind(path, [InputKind.BAG], BAG_FORMATS)
    stem = PurePosixPath(job.recording.name).name
    out = scratch / (stem if part is None else f'{stem}_part{part.number}')
    with Bag(path) as bag:
        options = ReplayOptions(settings.config, settings.topic, settings.camera_info, part, settings.changes)
        found = replay(bag, out, options)
    bag_values = {
        'bag_frames': found.counters.accepted,
        'bag_dropped': found.counters.dropped.total(),
        'bag_invalid': found.counters.invalid,
        'bag_swaps': found.swapped_frames,
        'configuration': _name_parameters(found.config),
    }
    remark = ' '.join((found.first_rejection or ' '.join(found.tracebacks) or ' '.join(found.remarks)).split())
    rows = [{**bag_values, **_describe_appearance(a)} for a in found.appearances] or [dict(bag_values)]
    return _Result({job.result_url: out}, [{**row, 'remark': remark} for row in rows])


def _describe_appearance(appearance: Appearance) -> dict[str, Any]:
    """Return the columns of the table that describe an appearance."""
    return {
        'person': appearance.person,
        'from_ns': appearance.from_ns,
        'to_ns': appearance.to_ns,
        **{f'{kind}_s': seconds for kind, seconds in appearance.seconds.items()},
        'cadence_hz': _drop_nan(appearance.cadence),
        'residual_px': _drop_nan(appearance.residual),
    }


def _select_options(settings: Settings, kind: InputKind) -> tuple[Video, str | None, str | None]:
    """Return the options that apply to a kind of input, because a corpus may hold several kinds.

    Returns:
        Options of a video and of JSON, the topic of the keypoints and that of the CameraInfo.
    """
    lens = Video(hfov=settings.video.hfov, focal=settings.video.focal)
    if kind is InputKind.SEQUENCE:
        return lens, None, None
    if kind is InputKind.VIDEO:
        return replace(lens, detector=settings.video.detector), None, None
    if kind is InputKind.BAG:
        return lens, settings.topic, settings.camera_info
    return replace(settings.video, detector=None), None, None


def _load_sequence(path: Path, job: Job) -> tuple[KeypointSequence, dict[str, Any]]:
    """Load the keypoints of the person who is seen most; return them, and the columns that describe them."""
    config = job.settings.parameters
    video, topic, camera_info = _select_options(job.settings, find_input_kind(path))
    sequence, lines = load_input(path, video, config.node, None, topic, camera_info)
    stamps = sequence.stamps_ns
    appearance = Appearance(sequence.person_id or '', int(stamps[0]), int(stamps[-1]))
    appearance.seconds['unknown'] = (stamps[-1] - stamps[0]) / NS_PER_S
    columns = {
        'bag_frames': len(sequence),
        'configuration': _name_parameters(config),
        'remark': '; '.join(lines),
        **_describe_appearance(appearance),
    }
    return sequence, columns


def _reconstruct(path: Path, job: Job, scratch: Path) -> _Result:
    """Reconstruct a person over the whole recording."""
    sequence, columns = _load_sequence(path, job)
    poses = reconstruct(sequence, parameters=job.settings.parameters)
    out = scratch / f'result{job.settings.suffix}'
    write(out, poses)
    residual = float(np.nanmean(poses.residual))
    return _Result({job.result_url + job.settings.suffix: out}, [{**columns, 'residual_px': _drop_nan(residual)}])


def _find_keyframes(path: Path, job: Job, scratch: Path) -> _Result:
    """Find the keyframes of a recording and draw them."""
    config, name = job.settings.parameters, PurePosixPath(job.recording.name).name
    sequence, columns = _load_sequence(path, job)
    observations = extract_observations(sequence, config.tracker.nominal_focal_length)
    observed = observe_plausible_points(*observations, config.tracker)
    keyframes = find_keyframes(observed, config.keyframes)
    files = {suffix: scratch / f'result{suffix}' for suffix in ('.yaml', '.png', DISTANCES_SUFFIX)}
    text = format_yaml(observed, keyframes, plots.make_printable(name), sequence.stamps_ns[0])
    files['.yaml'].write_text(text, encoding='utf-8')
    plots.save_figure(draw_keyframes_figure(observed, keyframes, name), files['.png'])
    plots.save_figure(
        draw_distances_figure(observed, keyframes, config.keyframes.beta, name), files[DISTANCES_SUFFIX]
    )
    return _Result({job.result_url + suffix: file for suffix, file in files.items()}, [columns])


_FUNCTIONS = {Work.REPLAY: _replay, Work.RECONSTRUCT: _reconstruct, Work.KEYFRAMES: _find_keyframes}


def _join(job: Job, outcomes: Sequence[Outcome]) -> Outcome:
    """Make one bag of the files of the parts, which stay as they are, and of one description."""
    settings, seconds = job.settings, sum(o.seconds for o in outcomes)
    parts = [o.job.result_url for o in outcomes]
    with _open_scratch(settings.out) as scratch:
        folder = scratch / 'bag'
        folder.mkdir()
        descriptions = []
        for url in parts:
            fs, path = find_file_system(url)
            fs.invalidate_cache()
            description = yaml.safe_load(fs.cat_file(f'{path}/{METADATA}'))
            descriptions.append(description[BAG_INFORMATION])
            for name in descriptions[-1]['relative_file_paths']:
                if is_local(url):
                    _link_or_copy(f'{path}/{name}', folder / name)
                else:
                    fs.get_file(f'{path}/{name}', str(folder / name))
        content = {BAG_INFORMATION: join_descriptions(descriptions)}
        (folder / METADATA).write_text(encode_yaml(content), encoding='utf-8')
        publish(folder, job.result_url)
    rows = _add_up([row for o in outcomes for row in o.rows], seconds)
    _write_record(job, compute_content_key(job.recording), [job.result_url], rows, seconds)
    remove_result(join_url(settings.out, PARTS, job.recording.name))
    return Outcome(job, Status.DONE, '', tuple(rows), seconds)


def _link_or_copy(file: str, place: Path) -> None:
    """Give a file a second name or, on file systems without such, as memory sticks and some servers, copy it."""
    try:
        os.link(file, place)
    except OSError:
        shutil.copyfile(file, place)


def _add_up(rows: Sequence[dict[str, Any]], seconds: float) -> list[dict[str, Any]]:
    """Return the rows of a recording, given those of its parts; what counts for the bag is added up."""
    counted = ('bag_frames', 'bag_dropped', 'bag_invalid', 'bag_swaps')
    by_part = {row['part']: row for row in rows}
    totals = {name: sum(row[name] or 0 for row in by_part.values()) for name in counted}
    with_people = [row for row in rows if row['person'] is not None] or [rows[0]]
    remark = next((row['remark'] for row in rows if row['remark']), '')
    return [{**row, **totals, 'bag_work_s': seconds, 'part': None, 'remark': remark} for row in with_people]


def _describe_bag(job: Job, error: str | None = None) -> dict[str, Any]:
    """Return a row of the table with what is known of a recording before the work on it."""
    return {
        **dict.fromkeys(COLUMNS),
        'bag': job.recording.name,
        'url': job.recording.url,
        'part': None if job.part is None else job.part.number,
        'error': error,
        'version': job.settings.version,
    }


def _name_parameters(config: Config) -> str:
    """Return the first digits of a checksum of all parameters."""
    return hashlib.sha256(to_yaml(config).encode()).hexdigest()[:KEY_DIGITS]


def _drop_nan(value: float) -> float | None:
    """Return a number, or None in the place of NaN, which JSON does not know."""
    return value if np.isfinite(value) else None
