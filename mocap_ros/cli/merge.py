# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros merge`: merge the people whom several cameras saw."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mocap_ros.cli.cameras import describe_cameras, prepare_views
from mocap_ros.cli.inputs import MODEL_OPTIONS, TOPIC_OPTIONS, VIDEO_OPTIONS, list_sources
from mocap_ros.cli.options import CONFIG_OPTIONS, STRICT_OPTIONS, Options, derive_output_stem, load_config, option
from mocap_ros.cli.reconstruct import OUTPUT_OPTION, check_outputs, choose_endings, save_people
from mocap_ros.cli.terminal import ShareBar, finish, print_note, print_result
from mocap_ros.errors import InputError
from mocap_ros.formats.cameras_file import Cameras, load_cameras
from mocap_ros.offline.whole_sequence import report_part
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.find_cameras import find_cameras, load_views, name_cameras
from mocap_ros.recordings.merge_people import MergedPerson, merge_recordings
from mocap_ros.recordings.reconstruct import MAX_PEOPLE
from mocap_ros.recordings.recording import Recording

DESCRIPTION = (
    'Merges the people whom two cameras or more saw at the same time: results of `reconstruct`, bags of '
    'skeletons, or what `reconstruct` reads, which is reconstructed. The result is in the optical frame and at '
    'the times of the first camera, with its keypoints, and can be used like any other. Where the cameras are is '
    'found from the people, if no file says it; cameras must stand still.'
)
OPTIONS: Options = {
    'input IN': option('recording of each camera: a result, bag, or what `reconstruct` reads', nargs='+'),
    '--cameras FILE': 'file of cameras that `mocap-ros cameras` writes, by the names of the recordings or in '
    'their order (default: found from the people)',
    '--all-people': 'save every person, into files whose names end with their ids (default: the one seen most)',
    '-o --output OUT': OUTPUT_OPTION,
    **TOPIC_OPTIONS,
    **VIDEO_OPTIONS,
    **MODEL_OPTIONS,
    **STRICT_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Load or reconstruct the recordings, merge them, and save the people."""
    first: Path = args.input[0]
    outputs = args.output or [Path(f'{derive_output_stem(first)}_merged.npz')]
    config = load_config(args)
    options = prepare_views(args, config, MAX_PEOPLE)
    sources = list_sources(args, config)
    check_outputs(outputs, sources)
    names = name_cameras(args.input)
    cameras = None if args.cameras is None else choose_cameras(load_cameras(args.cameras), names, args.cameras)
    with ShareBar('merge') as report:
        recordings = load_views(args.input, options, report_part(report, 0, 2))
        views = [recording.people for recording in recordings]
        lines: tuple[str, ...] = ()
        if cameras is None:
            cameras, lines = _find_cameras(names, views)
        people = merge_recordings(views, cameras.poses, cameras.clock_offsets, report_part(report, 1, 2))
    code = _print_recordings(args.input, recordings, is_strict=args.strict)
    if not args.all_people:
        people = (max(people, key=lambda person: int(person.poses.in_sight.sum())),)
    for line in (*lines, *map(_describe_person, people)):
        print_result(line)
    endings = choose_endings([poses.id for poses, _ in people]) if args.all_people else ['']
    is_all_saved = save_people(first, [poses for poses, _ in people], endings, outputs, sources)
    return code or int(not is_all_saved)


def _find_cameras(
    names: Sequence[str], views: Sequence[Sequence[PoseSequence]]
) -> tuple[Cameras, tuple[str, ...]]:
    try:
        located = find_cameras(names, views)
    except InputError as error:
        raise InputError(f'{error}; or give the poses by --cameras') from None
    return located.cameras, describe_cameras(located)


def _print_recordings(paths: Sequence[Path], recordings: Sequence[Recording], *, is_strict: bool) -> int:
    """Print what the recordings rest on, and return the exit code."""
    code = 0
    for path, recording in zip(paths, recordings, strict=True):
        for note in recording.notes:
            print_note(note)
        if str(recording.summary):
            code |= finish(path, recording.summary, recording.summary.is_wrong, is_strict=is_strict)
    return code


def _describe_person(person: MergedPerson) -> str:
    seen = int(person.poses.in_sight.sum())
    line = f'{person.poses.id}: {seen} frames, {person.shared} of them seen by several cameras'
    return line if person.shared else f'{line}: the poses of cameras, or their focal lengths, may be wrong'


def choose_cameras(cameras: Cameras, names: Sequence[str], path: Path) -> Cameras:
    """Return the cameras of recordings with these names, or in their order."""
    missing = [name for name in names if name not in cameras.names]
    if not missing:
        rows = [cameras.names.index(name) for name in names]
        return Cameras(tuple(names), cameras.poses[rows], cameras.clock_offsets[rows])
    if len(missing) < len(names) or len(names) != len(cameras.names):
        raise InputError(f'{path}: no camera {missing[0]!r}; there are {", ".join(cameras.names)}')
    return cameras
