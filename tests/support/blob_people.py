# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People made of coloured blobs, videos of them, and networks that find the blobs.

Keypoint j of a person is a blob of the colour `COLOURS[j]` on a black ground. The networks have the inputs and the
outputs of YOLO-pose, RTMPose and MoveNet. The response of keypoint j at a pixel of the colour c is

    r_j = max(0, 1 - |c - COLOURS[j]|^2 / TOLERANCE^2)
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw

from mocap_ros.demo.scene import make_recording, project
from mocap_ros.detectors.movenet import SHIFT
from mocap_ros.detectors.rtmpose import MEAN, STD
from mocap_ros.skeleton import CMU15, keypoint_layout

COCO = keypoint_layout('coco17')
KEYPOINTS = len(COCO.joints)
TOLERANCE = 40.0  # of 0 to 255; colours are at least 60 apart
BLOB_RADIUS_PX = 5
SIZE = (640, 480)  # px, of the images of the demo
TIME_BASE = Fraction(1, 1000)  # s; of the videos


def _make_colours() -> np.ndarray:
    """Return (17, 3) colours of equal brightness, so that a blob's dim edge has the colour of no other blob."""
    steps = np.linspace(0.0, 1.0, 6)
    directions = np.array([(a, b, 1 - a - b) for a in steps for b in steps if a + b <= 1 + 1e-9])[:KEYPOINTS]
    return 250 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


COLOURS = _make_colours()


def walk(frames: int) -> np.ndarray:
    """Return the true keypoints (F, 17, 2) in px of the demo's walker; NaN for eyes and ears."""
    body = project(make_recording().truth[:frames])
    points = np.full((frames, KEYPOINTS, 2), np.nan)
    for index, name in enumerate(COCO.joints):
        if name in CMU15.joints or name == 'nose':
            points[:, index] = body[:, CMU15.index(name if name in CMU15.joints else 'head')]
    return points


def draw(people: Iterable[np.ndarray], size: tuple[int, int] = SIZE, radius: float = BLOB_RADIUS_PX) -> np.ndarray:
    """Return an image (H, W, 3) of people, each given by keypoints (17, 2) in px."""
    picture = Image.new('RGB', size)
    pen = ImageDraw.Draw(picture)
    for person in people:
        for (x, y), colour in zip(person, COLOURS, strict=True):
            if np.isfinite(x):
                rectangle = (x - radius, y - radius, x + radius, y + radius)
                pen.ellipse(rectangle, fill=tuple(round(c) for c in colour))
    return np.asarray(picture)


def write_video(
    path: Path,
    images: Sequence[np.ndarray],
    times_s: Sequence[float],
    codec: str = 'ffv1',
    pixels: str = 'bgr0',
    aspect: float = 1.0,
    **tags: str,
) -> Path:
    """Write images (H, W, 3) with their times, without loss by default, in pixels of some width per height.

    Only .mov has tags of any name.
    """
    av = pytest.importorskip('av', reason="needs PyAV: pip install -e '.[video]'")
    with av.open(str(path), 'w', options={'movflags': 'use_metadata_tags'} if tags else {}) as container:
        container.metadata.update(tags)
        stream = container.add_stream(codec, rate=30)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = pixels
        stream.codec_context.sample_aspect_ratio = Fraction(aspect)
        stream.time_base = stream.codec_context.time_base = TIME_BASE
        for image, time_s in zip(images, times_s, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format='rgb24').reformat(format=pixels)
            frame.pts, frame.time_base = round(time_s / TIME_BASE), TIME_BASE
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


