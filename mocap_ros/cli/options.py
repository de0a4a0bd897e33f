"""Options that several subcommands share."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from mocap_ros.config import Config, from_yaml, load_yaml, shown, with_values
from mocap_ros.errors import ConfigError, InputError, MocapError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.sequence_file import LARGEST_IMAGE, Sequence
from mocap_ros.formats.text_files import read_text
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.runtime.load_keypoints import load_input
from mocap_ros.skeleton import LAYOUT_NAMES

Array = NDArray[np.float64]
T = TypeVar('T')

LARGEST_CONFIG = 1 << 20
LONGEST_SIZE = 20


def add_config_options(parser: argparse.ArgumentParser) -> None:
    """`--config FILE` and `--set NAME=VALUE`."""
    parser.add_argument('--config', type=Path, metavar='FILE', help='parameter file (default: none)')
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='one parameter, such as solver.components=20; may be repeated (defaults: see `mocap-ros config`)',
    )


def add_model_option(parser: argparse.ArgumentParser) -> None:
    """`--model`."""
    parser.add_argument(
        '--model',
        metavar='NAME',
        help='base poses: a shipped name, a file, or auto for the likeliest (default: tracker.model)',
    )


def add_input_options(parser: argparse.ArgumentParser) -> None:
    """Whatever holds keypoints, and what it may not say itself."""
    parser.add_argument(
        'input',
        type=Path,
        metavar='IN',
        help='sequence file (.npz), bag, folder of OpenPose JSON, or COCO keypoints (.json)',
    )
    parser.add_argument('--person', metavar='ID', help='whom, of several people (default: the one seen most)')
    parser.add_argument(
        '--topic', metavar='NAME', help='of the keypoints in a bag (default: the only one there is)'
    )
    parser.add_argument(
        '--fps', type=positive, metavar='N', help='frames a second of the video; needed for JSON (default: none)'
    )
    parser.add_argument(
        '--image-size',
        type=_image_size,
        metavar='WxH',
        help='px, for JSON that does not say it (default: a usual size that holds all points)',
    )
    parser.add_argument(
        '--layout',
        choices=LAYOUT_NAMES,
        help='of the keypoints in JSON (default: by their number)',
    )


def input_from(args: argparse.Namespace, config: Config) -> Sequence:
    """The sequence that `add_input_options` describe; says on stderr whom it shows and what was assumed.

    Raises:
        InputError: it cannot be used; names the place.
    """
    video = Video(args.fps, args.image_size, args.layout or '')
    sequence, lines = load_input(args.input, video, config.node, args.person, args.topic)
    for line in lines:
        print(f'mocap-ros: {line}', file=sys.stderr)
    return sequence


def name_of(path: Path) -> str:
    """What files made from this input are called."""
    return path.stem or path.resolve().stem


def seen_in(sequence: Sequence, config: Config) -> tuple[Array, tuple[str, ...], Array, Intrinsics]:
    """What was seen, as the reconstructions take it: keypoints, joint names, times and the camera."""
    intrinsics = sequence.intrinsics(config.tracker.nominal_focal_length)
    return sequence.keypoints, sequence.joint_names, sequence.timestamps, intrinsics


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Around the work on one file: errors name it, also where the numbers give no solution."""
    try:
        yield
    except MocapError as error:
        raise type(error)(f'{path}: {error}') from None
    except np.linalg.LinAlgError as error:
        raise InputError(f'{path}: the reconstruction failed ({error})') from None


def positive(text: str) -> float:
    """A positive, finite number, for argparse."""
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f'{text} is not positive and finite')
    return value


def _image_size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition('x')
    fine = width.isdecimal() and height.isdecimal() and len(text) < LONGEST_SIZE
    if not (fine and 0 < int(width) <= LARGEST_IMAGE and 0 < int(height) <= LARGEST_IMAGE):
        raise argparse.ArgumentTypeError(f'{text!r}: expected such as 1920x1080')
    return int(width), int(height)


def models_from(args: argparse.Namespace, config: Config) -> dict[str, BasePoses]:
    """The base poses of `--model`, by name; all shipped ones for `auto`.

    Raises:
        ModelError: there are none of that name.
    """
    name = args.model or config.tracker.model
    return load_base_pose_models(name)


def config_from(args: argparse.Namespace) -> Config:
    """The configuration that these options describe.

    Raises:
        InputError: the file cannot be read.
        ConfigError: unknown parameter or value out of range.
    """
    config = Config()
    if args.config is not None:
        config = from_yaml(read_text(args.config, largest=LARGEST_CONFIG), str(args.config))
    for assignment in args.set:
        name, equals, value = assignment.partition('=')
        if not equals:
            raise ConfigError(f'--set {shown(assignment)}: expected NAME=VALUE')
        config = with_values(config, {name: load_yaml(value, f'--set {name}')})
    return config


def progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """The items, with a progress bar on a terminal and none in a pipe."""
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)
