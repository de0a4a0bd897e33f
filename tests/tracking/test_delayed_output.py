# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the choice of the frame that is output with a lag."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.tracking.delayed_output import find_delayed_frame, find_oldest_needed_ns


def delay(stamps_ns: list[int], lag_s: float) -> list[tuple[int, int]]:
    """Return the stamp of each frame with that of the frame that is output after it, both in ns."""
    waiting: list[int] = []
    out, has_begun = [], False
    for stamp_ns in stamps_ns:
        waiting.append(stamp_ns)
        first, has_begun = find_delayed_frame(waiting, lag_s, has_begun=has_begun)
        waiting = waiting[first:]
        if has_begun:
            out.append((stamp_ns, waiting[0]))
    return out


@given(
    steps_ms=st.lists(st.integers(1, 400), min_size=2, max_size=60),
    lag_s=st.floats(0.001, 1.0),
)
def test_stamps_never_go_back_and_delays_are_bounded(steps_ms: list[int], lag_s: float) -> None:
    stamps_ns = [int(s) for s in np.cumsum(steps_ms) * 1_000_000]
    out = delay(stamps_ns, lag_s)
    shown = [s for _, s in out]
    assert shown == sorted(shown)
    for now_ns, shown_ns in out[1:]:
        index = stamps_ns.index(shown_ns)
        assert now_ns - shown_ns >= lag_s / 2 * 1e9 - 1
        following_ns = stamps_ns[index + 1] if index + 1 < len(stamps_ns) else now_ns
        assert now_ns - following_ns <= 1.5 * lag_s * 1e9 + 1, 'a later frame is older than the lag by a half'
        needed = [s for s in stamps_ns if s <= find_oldest_needed_ns(now_ns, lag_s)]
        assert not needed or shown_ns >= needed[-1]