class Graph:
    """A network under construction; each method adds a step and returns the name of its result."""

    def __init__(self) -> None:
        self.onnx = pytest.importorskip('onnx', reason="needs onnx: pip install -e '.[test]'")
        pytest.importorskip('onnxruntime', reason="needs onnxruntime: pip install -e '.[video]'")
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: Any = np.float32) -> str:
        name = f'constant_{len(self.constants)}'
        self.constants.append(self.onnx.numpy_helper.from_array(np.asarray(values, kind), name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        name = f'{operator}_{len(self.nodes)}'
        self.nodes.append(self.onnx.helper.make_node(operator, inputs, [name], **attributes))
        return name

    def respond(self, pixels: str) -> str:
        """Return r (1, 17, H, W) of pixels (1, 3, H, W) in 0 to 255."""
        square = self.add('ReduceSum', self.add('Mul', pixels, pixels), self.constant([1], np.int64))
        product = self.add('Conv', pixels, self.constant(-2 * COLOURS[..., None, None]))
        constant = self.constant((COLOURS**2).sum(axis=1)[None, :, None, None])
        distance = self.add('Add', self.add('Add', square, product), constant)
        share = self.add('Div', distance, self.constant(TOLERANCE**2))
        return self.add('Relu', self.add('Sub', self.constant(1.0), share))

    def locate(self, response: str, height: int, width: int, shift: float = 0.0) -> str:
        """Return y, x in shares of the image, `shift` px too small, and the score (1, 17, 3) of (1, 17, H, W)."""
        axes = self.constant([2, 3], np.int64)
        total = self.add('Add', self.add('ReduceSum', response, axes, keepdims=0), self.constant(1e-6))
        rows = self.constant(((np.arange(height) + 0.5 - shift) / height)[None, None, :, None])
        columns = self.constant(((np.arange(width) + 0.5 - shift) / width)[None, None, None])
        found = [
            self.add('Div', self.add('ReduceSum', self.add('Mul', response, grid), axes, keepdims=0), total)
            for grid in (rows, columns)
        ]
        found.append(self.add('ReduceMax', response, axes, keepdims=0))
        last = self.constant([2], np.int64)
        return self.add('Concat', *(self.add('Unsqueeze', name, last) for name in found), axis=2)

    def save(self, path: Path, shape: Sequence[int | str], kind: str, outputs: Sequence[str]) -> Path:
        helper, types = self.onnx.helper, self.onnx.TensorProto
        graph = helper.make_graph(
            self.nodes,
            'blobs',
            [helper.make_tensor_value_info('image', getattr(types, kind), shape)],
            [helper.make_tensor_value_info(name, types.FLOAT, None) for name in outputs],
            self.constants,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 18)], ir_version=9)
        self.onnx.save(model, str(path))
        return path


def save_rtmpose(path: Path, width: int = 192, height: int = 256) -> Path:
    """Write a network of the form of RTMPose with its usual input of 192 x 256 px."""
    graph = Graph()
    pixels = graph.add('Mul', 'image', graph.constant(STD[None, :, None, None]))
    pixels = graph.add('Add', pixels, graph.constant(MEAN[None, :, None, None]))
    response = graph.respond(pixels)
    seen = graph.add('ReduceMax', response, graph.constant([2, 3], np.int64), keepdims=0)
    seen = graph.add('Unsqueeze', seen, graph.constant([2], np.int64))
    outputs = []
    for across, side in ((2, width), (3, height)):
        profile = graph.add('ReduceSum', response, graph.constant([across], np.int64), keepdims=0)
        bins, pixels_ = np.arange(2 * side) / 2, np.arange(side)
        smooth = np.exp(-0.5 * ((bins - pixels_[:, None]) / 2.0) ** 2)
        profile = graph.add('MatMul', profile, graph.constant(smooth))
        peak = graph.add('ReduceMax', profile, graph.constant([2], np.int64))
        profile = graph.add('Div', profile, graph.add('Add', peak, graph.constant(1e-6)))
        outputs.append(graph.add('Mul', profile, seen))
    return graph.save(path, [1, 3, height, width], 'FLOAT', outputs)


def save_movenet(path: Path, side: int = 192) -> Path:
    """Write a network of the form of MoveNet for one person."""
    graph = Graph()
    pixels = graph.add('Cast', 'image', to=graph.onnx.TensorProto.FLOAT)
    response = graph.respond(graph.add('Transpose', pixels, perm=[0, 3, 1, 2]))
    found = graph.add('Unsqueeze', graph.locate(response, side, side, SHIFT), graph.constant([1], np.int64))
    return graph.save(path, [1, side, side, 3], 'INT32', [found])


