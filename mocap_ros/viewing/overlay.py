# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The images of a recording: reduced for the page, and with keypoints and skeletons over them for films."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.plots import INFERRED_COLOUR
from mocap_ros.viewing.scene import (
    PALE_COLOUR,
    Scene,
    SceneImages,
    choose_joint_colours,
    choose_person_colour,
    project_joints,
)

Pixels = NDArray[np.uint8]  # (H, W, 3) red, green, blue
Points = NDArray[np.float32]  # (J, 2) px

MAX_PAGE_BYTES = 12_000_000  # of all images in a page together
PAGE_SIDE_PX = 480  # px; the longer side of the images in a page at most
JPEG_QUALITY = 60  # %
MAX_OFFSET_S = 0.1  # s; an image belongs to the frame with the nearest stamp if that is not farther
LINES_IN_HEIGHT = 240  # widths of a line in the height of the image
OUTLINED = (('white', 1.8), ('black', 1.0))  # colours and widths of keypoints, which are seen on any image


class StampedImage(NamedTuple):
    """An image (H, W, 3) of the camera, and its stamp in ns."""

    stamp_ns: int
    image: Pixels


def find_frame(scene: Scene, stamp_ns: int) -> int:
    """Return the frame with the stamp nearest to that of an image, or -1 if it is farther than `MAX_OFFSET_S`."""
    stamps = np.asarray(scene.stamps_ns)
    after = int(np.searchsorted(stamps, stamp_ns))
    nearest = min((f for f in (after - 1, after) if 0 <= f < len(stamps)), key=lambda f: abs(stamps[f] - stamp_ns))
    return nearest if abs(int(stamps[nearest]) - stamp_ns) <= MAX_OFFSET_S * NS_PER_S else -1


def reduce_images(scene: Scene, images: Iterable[StampedImage], max_bytes: int = MAX_PAGE_BYTES) -> SceneImages:
    """Return the images of the frames of a scene, small enough for a page.

    Where they would take more than `max_bytes` together, only every second is kept, or every fourth, and so on.
    """
    kept: dict[int, bytes] = {}  # JPEG by frame
    step, size, number = 1, 0, -1
    for stamp_ns, pixels in images:
        frame = find_frame(scene, stamp_ns)
        if frame < 0 or frame in kept:
            continue
        number += 1
        if number % step:
            continue
        kept[frame] = encode_jpeg(pixels)
        size += len(kept[frame])
        if size > max_bytes:
            step, kept = 2 * step, dict(list(kept.items())[::2])
            size = sum(map(len, kept.values()))
    frames = sorted(kept)
    return SceneImages(np.array(frames, np.intp), tuple(kept[frame] for frame in frames), step)


def encode_jpeg(pixels: Pixels) -> bytes:
    """Return an image (H, W, 3) as JPEG, reduced to what a page shows."""
    picture, buffer = Image.fromarray(pixels), io.BytesIO()
    picture.thumbnail((PAGE_SIDE_PX, PAGE_SIDE_PX))
    picture.save(buffer, 'JPEG', quality=JPEG_QUALITY)
    return buffer.getvalue()


def pick_images(scene: Scene, images: Iterable[StampedImage], frames: Iterable[int]) -> dict[int, Pixels]:
    """Return the images of some frames by frame, as far as there are any."""
    wanted, found = set(frames), dict[int, Pixels]()
    for stamp_ns, pixels in images:
        frame = find_frame(scene, stamp_ns)
        if frame in wanted:
            found[frame] = pixels
    return found


class Overlay:
    """Drawer of the keypoints and of the skeletons, projected, in the image of a frame."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._people = [
            (
                person,
                scene.find_frames(person),
                project_joints(person),
                choose_joint_colours(scene, index),
                choose_person_colour(scene, index),
            )
            for index, person in enumerate(scene.people)
        ]

    def draw_film(self, images: Iterable[StampedImage]) -> Iterator[tuple[float, Pixels]]:
        """Yield times in s and images (H, W, 3) with what is drawn over them; white ones where there are none."""
        scene, newest = self._scene, -1
        for stamp_ns, pixels in images:
            newest = stamp_ns
            yield (stamp_ns - scene.stamps_ns[0]) / NS_PER_S, self.draw(pixels, find_frame(scene, stamp_ns))
        if newest < 0:
            white = np.full((scene.image_size[1], scene.image_size[0], 3), 255, np.uint8)
            for frame, time_s in enumerate(scene.times):
                yield float(time_s), self.draw(white, frame)

    def draw(self, pixels: Pixels, frame: int) -> Pixels:
        """Return an image (H, W, 3) with what is known of a frame over it; the image itself for frame -1."""
        if frame < 0:
            return pixels
        pen = _Pen(pixels, pixels.shape[1] / self._scene.image_size[0])
        for person, frames, image, colours, name_colour in self._people:
            row = int(np.searchsorted(frames, frame))
            if row == len(frames) or frames[row] != frame:
                continue
            is_pale, points = person.predicted[row] or person.tentative[row], image[row]
            for bone in self._scene.skeleton.bones:
                pen.draw_bone(points, bone, PALE_COLOUR if is_pale else colours[bone[1]], 2.0)
            pen.draw_dots(points[person.inferred[row]], INFERRED_COLOUR, 1.5)
            if len(self._people) > 1:
                pen.write_above(points, person.id, name_colour)
        for keypoints in self._scene.keypoints:
            first, last = np.searchsorted(keypoints.frames, [frame, frame + 1])
            for points in keypoints.points[first:last]:
                for colour, width in OUTLINED:
                    for bone in keypoints.skeleton.bones:
                        pen.draw_bone(points, bone, colour, width / 2)
                    pen.draw_dots(points, colour, width)
        return np.asarray(pen.picture)


class _Pen:
    """Draws in a copy of an image, at points in px of an image `scale` times as small; NaN is not drawn."""

    def __init__(self, pixels: Pixels, scale: float) -> None:
        self.picture, self._scale = Image.fromarray(pixels), scale
        self._pen, self._width = ImageDraw.Draw(self.picture), max(self.picture.height / LINES_IN_HEIGHT, 1.0)

    def draw_bone(self, points: Points, bone: tuple[int, int], colour: str, width: float) -> None:
        ends = points[list(bone)] * self._scale
        if np.isfinite(ends).all():
            self._pen.line(ends.ravel().tolist(), colour, max(round(width * self._width), 1))

    def draw_dots(self, points: Points, colour: str, radius: float) -> None:
        r = radius * self._width
        for x, y in (points[np.isfinite(points).all(axis=1)] * self._scale).tolist():
            self._pen.ellipse((x - r, y - r, x + r, y + r), colour)

    def write_above(self, points: Points, text: str, colour: str) -> None:
        known = points[np.isfinite(points).all(axis=1)] * self._scale
        if len(known):
            place = float(known[:, 0].mean()), float(known[:, 1].min()) - 3 * self._width
            self._pen.text(place, text, colour, anchor='mb')
