# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Options of the subcommands that reconstruct keypoints, and the keypoints and models that these options load."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.bags.reader import list_bag_files
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.cli.options import Options, option, parse_positive
from mocap_ros.cli.terminal import print_note, show_progress
from mocap_ros.config import Config, Value
from mocap_ros.errors import InputError, MocapError, name_errors
from mocap_ros.formats.mocap.trials import MANIFEST_NAME, list_files
from mocap_ros.formats.reading_options import HFOV_RANGE_DEG, ReadingOptions
from mocap_ros.formats.sequence_file import MAX_IMAGE_SIDE_PX
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_pose_models, load_prior_lifter
from mocap_ros.recordings.input_kind import READING_OPTIONS
from mocap_ros.recordings.load_keypoints import load_people
from mocap_ros.skeleton import LAYOUT_NAMES

# Options of all commands that name files to read; a name that is no file does no harm.
FILE_OPTIONS = (
    *('input', 'config', 'model', 'detector', 'choices', 'truth', 'video'),
    *('manifest', 'markers', 'start_from'),
)
MAX_IMAGE_SIZE_CHARACTERS = 20  # characters of --image-size; guards int() against thousands of digits


def _parse_image_size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition('x')
    is_number_pair = width.isdecimal() and height.isdecimal() and len(text) < MAX_IMAGE_SIZE_CHARACTERS
    if not (is_number_pair and 0 < int(width) <= MAX_IMAGE_SIDE_PX and 0 < int(height) <= MAX_IMAGE_SIDE_PX):
        raise argparse.ArgumentTypeError(f'{text!r}: expected a size such as 1920x1080')
    return int(width), int(height)


MODEL_OPTIONS: Options = {
    '--model NAME': 'base poses: the name of a shipped model, a model file, or auto for the most likely shipped '
    'model (default: the parameter tracker.model)'
}
TOPIC_OPTIONS: Options = {
    '--topic NAME': 'topic of the keypoints in a bag (default: the only one in the bag)',
    '--camera-info NAME': 'topic of the CameraInfo in a bag (default: that of the camera and the namespace of '
    'the keypoints)',
}
LENS_OPTIONS: Options = {
    '--hfov DEG': option(
        'degrees, horizontal field of view of a camera without calibration, 65 to 70 of most webcams (default: '
        'the parameter tracker.nominal_focal_length)',
        type=partial(parse_positive, limits=HFOV_RANGE_DEG),
        group='lens',
    ),
    '--focal PX': option(
        'px, focal length of a camera without calibration, instead of --hfov (default: likewise)', group='lens'
    ),
}
VIDEO_OPTIONS: Options = {
    '--fps HZ': 'frames per second, such as 29.97 or 30000/1001, which JSON and tables without times need without '
    'their video (default: none)',
    '--image-size WxH': option(
        'px, size of the image if the input gives none (default: a common size that contains all points)',
        type=_parse_image_size,
    ),
    '--normalised': 'the coordinates of a table are shares of the width and the height of the image (default: px)',
    **LENS_OPTIONS,
    '--layout NAME': option(
        'keypoint layout of JSON or a table (default: the layout with that number of keypoints)',
        choices=LAYOUT_NAMES,
    ),
    '--detector FILE': 'model that finds the keypoints in a video, as for `mocap-ros detect --model` (default: '
    'likewise)',
}
INPUT_OPTIONS: Options = {
    'input IN': 'sequence file (.npz), bag, folder of OpenPose JSON, COCO keypoints (.json), table (.csv, .npy, '
    '.trc, or a folder of .txt), or video',
    '--person ID': 'one person of several in the input (default: the one seen in most frames)',
    **TOPIC_OPTIONS,
    **VIDEO_OPTIONS,
    '--video FILE': 'video in which the keypoints of JSON or a table were detected, which gives times, image '
    'size and, if it states it, the focal length (default: none)',
}


def list_sources(args: argparse.Namespace, config: Config | None = None) -> list[Path]:
    """Return the files that a command reads, which its output must not overwrite; not all of them need exist.

    The parameters of the command, if it has some, may name a model and a lifter.
    """
    paths: list[Path] = []
    for name in FILE_OPTIONS:
        value = getattr(args, name, None) or []
        paths += map(Path, value if isinstance(value, list) else [value])
    if config is not None:
        paths += [Path(config.tracker.model), Path(config.solver.prior)]
    motions = [file for path in getattr(args, 'data', []) for file in list_files(path)]
    for folder in {motion.parent for motion in motions}:
        paths += [folder / MANIFEST_NAME, *folder.glob('*.[aA][sS][fF]')]
    return [*motions, *(file for path in paths for file in (path, path / METADATA, *list_bag_files(path)))]


def read_lens_parameters(args: argparse.Namespace) -> dict[str, Value]:
    """Return the parameters of a replay that the options of `LENS_OPTIONS` state; both if one is given."""
    given = {'node.hfov': args.hfov, 'node.focal': args.focal}
    return {name: value or 0.0 for name, value in given.items()} if any(given.values()) else {}


def read_options(args: argparse.Namespace, config: Config) -> ReadingOptions:
    """Return what the options of `INPUT_OPTIONS`, or those of them that a command has, state."""
    given: dict[str, Any] = {name: value for name in READING_OPTIONS if (value := getattr(args, name, None))}
    show = lambda images, count: show_progress(images, 'detect', count)  # noqa: E731
    return ReadingOptions(**given, node=config.node, tracker=config.tracker, show_detection=show)


def load_sequences(
    args: argparse.Namespace, config: Config, *, all_people: bool = False
) -> list[KeypointSequence]:
    """Load one person, or all, from the input that the options of `INPUT_OPTIONS` describe.

    The chosen person and the assumptions about the input are printed on stderr.
    """
    sequences, lines = load_people(args.input, read_options(args, config), only_one=not all_people)
    for line in lines:
        print_note(line)
    return sequences


def load_models(args: argparse.Namespace, config: Config) -> dict[str, PoseModel]:
    """Load the base poses that `--model` selects, by name; `auto` selects all shipped models."""
    models = load_base_pose_models(args.model or config.tracker.model)
    for model in models.values():  # here, so that the error about a lifter does not name the input
        load_prior_lifter(config.solver.prior, model.skeleton)
    return models


@contextmanager
def name_file_in_errors(path: Path, kind: type[MocapError] = MocapError) -> Iterator[None]:
    """Put the path in front of the messages of errors of this package, and of the linear algebra."""
    try:
        with name_errors(path, kind):
            yield
    except np.linalg.LinAlgError as error:
        raise InputError(f'{path}: the reconstruction failed ({error})') from None