def locate_in_parts(
    graph: Graph, response: str, height: int, width: int, shift: float = 0.0, parts: int = 2
) -> list[tuple[str, str]]:
    """Return y, x in shares of the image and the score (1, 17, 3), and the person's score (1, 1), in each part."""
    people = []
    for number in range(parts):
        is_in = np.arange(width) * parts // width == number
        part = graph.add('Mul', response, graph.constant(is_in[None, None, None]))
        found = graph.locate(part, height, width, shift)
        score = graph.add(
            'ReduceMax', graph.add('Slice', found, *(graph.constant([v], np.int64) for v in (2, 3, 2))),
            graph.constant([1], np.int64), keepdims=0,
        )  # fmt: skip
        people.append((found, score))
    return people


def save_yolo_pose(path: Path, *, one_each: bool = False, side: int = 640, parts: int = 2) -> Path:
    """Write a network of the form of YOLO-pose that sees one person in each part of the image, or in both halves.

    It has two candidates for each, or with `one_each`, as YOLO26, one.
    """
    graph = Graph()
    response = graph.respond(graph.add('Mul', 'image', graph.constant(255.0)))
    rows = []
    for number, (found, score) in enumerate(locate_in_parts(graph, response, side, side, parts=parts)):
        places = ([graph.constant([v], np.int64) for v in (c, c + 1, 2)] for c in range(3))
        y, x, seen = (graph.add('Slice', found, *place) for place in places)
        pixels = [graph.add('Mul', share, graph.constant(float(side))) for share in (x, y)]
        shape = graph.constant([1, 3 * KEYPOINTS], np.int64)
        numbers = graph.add('Reshape', graph.add('Concat', *pixels, seen, axis=2), shape)
        left, wide = number * side / parts, side / parts
        if one_each:
            head = [graph.constant([[left, 0, left + wide, side]]), score, graph.constant([[0.0]])]
            rows.append(graph.add('Concat', *head, numbers, axis=1))
            continue
        for shift in (0, 9):  # px; a second candidate that is less likely
            box = graph.constant([[left + wide / 2 + shift, side / 2, wide, side]])
            less = graph.add('Mul', score, graph.constant(1 - shift / 100))
            rows.append(graph.add('Concat', box, less, graph.add('Add', numbers, graph.constant(shift)), axis=1))
    count, length = (300, 57) if one_each else (8400, 56)
    rows.append(graph.constant(np.zeros((count - len(rows), length))))
    table = graph.add('Concat', *rows, axis=0)
    table = table if one_each else graph.add('Transpose', table, perm=[1, 0])
    output = graph.add('Unsqueeze', table, graph.constant([0], np.int64))
    return graph.save(path, [1, 3, side, side], 'FLOAT', [output])


def save_multi_pose_movenet(path: Path, width: int = 256, height: int = 192) -> Path:
    """Write a network of the form of MoveNet for several people, which sees one in each half of the image."""
    graph = Graph()
    pixels = graph.add('Cast', 'image', to=graph.onnx.TensorProto.FLOAT)
    response = graph.respond(graph.add('Transpose', pixels, perm=[0, 3, 1, 2]))
    people = []
    for found, score in locate_in_parts(graph, response, height, width, SHIFT):
        numbers = graph.add('Reshape', found, graph.constant([1, 3 * KEYPOINTS], np.int64))
        corners = graph.constant(np.zeros((1, 4)))
        people.append(graph.add('Concat', numbers, corners, score, axis=1))
    nobody = graph.constant(np.zeros((4, 3 * KEYPOINTS + 5)))
    six = graph.add('Unsqueeze', graph.add('Concat', *people, nobody, axis=0), graph.constant([0], np.int64))
    return graph.save(path, [1, height, width, 3], 'INT32', [six])


def save_detector(path: Path) -> Path:
    """Write a network that sees the only person in an image, wherever that is."""
    return save_yolo_pose(path, one_each=True, side=320, parts=1)
