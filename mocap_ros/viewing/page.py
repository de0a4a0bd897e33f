# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One self-contained HTML page that shows a scene in 3D over time, with three.js, in any browser and offline.

The template, the styles and the script are in `viewing/page_files/`. `three.js` beside them is made by
`config/task.sh page` from the packages that `config/page/package-lock.json` pins.

Arrays are rounded to integers, stored column by column as differences from row to row, split into their bytes
plane by plane, and compressed together; the script undoes this.
"""

from __future__ import annotations

import base64
import html
import json
import math
import re
import zlib
from collections.abc import Mapping
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Indices, Mask
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import Skeleton
from mocap_ros.viewing.plots import INFERRED_COLOUR, TRUTH_COLOUR, make_printable
from mocap_ros.viewing.scene import (
    DROP_COLOUR,
    DROP_NAME,
    PALE_COLOUR,
    STANDING_COLOUR,
    STANDS,
    TRAIL_JOINT,
    Scene,
    SceneKeypoints,
    choose_joint_colours,
    choose_person_colour,
    image_corners,
    list_colour_key,
    project_joints,
)

CAMERA_DEPTH_M = 0.5  # m; distance of the corners of the image in the picture of the camera
NOT_A_NUMBER = -32768  # 1; the int16 that stands for a missing value
MAX_INT16 = 32767  # 1; the largest other value
MIN_METRE_STEP = 0.001  # m; joints are rounded to it, far below their error
MIN_PIXEL_STEP = 0.125  # px; image points are rounded to it, far below a detector's noise
MAX_IMAGE_SIZES = 3  # image sizes; points farther from the image's corner are clipped, far outside the picture
STD_STEP = 0.002  # m; standard deviations are rounded to it; up to 0.5 m fit in a byte
UNKNOWN_STD = 255  # 1; the byte that stands for an unknown standard deviation
RESIDUAL_STEP = 0.01  # px
CADENCE_STEP = 0.001  # Hz
TICK_S = 1e-4  # s; times are rounded to it, far below the time between two frames
COMPRESSION_LEVEL = 6  # of gzip; 9 takes twice the time for 1 % less
GZIP_BITS = 31  # zlib's number for its largest window, in the format of gzip


class _Packer:
    def __init__(self) -> None:
        self._compressor = zlib.compressobj(COMPRESSION_LEVEL, wbits=GZIP_BITS)
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, array: NDArray[np.integer[Any]]) -> dict[str, int]:
        """Add an array (N, ...), N from 0, of integers of 1, 2 or 4 bytes; return its description."""
        rows = array.reshape(len(array), math.prod(array.shape[1:]))
        unsigned = rows.astype(f'<u{rows.itemsize}')
        steps = np.diff(unsigned, axis=0, prepend=np.zeros((1, rows.shape[1]), unsigned.dtype))
        columns = np.ascontiguousarray(steps.T.astype(unsigned.dtype))
        planes = columns.view(np.uint8).reshape(-1, rows.itemsize).T
        self._parts.append(self._compressor.compress(planes.tobytes()))
        offset, self._size = self._size, self._size + planes.size
        return {'offset': offset, 'rows': rows.shape[0], 'columns': rows.shape[1], 'size': rows.itemsize}

    def finish(self) -> str:
        """Return all arrays compressed, as base64."""
        return base64.b64encode(b''.join([*self._parts, self._compressor.flush()])).decode('ascii')


class Steps(NamedTuple):
    """The units of the integers to which joints (m) and image points (px) are rounded."""

    metre: float
    pixel: float


LIVE_STEPS = Steps(MIN_METRE_STEP, MIN_PIXEL_STEP)  # of all frames of a live scene


def build_page(scene: Scene, *, live_topic: str = '') -> str:
    """Return the page of a scene as HTML; it needs no other file and no network.

    A live page, of the skeletons on a topic, asks its server for the frames; the people of its scene have its
    colours, and no frames.
    """
    packer = _Packer()
    described = json.dumps({'liveTopic': live_topic, **_describe_scene(scene, packer)}, separators=(',', ':'))
    parts = {
        'CONNECT': "'self'" if live_topic else "'none'",
        'TITLE': html.escape(make_printable(scene.title)),
        'STYLE': _read('page.css'),
        'IMAGES': base64.b64encode(b''.join(scene.images.jpegs if scene.images else ())).decode('ascii'),
        'SCENE': described.replace('<', '\\u003c'),  # so that no text can end the script element
        'DATA': packer.finish(),
        'THREE': _read('three.js'),
        'SCRIPT': _read('page.js'),
    }
    return re.sub('@([A-Z]+)@', lambda match: parts[match[1]], _read('page.html'))


def _read(name: str) -> str:
    return (files('mocap_ros') / 'viewing' / 'page_files' / name).read_text(encoding='utf-8')


def _describe_scene(scene: Scene, packer: _Packer) -> dict[str, Any]:
    """Add the arrays of a scene to the packer, and return all else that the script needs."""
    truths = [] if scene.truth is None else [scene.truth]
    metre_step = max(_find_step([*(p.joints for p in scene.people), *truths]), MIN_METRE_STEP)
    pixel_step = max(MAX_IMAGE_SIZES * max(scene.image_size) / MAX_INT16, MIN_PIXEL_STEP)
    tick_s = max(TICK_S, float(np.abs(scene.times).max(initial=0.0)) / np.iinfo(np.int32).max)
    packed = [{'arrays': {'joints': packer.add(round_to_int16(truth, metre_step))}} for truth in truths]
    return {
        'title': make_printable(scene.title),
        'tickS': tick_s,
        'times': packer.add(np.round(scene.times / tick_s).astype(np.int32)),
        'metrePerStep': metre_step,
        'pixelPerStep': pixel_step,
        'stdPerStep': STD_STEP,
        'residualPerStep': RESIDUAL_STEP,
        'cadencePerStep': CADENCE_STEP,
        'joints': list(scene.skeleton.joints),
        'bones': [list(bone) for bone in scene.skeleton.bones],
        'feet': [
            [i for i, joint in enumerate(scene.skeleton.joints) if joint in (f'{side}heel', f'{side}toe')]
            or [scene.skeleton.index(f'{side}ankle')]
            for side in 'lr'
        ],
        'trailJoint': scene.skeleton.index(TRAIL_JOINT),
        'people': [
            _describe_person(scene, index, packer, Steps(metre_step, pixel_step))
            for index in range(len(scene.people))
        ],
        'keypoints': [_describe_keypoints(k, packer, pixel_step) for k in scene.keypoints],
        'truth': packed[0] if packed else None,
        'images': scene.images
        and {'frames': scene.images.frames.tolist(), 'sizes': [len(jpeg) for jpeg in scene.images.jpegs]},
        'camera': describe_camera(scene.image_size, scene.intrinsics),
        'centre': scene.centre.tolist(),
        'extent': scene.extent,
        'floorY': scene.floor_y,
        'toLevel': scene.to_level.tolist(),
        'marks': [
            {'time': m.time_s, 'kind': DROP_NAME, 'text': m.text, 'colour': DROP_COLOUR} for m in scene.marks
        ],
        'markKinds': [[DROP_NAME, DROP_COLOUR]] if scene.marks else [],
        'colourKey': list_colour_key(scene),
        'inferredColour': INFERRED_COLOUR,
        'standingColour': STANDING_COLOUR,
        'paleColour': PALE_COLOUR,
        'truthColour': TRUTH_COLOUR,
    }


def describe_camera(image_size: tuple[int, int], intrinsics: Intrinsics) -> dict[str, Any]:
    """Return what the script needs of the camera."""
    return {
        'imageSize': list(image_size),
        'corners': (image_corners(image_size, intrinsics) * CAMERA_DEPTH_M).tolist(),
        'isNominal': not intrinsics.is_focal_known,
        'fovDeg': float(np.degrees(2 * np.arctan2(image_size[1] / 2, intrinsics.focal_lengths[1]))),
    }


def pack_person(
    person: PoseSequence, frames: Indices, swapped: Mask, steps: Steps
) -> Mapping[str, NDArray[np.integer[Any]]]:
    """Return what is known of a person in N frames as arrays (N, ...) of integers, as the script reads them."""
    state = (
        person.predicted.astype(np.uint8)
        | person.tentative.astype(np.uint8) << 1
        | swapped.astype(np.uint8) << 2
        | person.motion << 4
        | (person.contact > STANDS) @ np.array([1, 2], np.uint8) << 6
    )
    inferred = person.inferred.astype(np.int32) @ (1 << np.arange(person.inferred.shape[1], dtype=np.int32))
    std = np.minimum(np.round(np.nan_to_num(person.joint_std, nan=np.inf) / STD_STEP), UNKNOWN_STD)
    std = np.where(np.isfinite(person.joint_std), np.minimum(std, UNKNOWN_STD - 1), UNKNOWN_STD)
    return {
        'frames': frames.astype(np.int32),
        'joints': round_to_int16(person.joints, steps.metre),
        'std': std.astype(np.uint8),
        'inferred': inferred.astype(np.int32),
        'image': round_to_int16(project_joints(person), steps.pixel),
        'state': state.astype(np.uint8),
        'residual': round_to_int16(person.reprojection_residual, RESIDUAL_STEP),
        'cadence': round_to_int16(person.cadence, CADENCE_STEP),
    }


def _describe_person(scene: Scene, index: int, packer: _Packer, steps: Steps) -> dict[str, Any]:
    person, colours = scene.people[index], choose_joint_colours(scene, index)
    arrays = pack_person(person, scene.find_frames(person), scene.swapped[index], steps)
    return {
        'id': person.id,
        'colour': choose_person_colour(scene, index),
        'jointColours': colours,
        'boneColours': [colours[child] for _, child in scene.skeleton.bones],
        'arrays': {name: packer.add(array) for name, array in arrays.items()},
    }


def _describe_keypoints(keypoints: SceneKeypoints, packer: _Packer, pixel_step: float) -> dict[str, Any]:
    skeleton: Skeleton = keypoints.skeleton
    return {
        'names': list(skeleton.joints),
        'bones': [list(bone) for bone in skeleton.bones],
        'arrays': {
            'frames': packer.add(keypoints.frames.astype(np.int32)),
            'points': packer.add(round_to_int16(keypoints.points, pixel_step)),
        },
    }


def _find_step(arrays: list[NDArray[Any]]) -> float:
    largest = max((float(np.nanmax(np.abs(a), initial=0.0)) for a in arrays if a.size), default=0.0)
    return largest / MAX_INT16


def round_to_int16(values: NDArray[np.floating[Any]], step: float) -> NDArray[np.int16]:
    """Return values as multiples of the step; values that are too large are clipped, NaN is `NOT_A_NUMBER`."""
    rounded = np.clip(np.round(values / step), -MAX_INT16, MAX_INT16)
    return np.where(np.isfinite(rounded), rounded, NOT_A_NUMBER).astype(np.int16)
