# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node `detector_node`: find 2D keypoints in the images of a camera and publish them for `mocap_node`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rclpy.node import Node

from mocap_ros.config import NodeConfig
from mocap_ros.detectors.detector import Detector, load_detector
from mocap_ros.errors import InputError, ModelError
from mocap_ros.messages.images import decode_image
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.recordings.detect_people import detect_people
from mocap_ros.ros.help import DETECTOR_NAME, DETECTOR_PARAMETERS, IMAGE_TOPIC, KEYPOINTS_TOPIC
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.ros.nodes import declare_parameters
from mocap_ros.ros.qos import NEWEST_QOS, OUTPUT_QOS
from mocap_ros.ros.throttled_log import ThrottledLog
from mocap_ros.ros.topics import subscribe, warn_of_subscribers
from mocap_ros.units import NS_PER_S


class DetectorNode(Node):
    """Node that runs a detector on the newest image and publishes who is seen in it.

    Every image gives one message with the header of the image, also if no person is seen. Images that arrive while
    the detector works are dropped but for the newest.
    """

    def __init__(self) -> None:
        super().__init__(DETECTOR_NAME)
        values: dict[str, Any] = declare_parameters(self, DETECTOR_PARAMETERS, 'the option --help')
        self._model = Path(values['model']).expanduser() if values['model'] else None
        self._max_people: int | None = values['max_people'] or None
        self._type: str = values['image_type']
        self._detector: Detector = load_detector(self._model, self._max_people)
        self._first_ns = self._last_ns = -1  # stamps of the detector's first and last image
        self._limits = NodeConfig()
        self._log = ThrottledLog(self.get_logger())
        self._count = 0
        self._versions = MessageVersions()
        self._versions.add_input(self._type)
        self._versions.add_output(KEYPOINTS)
        published = load_interface_class(KEYPOINTS)
        events = warn_of_subscribers(self, KEYPOINTS_TOPIC)
        self._publisher = self.create_publisher(published, KEYPOINTS_TOPIC, OUTPUT_QOS, event_callbacks=events)
        subscribe(self, self._type, IMAGE_TOPIC, self._take_image, NEWEST_QOS)
        self.get_logger().info(
            f'{self._detector.name} looks at the images on {self.resolve_topic_name(IMAGE_TOPIC)} and publishes '
            f'keypoints on {self.resolve_topic_name(KEYPOINTS_TOPIC)}'
        )

    def start(self) -> None:
        """Do nothing; the node works since it was created."""

    def close(self) -> None:
        """Release the model."""
        self._detector.close()

    def _take_image(self, raw: bytes) -> None:
        self._count += 1
        try:
            header, image = decode_image(self._versions.read(self._type, raw), self._type, self._limits)
            self._follow_time(header.stamp_ns)
            people = detect_people(self._detector, image, (header.stamp_ns - self._first_ns) / NS_PER_S)
        except (InputError, ModelError) as error:
            self._log.report(self.resolve_topic_name(IMAGE_TOPIC), self._count, str(error))
            return
        size = image.shape[1], image.shape[0]
        self._publisher.publish(self._versions.write(KEYPOINTS, encode_keypoints(header, size, people)))

    def _follow_time(self, stamp_ns: int) -> None:
        """Note the stamp of the next image; where the time goes back, a new video begins, and a new detector."""
        if stamp_ns == self._last_ns:
            raise InputError('header.stamp: that of the image before; it must increase')
        if stamp_ns < self._last_ns:
            self.get_logger().warning('the stamps of the images go back; the detector starts anew')
            self._detector.close()
            self._detector = load_detector(self._model, self._max_people)
            self._first_ns = -1
        self._first_ns = stamp_ns if self._first_ns < 0 else self._first_ns
        self._last_ns = stamp_ns
