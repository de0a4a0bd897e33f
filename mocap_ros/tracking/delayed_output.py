# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which frame is shown with `tracker.lag`.

With t_0 < ... < t_n the stamps of the frame that was shown last and of all after it, h = (t_n - t_0) / n and the
lag L, the next frame is shown if it is older than L - s, s = min(h, L) / 2, and frames are left out only where a
later one is older than L + s. So one frame follows another if none is more than h / 4 early or late, and is shown
L - s to L + s + h after it was taken.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from mocap_ros.units import NS_PER_S


def find_delayed_frame(stamps_ns: Sequence[int], lag_s: float, *, has_begun: bool) -> tuple[int, bool]:
    """Return the index of the frame that is shown, and whether the output has begun, of stamps (n + 1,) ns.

    The first stamp is that of the frame that was shown last or, before the output has begun, of the first frame.
    """
    lag_ns = lag_s * NS_PER_S
    newest_ns = stamps_ns[-1]
    interval_ns = (newest_ns - stamps_ns[0]) / max(len(stamps_ns) - 1, 1)
    tolerance_ns = min(interval_ns, lag_ns) / 2
    due_ns, overdue_ns = newest_ns - lag_ns + tolerance_ns, newest_ns - lag_ns - tolerance_ns
    if not has_begun and stamps_ns[0] > due_ns:
        return 0, False
    is_next_due = has_begun and len(stamps_ns) > 1 and stamps_ns[1] <= due_ns
    return max(bisect_right(stamps_ns, overdue_ns) - 1, int(is_next_due)), True


def find_oldest_needed_ns(newest_ns: int, lag_s: float) -> float:
    """Return a stamp in ns; of the frames up to it, only the newest may be shown now or later."""
    return newest_ns - 1.5 * lag_s * NS_PER_S
