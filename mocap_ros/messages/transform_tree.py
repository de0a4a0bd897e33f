# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""tf2_msgs/TFMessage as input: where the camera is in another coordinate frame at the time of an image.

Every frame has one parent. The transform from a frame s to a frame g leads from both up to their common ancestor a

    T_gs(t) = T_ag(t)^-1 T_as(t)

where each is the product of the transforms on the way, interpolated at the time t. Transforms on /tf_static hold
at all times; those on /tf are kept for `HISTORY_S`. No clock is read: the same messages in the same order always
give the same transforms.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from mocap_ros.errors import InputError, naming
from mocap_ros.geometry.rigid_transform import RigidTransform, interpolate
from mocap_ros.messages.cdr import Header, decode_input, validate_stamp
from mocap_ros.messages.transforms import (
    CHILD_LINKS,
    ROOT_LINK,
    TORSO_LINK,
    TRANSFORMS,
    WORLD_LINK,
    StampedTransform,
    write_transforms,
)
from mocap_ros.units import NS_PER_S

RESTART_S = 2.0  # s; transforms of one frame never arrive so much out of order, but a simulation starts anew
HISTORY_S = 10.0  # s; as tf2 keeps transforms, and longer than any tracker.lag
MAX_FRAMES = 1000  # frames; many times those of a robot; guards the memory against names that never end
# Transforms that are kept of all frames, which share them evenly: 10 s of 100 frames at 100 Hz. Guards the memory
# (75 MB), and the time in which they are written when a recording starts.
MAX_TREE_SAMPLES = 100_000
MESSAGE_TRANSFORMS = 10_000  # transforms of a message at most; 1 to 2 MB
PART_TRANSFORMS = 1000  # transforms of a message that is written
MAX_DEPTH = 100  # frames from a frame up to its root; guards the search against loops

_HISTORY_NS = int(HISTORY_S * NS_PER_S)
_COUNT = slice(4, 8)  # bytes of a TFMessage that hold the number of its transforms


@dataclass
class _Link:
    """The transforms from a frame to its parent: one that holds at all times, or stamped ones, oldest first."""

    parent: str
    is_static: bool
    samples: list[tuple[int, RigidTransform]] = field(default_factory=list)

    def _find_index(self, stamp_ns: int) -> int:
        return bisect_left(self.samples, (stamp_ns,))

    def add(self, stamp_ns: int, transform: RigidTransform, limit: int) -> None:
        """Add a transform; one far older than the newest begins anew, as time itself has gone back."""
        if self.is_static or (self.samples and stamp_ns < self.samples[-1][0] - RESTART_S * NS_PER_S):
            self.samples = []
        start, end = self._find_index(stamp_ns), self._find_index(stamp_ns + 1)
        self.samples[start:end] = [(stamp_ns, transform)]
        del self.samples[:-limit]
        del self.samples[: self._find_index(self.samples[-1][0] - _HISTORY_NS)]

    def find(self, child: str, stamp_ns: int, tolerance_ns: int, earlier_ns: int = 0) -> RigidTransform:
        """Return the transform at a time, or before it; the arguments are those of `TransformTree.find`."""
        samples = self.samples
        if self.is_static:
            return samples[0][1]
        if earlier_ns:
            is_newer = 0 < stamp_ns - samples[-1][0] <= tolerance_ns
            stamp_ns, tolerance_ns = (samples[-1][0] if is_newer else stamp_ns) - earlier_ns, 0
        index = self._find_index(stamp_ns)
        after_ns, after = samples[min(index, len(samples) - 1)]
        if 0 < index < len(samples) and after_ns != stamp_ns:
            before_ns, before = samples[index - 1]
            return interpolate(before, after, (stamp_ns - before_ns) / (after_ns - before_ns))
        if abs(after_ns - stamp_ns) <= tolerance_ns:
            return after
        age, relation = ('newest', 'older') if index else ('oldest', 'newer')
        apart_s = abs(stamp_ns - after_ns) / NS_PER_S
        raise InputError(f'the {age} transform of {child} is {apart_s:.2f} s {relation} than the image')


