# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a reconstruction rests on, in numbers and one line; `verdict.summary` makes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from mocap_ros.findings import Grade


@dataclass(frozen=True)
class Summary:
    """What a reconstruction rests on."""

    people: int
    frames: int
    seen: float  # 1, share of the detector's points that were seen, in images with people; NaN without any
    residual_px: float  # px, mean RMS reprojection error; NaN if unknown
    residual_share: float  # 1, the same over the height of the body in the image
    # m, distance along the optical axis, the median over joints and frames, or live the mean of the first joint;
    # NaN if unknown
    distance_m: float
    focal_px: float  # px, focal length; NaN if unknown
    focal_source: str  # `known` by a calibration, `given` by the user, `from the video`, or `nominal`
    vertical: str  # `given`, `found`, `uncertain` or `none`
    vertical_std_deg: float  # degrees, standard deviation of the vertical; NaN if there is none
    grade: str  # `good`, `doubtful` or `wrong`; `not judged` if too little was seen
    reason: str = ''  # why the grade is not good, in words
    unseen: str = ''  # parts of the body that were hardly ever seen, such as `hips and legs`; often empty

    @property
    def is_wrong(self) -> bool:
        """Whether the input is wrong, so that the result is."""
        return self.grade == Grade.WRONG.word

    def __str__(self) -> str:
        parts = [f'{self.grade}: {self.reason}' if self.reason else self.grade]
        parts.append(f'{self.people} {"person" if self.people == 1 else "people"} in {self.frames} frames')
        if math.isfinite(self.seen):
            parts.append(f'{self.seen:.0%} of the points seen')
        if self.unseen:
            parts.append(f'{self.unseen} never seen')
        if math.isfinite(self.residual_px):
            parts.append(f'residual {self.residual_px:.1f} px ({self.residual_share:.1%} of the body height)')
        if math.isfinite(self.focal_px):
            focal = f'focal length {self.focal_px:.0f} px, {self.focal_source}'
            if math.isfinite(self.distance_m):
                is_known = self.focal_source == 'known'
                focal += f'{"," if is_known else ":"} {self.distance_m:.1f} m away'
                focal += '' if is_known else ', proportional to it'
            parts.append(focal)
        std = f' (± {self.vertical_std_deg:.0f}°)' if math.isfinite(self.vertical_std_deg) else ''
        parts.append(f'vertical {self.vertical}{std}')
        return '; '.join(parts)


class StoredSummary(NamedTuple):
    """The grade and the line of a summary, as a result file holds them."""

    grade: str
    line: str

    @property
    def is_wrong(self) -> bool:
        """Whether the input is wrong, so that the result is."""
        return self.grade == Grade.WRONG.word

    def __str__(self) -> str:
        return self.line


UNKNOWN_SUMMARY = StoredSummary('', '')
