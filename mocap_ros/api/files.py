# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading of keypoints and writing of results."""

from __future__ import annotations

import re
from pathlib import Path

from mocap_ros.api.arguments import (
    LOGGER,
    MIN_FOCAL_LENGTH_PX,
    check_camera,
    check_sequence,
    read_number,
    read_path,
)
from mocap_ros.config import format_value
from mocap_ros.errors import InputError, name_errors
from mocap_ros.formats.detections import MAX_FRAME_RATE_HZ
from mocap_ros.formats.reading_options import HFOV_RANGE_DEG, ReadingOptions
from mocap_ros.formats.sequence_file import make_camera_arrays, save_sequence
from mocap_ros.formats.text_files import replace_output
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.people import PoseSequence
from mocap_ros.recordings import save_results
from mocap_ros.recordings.load_keypoints import load_input
from mocap_ros.skeleton import keypoint_layout

MIN_FRAME_RATE_HZ = 1e-3  # Hz; far below that of any video
MAX_FOCAL_LENGTH_PX = 1e6  # px; far above that of any lens


def read(
    path: str | Path,
    *,
    person: str | None = None,
    topic: str | None = None,
    camera_info: str | None = None,
    fps: float | None = None,
    image_size: tuple[int, int] | None = None,
    layout: str = '',
    detector: str | Path | None = None,
    hfov: float | None = None,
    focal: float | None = None,
    video: str | Path | None = None,
    normalised: bool = False,
) -> KeypointSequence:
    """Read one person's keypoints from a sequence file, a bag, JSON or a table of a detector, or a video.

    What was chosen and assumed is logged as warnings by the logger `mocap_ros`: the person, the messages that were
    left out, and an image size that no file states.

    Args:
        path: sequence file (`.npz`), bag of ROS 2 or ROS 1, folder of OpenPose's JSON, COCO keypoints (`.json`),
            table (`.csv`, `.npy`, `.trc`, or a folder of `.txt`), or video. A sequence file takes none of the
            other arguments but `hfov` and `focal`.
        person: id of the person; by default the person who is seen in most frames.
        topic: topic of the keypoints; needed only for a bag with several.
        camera_info: topic of the CameraInfo; by default that of the keypoints' camera (`frame_id`) and namespace.
        fps: Hz, frame rate; needed for JSON and tables without times and without their `video`.
        image_size: (width, height) in px, where JSON does not state it.
        layout: name of the keypoint layout of JSON or a table; by default the one with that number of keypoints.
        detector: file of the model that finds the keypoints in a video: MediaPipe's pose landmarker (`.task`), or
            RTMPose or MoveNet (`.onnx`); by default the one that comes with MediaPipe.
        hfov: degrees, horizontal field of view of a camera without calibration; by default a nominal focal length
            is assumed, to which distances from the camera are proportional.
        focal: px, focal length of a camera without calibration, instead of `hfov`.
        video: video file in which the keypoints of JSON or a table were detected; it gives the times, the image
            size and, if it states it, the focal length, where the other arguments do not.
        normalised: whether the coordinates of a table are shares of the width and the height of the image.

    Raises:
        InputError: the file has none of these formats, or its content or an argument is not valid; the error names
            the file and the place in it, or the argument.
        SkeletonError: no keypoint layout has the name given as `layout`.
        ModelError: the detector cannot be used.
    """
    path = read_path('path', path)
    if image_size is not None:
        image_size, _, _ = check_camera(image_size, None, None)
    if fps is not None:
        fps = read_number('fps', fps, (MIN_FRAME_RATE_HZ, MAX_FRAME_RATE_HZ), 'Hz')
    if focal is not None:
        focal = read_number('focal', focal, (MIN_FOCAL_LENGTH_PX, MAX_FOCAL_LENGTH_PX), 'px')
    if hfov is not None:
        hfov = read_number('hfov', hfov, HFOV_RANGE_DEG, 'degrees')
        if focal is not None:
            raise InputError('focal: hfov is given as well')
    if layout:
        with name_errors('layout'):
            keypoint_layout(layout)
    model = None if detector is None else read_path('detector', detector)
    clip = None if video is None else read_path('video', video)
    try:
        options = ReadingOptions(
            fps=fps,
            image_size=image_size,
            layout=layout,
            detector=model,
            hfov=hfov,
            focal=focal,
            video=clip,
            normalised=normalised,
            person=person,
            topic=topic,
            camera_info=camera_info,
        )
        sequence, lines = load_input(path, options)
    except InputError as error:
        raise InputError(_name_arguments(str(error))) from None
    for line in lines:
        LOGGER.warning('%s', _name_arguments(line))
    return sequence


def write(path: str | Path, result: PoseSequence | KeypointSequence) -> None:
    """Write a result in the format that the suffix of the path names, or keypoints as a sequence file.

    The formats of results are those of `mocap-ros reconstruct`: `.npz` and `.csv` (m, optical frame), `.mcap` (a
    bag of messages), `.bvh` (cm, y up), `.trc` (mm, y up), and `.angles.csv` (degrees). Keypoints are written as
    `.npz`, with the camera and the truth if there are any.

    Args:
        path: the file, which is replaced if it exists, once all of the new one is written.
        result: a result of `mocap_ros.reconstruct`, or keypoints.

    Raises:
        InputError: the suffix or the content does not fit the format; the error names the argument.
        MocapError: the file cannot be written.
    """
    if isinstance(path, PoseSequence | KeypointSequence):
        raise InputError(f'path: a {type(path).__name__}, expected a path; give the path first, then the result')
    path = read_path('path', path)
    if not isinstance(result, PoseSequence | KeypointSequence):
        raise InputError(f'result: {format_value(result)}, expected a PoseSequence or a KeypointSequence')
    suffixes = save_results.SUFFIXES if isinstance(result, PoseSequence) else ('.npz',)
    if not path.name.endswith(suffixes):
        raise InputError(f'path: {path}: unknown file type; expected {", ".join(suffixes)}')
    with replace_output(path) as unfinished:
        if isinstance(result, PoseSequence):
            save_results.save(unfinished, result)
        else:
            save_sequence(unfinished, check_sequence(result))
            if result.calibration is not None and make_camera_arrays(result)[0] is None:
                LOGGER.warning('%s: without the camera, because a sequence file holds no fisheye lens', path)


def _name_arguments(text: str) -> str:
    """Return a text about options of the command line as one about the arguments of the same meaning."""
    return re.sub(r'(?<![\w./-])--([a-z-]+)', lambda option: option[1].replace('-', '_'), text)
