# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros detect`: find 2D keypoints in a video or the images of a camera."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from mocap_ros.cli.inputs import list_sources, name_file_in_errors
from mocap_ros.cli.options import Options, derive_output_stem
from mocap_ros.cli.terminal import interrupt_between_items, print_note, print_result, show_progress
from mocap_ros.errors import InputError, tell_installation
from mocap_ros.formats.detections import Detections, select_person
from mocap_ros.formats.reading_options import ShowProgress
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.formats.video import VideoImage, find_camera
from mocap_ros.keypoints.keypoint_sequence import describe_frames
from mocap_ros.recordings.detect_people import detect_in_video
from mocap_ros.recordings.input_kind import InputKind, require_kind
from mocap_ros.recordings.save_results import save_detections
from mocap_ros.units import NS_PER_S

BAG_SUFFIX = '.mcap'
SUFFIXES = ('.npz', BAG_SUFFIX)  # of the files that the command writes

DESCRIPTION = (
    'Finds the keypoints of people in a video or in the images of a camera and writes them to a file that '
    '`mocap-ros reconstruct` and the other commands read: a sequence file (.npz) of one person, or a bag '
    '(.mcap) of all people, which `mocap-ros play` publishes. The times are those of the images. Needs '
    f'PyAV: {tell_installation("video")}; for models of MediaPipe: {tell_installation("mediapipe")}.'
)
OPTIONS: Options = {
    'input VIDEO|CAMERA': 'video, or the number or the device of a camera (0, /dev/video0)',
    '--model FILE': 'pose landmarker (.task), YOLO-pose, RTMPose or MoveNet (.onnx) (default: the MoveNet that '
    'comes with the package)',
    '-o --output OUT': '.npz or .mcap (default: IN_2d.npz, of a camera camera_2d.npz, in the current folder)',
    '--person ID': 'person of a video to write to a .npz (default: the one seen most)',
    '--max-people N': 'largest number of people to find in an image (default: 6; of MediaPipe 1)',
    '--duration S': 's, end after this time (default: at the end of the video; for a camera, when interrupted)',
}


def run(args: argparse.Namespace) -> int:
    """Detect people, write their keypoints, and print how long they were seen."""
    camera = find_camera(str(args.input))
    path = camera or args.input
    output = args.output or Path(f'{"camera" if camera else derive_output_stem(path)}_2d.npz')
    if output.suffix not in SUFFIXES:
        raise InputError(f'{output}: unknown file type; expected {", ".join(SUFFIXES)}')
    if output.suffix == BAG_SUFFIX and args.person is not None:
        raise InputError(f'{output}: holds all people; --person applies to a .npz')
    if camera is not None and args.person is not None:
        raise InputError(f'{path}: --person applies to a video; a camera shows each person once')
    sources = list_sources(args)
    check_output(output, *sources)
    if camera is None:
        require_kind(path, [InputKind.VIDEO], 'a video, or the number or the device of a camera')

    def limit_and_show(images: Iterable[VideoImage], count: int | None) -> Iterable[VideoImage]:
        images = show_progress(images, 'detect', count)
        if args.duration is None:
            return images
        return itertools.takewhile(lambda item: item.time_s < args.duration, images)

    if camera is None:
        detections = detect_in_video(path, args.model, args.max_people, limit_and_show)
    else:
        detections = _detect_until_interrupted(camera, args, limit_and_show)
    if output.suffix == BAG_SUFFIX:
        lines = list(detections.notes)
        times = np.array([stamp / NS_PER_S for stamp in detections.stamps_ns])
        with replace_output(output, *sources) as unfinished:
            save_detections(unfinished, detections)
        what = f'{len({p.id for people in detections.people for p in people})} people'
    else:
        with name_file_in_errors(path):
            sequence, lines = select_person(detections, args.person)
        times = sequence.timestamps
        with replace_output(output, *sources) as unfinished:
            save_sequence(unfinished, sequence)
        what = f'{len(sequence.joint_names)} keypoints of {sequence.person_id}'
    for line in lines:
        print_note(f'{path}: {line}')
    print_result(f'{output}: {what}, {describe_frames(times)}')
    return 0


def _detect_until_interrupted(camera: Path, args: argparse.Namespace, limit_and_show: ShowProgress) -> Detections:
    """Return what is detected in the images of a camera until it is interrupted, its only end without a duration.

    The detector finishes the image in hand, so that nothing is lost. A second interrupt is raised.
    """
    found: list[Detections] = []
    with suppress(KeyboardInterrupt), interrupt_between_items() as stop_at_interrupt:

        def show_until_interrupted(images: Iterable[VideoImage], count: int | None) -> Iterator[VideoImage]:
            with suppress(KeyboardInterrupt):
                yield from limit_and_show(stop_at_interrupt(images), count)

        detections = detect_in_video(
            camera,
            args.model,
            args.max_people,
            show_until_interrupted,
            is_camera=True,
            is_interrupted=lambda: stop_at_interrupt.is_requested,
        )
        found.append(detections)
    if not found:
        raise KeyboardInterrupt
    return found[0]