class TransformTree:
    """All coordinate frames that /tf and /tf_static have named, and their transforms over the last seconds."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}  # by child frame
        self._newest_ns = 0  # stamp of the transform that came last on /tf

    def add(self, raw: bytes, *, is_static: bool) -> None:
        """Add the transforms of a TFMessage."""
        added = [_read_transform(i, stamped) for i, stamped in enumerate(_decode(raw))]
        names = {child for child, *_ in added}
        links = self._links
        if len(links.keys() | names) > MAX_FRAMES:
            links = self._select_recent(self._newest_ns if is_static else added[-1][2])
        if len(links.keys() | names) > MAX_FRAMES:
            raise InputError(f'transforms: more than {MAX_FRAMES} frames')
        self._links = links
        for child, parent, stamp_ns, transform in added:
            link = self._links.get(child)
            if link is None or link.parent != parent or link.is_static != is_static:
                link = self._links[child] = _Link(parent, is_static)
            link.add(stamp_ns, transform, MAX_TREE_SAMPLES // len(self._links))
            if not is_static:
                self._newest_ns = stamp_ns

    def find(
        self, target: str, source: str, stamp_ns: int, tolerance_s: float, earlier_s: float = 0.0
    ) -> RigidTransform:
        """Return the transform from one frame to another at a time, or a little before it.

        Outside the known transforms the nearest holds within a tolerance. `earlier_s` before the time, or before
        the newest transform where that holds, shows the motion of a frame, however late its transforms are.
        """
        source, target = source.lstrip('/'), target.lstrip('/')
        up, down = self._list_ancestors(source), self._list_ancestors(target)
        common = next((name for name in up if name in down), None)
        if common is None:
            unknown = next((n for n in (source, target) if n not in self._links and not self._is_parent(n)), '')
            what = f'no transform names {unknown!r}' if unknown else 'they are not connected'
            raise InputError(f'no transform from {source!r} to {target!r}: {what}')
        tolerance_ns, earlier_ns = round(tolerance_s * NS_PER_S), round(earlier_s * NS_PER_S)
        to_common, from_common = (
            self._follow(names[: names.index(common)], stamp_ns, tolerance_ns, earlier_ns) for names in (up, down)
        )
        return from_common.inverse().compose(to_common)

    def encode_all(self) -> tuple[list[bytes], list[bytes]]:
        """Return all transforms as TFMessages of /tf_static and of /tf, which make another tree the same."""
        parts: tuple[list[bytes], list[bytes]] = ([], [])
        for is_static, messages in zip((True, False), parts, strict=True):
            transforms: list[StampedTransform] = [
                (Header(stamp_ns, link.parent), child, (*transform.translation, *transform.quaternion))
                for child, link in self._links.items()
                for stamp_ns, transform in link.samples
                if link.is_static == is_static
            ]
            starts = range(0, len(transforms), PART_TRANSFORMS)
            messages += [write_transforms(transforms[start : start + PART_TRANSFORMS]) for start in starts]
        return parts

    def _is_parent(self, name: str) -> bool:
        return any(link.parent == name for link in self._links.values())

    def _list_ancestors(self, name: str) -> list[str]:
        names = [name]
        while names[-1] in self._links and len(names) < MAX_DEPTH:
            names.append(self._links[names[-1]].parent)
        return names

    def _follow(self, names: list[str], stamp_ns: int, tolerance_ns: int, earlier_ns: int) -> RigidTransform:
        """Return the transform from the first of these frames to the parent of the last, as `_Link.find` does."""
        result = RigidTransform.identity()
        for name in names:
            result = self._links[name].find(name, stamp_ns, tolerance_ns, earlier_ns).compose(result)
        return result

    def _select_recent(self, newest_ns: int) -> dict[str, _Link]:
        """Return the frames without those on /tf that have not been sent for `HISTORY_S`, as of people who left.

        Where time went back, those of the time before are later than the transform that came last.
        """
        return {
            child: link
            for child, link in self._links.items()
            if link.is_static or abs(link.samples[-1][0] - newest_ns) <= _HISTORY_NS
        }


def is_of_people_only(raw: bytes, prefix: str) -> bool:
    """Return whether a TFMessage holds nothing but links of people and their world, as published by this package.

    Such messages say nothing of the camera. A node that publishes people on /tf receives them itself, and a bag of
    its run has them on the topic of the inputs. Robots have frames with such names too, as `head_camera`, but no
    body and torso of the same name above them.
    """
    root, torso = (f'{prefix}{link}_' for link in (ROOT_LINK, TORSO_LINK))
    world = f'{prefix}{WORLD_LINK}'
    has_name = root.encode() in raw or world.encode() in raw
    if not has_name and any(raw[_COUNT]):  # decoding a large message takes 0.3 s
        return False
    try:
        parents = {t.child_frame_id: t.header.frame_id for t in _decode(raw)}
    except InputError:
        return False
    suffixes = [c.removeprefix(root) for c in parents if c.startswith(root)]
    people = [suffix for suffix in suffixes if torso + suffix in parents]
    bodies = {world, *(root + suffix for suffix in people)}
    links = {f'{prefix}{link}_{suffix}': root + suffix for suffix in people for link in CHILD_LINKS}
    return all(child in bodies or links.get(child) == parent for child, parent in parents.items())


def _decode(raw: bytes) -> Sequence[Any]:
    transforms: Sequence[Any] = decode_input(raw, TRANSFORMS).transforms
    if len(transforms) > MESSAGE_TRANSFORMS:
        raise InputError(f'transforms: {len(transforms)}, more than {MESSAGE_TRANSFORMS}')
    return transforms


def _read_transform(index: int, stamped: Any) -> tuple[str, str, int, RigidTransform]:
    """Return child, parent, stamp in ns and transform of a TransformStamped; the index is for error messages."""
    child, parent = stamped.child_frame_id.lstrip('/'), stamped.header.frame_id.lstrip('/')
    translation, rotation = stamped.transform.translation, stamped.transform.rotation
    numbers = (translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w)
    with naming(f'transforms[{index}]'):
        if not child or not parent or child == parent:
            raise InputError(f'child_frame_id {child!r} in header.frame_id {parent!r}')
        return child, parent, validate_stamp(stamped.header.stamp), RigidTransform.from_numbers(numbers)
