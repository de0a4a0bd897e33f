# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Encoders write the bytes that the library writes for message objects, and decoders read what it reads."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.config import Config, with_values
from mocap_ros.messages.cdr import Header, decode, encode, typestore
from mocap_ros.messages.plain import decode_plain
from mocap_ros.messages.skeletons import PredictedFrame
from mocap_ros.people import Motion, MotionKind, Person3D, PredictedPerson
from mocap_ros.runtime.outputs import SWITCHED_OUTPUTS, OutputEncoder
from mocap_ros.skeleton import BODY26, CMU15, Skeleton
from tests.support.swinging_body import STANDING

# Texts of every length modulo 8, and some outside ASCII: what follows a text is padded by its length in bytes.
TEXTS = st.text('aä人', max_size=9)
HEADERS = st.builds(Header, st.integers(0, 2**31 * 10**9 - 1), TEXTS)


@st.composite
def make_person(draw: st.DrawFn, skeleton: Skeleton) -> Person3D:
    rng, count = np.random.default_rng(draw(st.integers(0, 2**32))), len(skeleton.joints)
    joints = STANDING[np.arange(count) % len(STANDING)]
    return Person3D(
        id=draw(TEXTS),
        joints=joints + rng.normal(scale=0.1, size=(count, 3)) + [0, 0, 5],
        std=rng.uniform(0.01, 0.1, count) * draw(st.sampled_from([1.0, np.nan])),
        inferred=rng.random(count) < draw(st.sampled_from([0.0, 0.3, 1.0])),
        scale=rng.uniform(100, 300),
        rotation=Rotation.from_rotvec(rng.normal(size=3)).as_matrix(),
        translation=rng.normal(size=2),
        motion=Motion(draw(st.sampled_from(MotionKind)), draw(TEXTS), 0.1, float('nan')),
        residual=rng.uniform(0, 9),
        scale_known=draw(st.booleans()),
        predicted=draw(st.booleans()),
        velocity=rng.normal(size=(count, 3)),
        velocity_std=rng.uniform(0.1, 1, count),
        root_covariance=rng.normal(size=(3, 3)),
        root_velocity_covariance=rng.normal(size=(3, 3)),
        age=rng.uniform(0, 9),
        unseen_for=rng.uniform(0, 1),
        skeleton=skeleton,
        orientation=Rotation.random(count, rng).as_quat(),
        turn_inferred=rng.random(count) < 0.5,
        contact=rng.random(2) * draw(st.sampled_from([1.0, np.nan])),
    )


@st.composite
def make_people(draw: st.DrawFn) -> list[Person3D]:
    """Return people of different ids and one skeleton."""
    skeleton = draw(st.sampled_from([CMU15, BODY26]))
    return [replace(p, id=f'{n}{p.id}') for n, p in enumerate(draw(st.lists(make_person(skeleton), max_size=3)))]


@given(header=HEADERS, people=make_people(), later_ns=st.integers(0, 2**31 * 10**9 - 1))
def test_all_outputs_are_as_the_library_writes_them(header: Header, people: list[Person3D], later_ns: int) -> None:
    people = [replace(p, orientation=p.orientation * np.nan) if n else p for n, p in enumerate(people)]
    node = with_values(Config(), {f'node.{field}': True for field in SWITCHED_OUTPUTS}).node
    ahead = [PredictedPerson(p.id, p.joints[:15], p.std[:15], p.root_covariance) for p in people]
    encoder = OutputEncoder()
    for stamp_ns, shown in ((header.stamp_ns, people), (later_ns, people), (later_ns, people[1:])):
        frames = [PredictedFrame(0.2, ahead[: len(shown)]), PredictedFrame(0.5, [])]
        known = frames if shown == people else []
        for message in encoder.encode(header._replace(stamp_ns=stamp_ns), shown, node, predicted=known):
            decoded = decode(message.data, message.type)
            assert encode(decoded, message.type) == message.data, message.topic
            check_plain(decode_plain(message.data, message.type), decoded)
            swapped = bytes(typestore().serialize_cdr(decoded, message.type, little_endian=False))
            check_plain(decode_plain(swapped, message.type), decoded)


def check_plain(plain: Any, decoded: Any) -> None:
    """Check that plain values are those of a message object."""
    if isinstance(plain, SimpleNamespace):
        for name, value in vars(plain).items():
            check_plain(value, getattr(decoded, name))
    elif isinstance(plain, list):
        for value, element in zip(plain, decoded, strict=True):
            check_plain(value, element)
    else:
        np.testing.assert_array_equal(np.ravel(plain), np.ravel(list_numbers(decoded)))


def list_numbers(value: Any) -> Any:
    """Return the numbers of which a message or messages consist."""
    if isinstance(value, list):
        return [list_numbers(element) for element in value]
    if not hasattr(value, '__msgtype__'):
        return value
    return np.concatenate([np.ravel(list_numbers(v)) for name, v in vars(value).items() if name != '__msgtype__'])
