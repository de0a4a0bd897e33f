# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node of `mocap-ros view --live`: what the running node publishes, in pages of browsers on this machine."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial

from rclpy.exceptions import InvalidNamespaceException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.validate_namespace import validate_namespace

from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.messages.camera_info import CAMERA_INFO, CameraInfo, decode_camera_info
from mocap_ros.messages.cdr import read_stamp_ns
from mocap_ros.messages.images import IMAGE, IMAGE_TYPES, decode_image
from mocap_ros.messages.keypoints import KEYPOINTS, KeypointsFrame, decode_keypoints
from mocap_ros.messages.skeletons import SKELETONS, decode_skeletons, find_intrinsics
from mocap_ros.people import CameraVertical
from mocap_ros.recordings.live_frame import show_people
from mocap_ros.ros.message_types import MessageVersions
from mocap_ros.ros.nodes import run_node
from mocap_ros.ros.qos import NEWEST_QOS
from mocap_ros.ros.topics import subscribe
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.live_page import LiveScene, PageServer
from mocap_ros.viewing.overlay import encode_jpeg

# Only the newest messages count: a page that is late must not fall behind.
KEYPOINTS_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
SEARCH_S = 1.0  # s, between looks for the topic of the images
KEPT_IMAGES = 15  # messages, which wait for their skeletons; with a longer `tracker.lag` no image is shown
WAITING_NS = 6 * NS_PER_S  # for which keypoints wait for their skeletons; `tracker.lag` is at most 5 s


class LiveView(Node):
    """Node that serves the page of a live scene: the newest skeletons, with their keypoints and their image."""

    def __init__(self, port: int, namespace: str, announce: Callable[[str], None]) -> None:
        super().__init__('mocap_view', namespace=namespace)
        self._versions = MessageVersions()
        self._limits = NodeConfig()
        self._topic = self.resolve_topic_name('skeletons')
        self._scene = LiveScene('Live', self._topic)
        self._port = port
        self._announce = announce
        self._serving = ExitStack()
        self._keypoints: dict[int, KeypointsFrame] = {}  # by stamp in ns
        self._images: dict[int, tuple[str, bytes]] = {}  # types and messages likewise, the newest
        self._camera: CameraInfo | None = None
        self._size = (640, 480)
        for topic, msgtype, take, qos in (
            ('skeletons', SKELETONS, self._take_skeletons, NEWEST_QOS),
            ('keypoints', KEYPOINTS, self._take_keypoints, KEYPOINTS_QOS),
            ('camera_info', CAMERA_INFO, self._take_camera, NEWEST_QOS),
            ('image', IMAGE, partial(self._take_image, IMAGE), KEYPOINTS_QOS),
        ):
            self._subscribe(topic, msgtype, take, qos)
        self._search = self.create_timer(SEARCH_S, self._find_images)

    def start(self) -> None:
        """Serve the page, and announce its address."""
        server = self._serving.enter_context(PageServer(self._scene, self._port))
        self._announce(f'{server.address} shows {self._topic} in any browser of this machine; Ctrl-C ends')

    def close(self) -> None:
        """Serve the page no longer."""
        self._serving.close()

    def _subscribe(self, topic: str, msgtype: str, take: Callable[[bytes], None], qos: QoSProfile) -> None:
        self._versions.add_input(msgtype)

        def read(raw: bytes) -> None:
            try:
                take(self._versions.read(msgtype, raw))
            except InputError as error:
                self.get_logger().warning(f'{topic}: {error}', throttle_duration_sec=10.0)

        subscribe(self, msgtype, topic, read, qos)

    def _find_images(self) -> None:
        """Subscribe to the images that the node which publishes the keypoints looks at, whatever their topic."""
        for publisher in self.get_publishers_info_by_topic(self.resolve_topic_name('keypoints')):
            with suppress(rclpy_implementation.RCLError):  # its name is not known yet, or it has just ended
                inputs = self.get_subscriber_names_and_types_by_node(publisher.node_name, publisher.node_namespace)
                images = {topic: types[0] for topic, types in inputs if types[0] in IMAGE_TYPES}
                if len(images) == 1:
                    self._search.cancel()
                    ((topic, msgtype),) = images.items()
                    if (topic, msgtype) != (self.resolve_topic_name('image'), IMAGE):
                        self._subscribe(topic, msgtype, partial(self._take_image, msgtype), KEYPOINTS_QOS)
                    return

    def _take_camera(self, raw: bytes) -> None:
        self._camera = decode_camera_info(raw)

    def _take_image(self, msgtype: str, raw: bytes) -> None:
        if self._scene.is_viewed:
            self._images[read_stamp_ns(raw)] = msgtype, raw
            self._images = dict([*self._images.items()][-KEPT_IMAGES:])

    def _take_keypoints(self, raw: bytes) -> None:
        if self._scene.is_viewed:
            frame = decode_keypoints(raw, self._limits)
            newest_ns = frame.header.stamp_ns
            self._keypoints = {s: f for s, f in self._keypoints.items() if abs(newest_ns - s) <= WAITING_NS}
            self._keypoints[newest_ns] = frame

    def _take_skeletons(self, raw: bytes) -> None:
        if not self._scene.is_viewed:
            self._scene.leave_out()
            return
        array = decode_skeletons(raw)
        seen, frame = array.people, self._keypoints.get(array.header.stamp_ns)
        if self._camera is not None and self._camera.intrinsics.is_focal_known:
            intrinsics = self._camera.intrinsics
        elif len(seen):
            intrinsics = find_intrinsics(seen)
            self._size = intrinsics.image_size or self._size
        else:
            intrinsics = Intrinsics.from_image_size(*self._size, 1.0)
        if self._camera is not None:
            self._size = self._camera.size
        if frame is not None:
            self._size = resolve_image_size(stated=(frame.image_width, frame.image_height), configured=self._size)
        show_people(
            self._scene,
            array.header.stamp_ns,
            seen,
            [] if frame is None else frame.people,
            intrinsics,
            self._size,
            CameraVertical(array.vertical, array.vertical_std),
            self._encode_image(array.header.stamp_ns),
        )

    def _encode_image(self, stamp_ns: int) -> bytes:
        try:
            if stamp_ns not in self._images:
                return b''
            msgtype, raw = self._images[stamp_ns]
            return encode_jpeg(decode_image(raw, msgtype, self._limits)[1])
        except InputError as error:
            self.get_logger().warning(f'image: {error}; shown without images', throttle_duration_sec=10.0)
            return b''


def serve(port: int, namespace: str, announce: Callable[[str], None]) -> None:
    """Serve the page of the topics in a namespace until interrupted; `announce` gets the line with the address."""
    try:
        validate_namespace(f'/{namespace.removeprefix("/")}')
    except InvalidNamespaceException:
        raise ConfigError(f'--live {namespace}: is no file, no camera and no namespace') from None
    run_node([], lambda: LiveView(port, namespace, announce))
