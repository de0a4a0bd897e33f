# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Send the motion of a result by the VMC protocol, at its pace."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from mocap_ros.errors import ConfigError, MocapError, tell_installation
from mocap_ros.formats.export.vmc import VmcPose, convert_armature
from mocap_ros.recordings.save_results import animate

if TYPE_CHECKING:
    from mocap_ros.people import PoseSequence

MAX_PORT = 65535  # of UDP


class VmcSender:
    """Sends poses to one program, HOST:PORT."""

    def __init__(self, address: str) -> None:
        """Raise `ConfigError` for an address that is none, `MocapError` without python-osc."""
        host, _, port = address.rpartition(':')
        if not host or not port.isdecimal() or not 0 < int(port) <= MAX_PORT:
            raise ConfigError(f'vmc: {address!r}: expected HOST:PORT, such as 127.0.0.1:39539')
        try:
            from pythonosc.udp_client import UDPClient
        except ImportError:
            raise MocapError(f'vmc needs python-osc: {tell_installation("vmc")}') from None
        try:
            self._client = UDPClient(host, int(port))
        except OSError as error:
            raise ConfigError(f'vmc: {address}: {error.strerror or error}') from None

    def send(self, pose: VmcPose, time_s: float) -> None:
        """Send a frame as one bundle; MocapError where the network takes none."""
        from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
        from pythonosc.osc_message_builder import OscMessageBuilder

        bundle = OscBundleBuilder(IMMEDIATELY)
        for address, arguments in pose.list_messages(time_s):
            message = OscMessageBuilder(address)
            for argument in arguments:
                message.add_arg(argument)
            bundle.add_content(message.build())
        try:
            self._client.send(bundle.build())
        except OSError as error:
            raise MocapError(f'vmc: nothing is sent: {error.strerror or error}') from None


class VmcMotion(NamedTuple):
    """The poses of a result at a constant rate."""

    poses: list[VmcPose]
    frame_time: float  # s

    @staticmethod
    def convert(poses: PoseSequence) -> VmcMotion:
        """Convert a result."""
        bvh = animate(poses)
        return VmcMotion(list(convert_armature(bvh)), bvh.frame_time)

    def play(self, sender: VmcSender, rate: float) -> Iterator[None]:
        """Send the frames at `rate` times their pace; yields after each."""
        start_s = time.monotonic()
        for frame, pose in enumerate(self.poses):
            time_s = frame * self.frame_time
            time.sleep(max(start_s + time_s / rate - time.monotonic(), 0.0))
            sender.send(pose, time_s)
            yield
