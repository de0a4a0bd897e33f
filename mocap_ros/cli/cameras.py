# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros cameras`: find where cameras are from recordings of people whom several of them see."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from mocap_ros.cli.inputs import (
    MODEL_OPTIONS,
    TOPIC_OPTIONS,
    VIDEO_OPTIONS,
    list_sources,
    load_models,
    read_options,
)
from mocap_ros.cli.options import CONFIG_OPTIONS, Options, load_config, option, parse_positive
from mocap_ros.cli.terminal import ShareBar, print_note, print_result
from mocap_ros.config import Config
from mocap_ros.errors import InputError, suggest
from mocap_ros.formats.cameras_file import save_cameras
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.geometry.rigid_transform import format_camera_pose
from mocap_ros.recordings.find_cameras import (
    LocatedCameras,
    MeasuredDistance,
    find_cameras,
    load_views,
    name_cameras,
)
from mocap_ros.recordings.input_kind import (
    READ_FORMATS,
    READ_KINDS,
    check_options,
    find_kind_with_results,
    require_kind,
)
from mocap_ros.recordings.reconstruct import ReconstructionOptions
from mocap_ros.skeleton import find_roots
from mocap_ros.viewing.camera_plot import draw_cameras_figure
from mocap_ros.viewing.plots import check_picture_format, save_figure

MAX_PEOPLE = 8  # people of a recording who are reconstructed; fewer are enough to find a camera

DESCRIPTION = (
    'Finds where cameras are, and how far their clocks are apart, from a recording of each camera in which the '
    'same people walk about, without a calibration target. Prints the pose of each camera as the parameter '
    'node.camera_pose, in one frame whose z is up and whose floor is z = 0, with standard deviations relative to '
    'the first camera. Keypoints are reconstructed first; results of `reconstruct` and bags of skeletons are '
    'taken as they are.'
)
OPTIONS: Options = {
    'input IN': option(f'recordings, one of each camera: {READ_FORMATS}', nargs='+'),
    '-o --output OUT.yaml': 'file for the poses and clock offsets (default: print them only)',
    '--picture OUT.png': 'picture from above of the cameras and the paths of the people (default: none)',
    '--distance DISTANCE': option(
        'two cameras, by the names that are printed, and the distance between them in m, which sets the scale '
        "(default: that of the people's body height)",
        nargs=3,
        metavar=('A', 'B', 'M'),
        type=str,
    ),
    **TOPIC_OPTIONS,
    **VIDEO_OPTIONS,
    **MODEL_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Find the cameras, print and save them."""
    config, names = load_config(args), name_cameras(args.input)
    options = prepare_views(args, config, MAX_PEOPLE)
    distance = None if args.distance is None else _parse_distance(args.distance, names)
    sources = list_sources(args, config)
    if args.picture is not None:
        check_picture_format(args.picture)
    for output in filter(None, (args.output, args.picture)):
        check_output(output, *sources)
    with ShareBar('cameras') as report:
        recordings = load_views(args.input, options, report)
        located = find_cameras(names, [recording.people for recording in recordings], distance)
    for note in (note for recording in recordings for note in recording.notes):
        print_note(note)
    for line in describe_cameras(located):
        print_result(line)
    if args.output is not None:
        with replace_output(args.output, *sources) as unfinished:
            save_cameras(unfinished, located.cameras, located.remarks)
        print_result(args.output)
    if args.picture is not None:
        with replace_output(args.picture, *sources) as unfinished:
            save_picture(located, unfinished)
        print_result(args.picture)
    return 0


def prepare_views(args: argparse.Namespace, config: Config, max_people: int) -> ReconstructionOptions:
    """Return how recordings of several cameras are read and reconstructed; InputError where they cannot be."""
    if len(args.input) < 2:
        raise InputError(f'{args.input[0]}: one recording alone; give those of two cameras or more')
    for path in args.input:
        require_kind(path, READ_KINDS, READ_FORMATS)
    check_options(args.input[0], vars(args), *map(find_kind_with_results, args.input))
    return ReconstructionOptions(config, load_models(args, config), read_options(args, config), max_people)


def _parse_distance(texts: Sequence[str], names: Sequence[str]) -> MeasuredDistance:
    for text in texts[:2]:
        if text not in names:
            raise InputError(f'--distance: no camera {text!r}; {suggest(text, names)}')
    try:
        distance = parse_positive(texts[2])
    except argparse.ArgumentTypeError as error:
        raise InputError(f'--distance: {error}') from None
    if texts[0] == texts[1]:
        raise InputError(f'--distance: {texts[0]} is one camera, not two')
    return MeasuredDistance(names.index(texts[0]), names.index(texts[1]), distance)


def describe_cameras(located: LocatedCameras) -> tuple[str, ...]:
    """Return a line for each camera, ready to paste, and what the frame rests on."""
    cameras, found, lines = located.cameras, located.found, list[str]()
    for index, (name, pose) in enumerate(zip(cameras.names, cameras.poses, strict=True)):
        about = 'the others are relative to it'
        if index:
            degrees, offset = math.degrees(found.rotation_std[index]), found.clock_offsets[index]
            about = f'+- {degrees:.1f} degrees, {found.translation_std[index]:.2f} m; clock {offset:+.3f} s'
        lines.append(f"-p node.camera_pose:='{format_camera_pose(pose)}'  # {name}: {about}")
    return (*lines, *located.remarks)


def save_picture(located: LocatedCameras, path: Path) -> None:
    """Draw the cameras and the paths of their people from above."""
    poses, scale = located.cameras.poses, located.scale
    paths = [
        [scale * find_roots(person.joints) @ pose[:3, :3].T + pose[:3, 3] for person in people]
        for pose, people in zip(poses, located.views, strict=True)
    ]
    intrinsics = [people[0].intrinsics for people in located.views]
    save_figure(draw_cameras_figure(located.cameras.names, poses, intrinsics, paths), path)
