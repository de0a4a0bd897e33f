# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writer of BVH files."""

from __future__ import annotations

from pathlib import Path

from mocap_ros.formats.bvh_motion import END_SUFFIX, BvhMotion

DECIMALS = 6  # of lengths in cm and angles in degrees: far finer than any reconstruction
# How a file of `build_armature` is imported into Blender, whose importer takes lengths as metres by default.
BLENDER_IMPORT = 'File > Import > Motion Capture (.bvh) with Scale 0.01, Forward -Z and Up Y'
FRAME_TIME_DECIMALS = 8  # of a time in s: an hour of frames drifts by less than 2 ms at 100 Hz


def save_bvh(path: Path, bvh: BvhMotion) -> None:
    """Write a BVH file; the hierarchy must have one root."""
    lines = ['HIERARCHY']
    _append_node(bvh, 0, '', lines)
    lines += ['MOTION', f'Frames: {len(bvh.motion)}', f'Frame Time: {bvh.frame_time:.{FRAME_TIME_DECIMALS}f}']
    lines += [' '.join(f'{value:.{DECIMALS}f}' for value in row) for row in bvh.motion]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def _append_node(bvh: BvhMotion, node: int, indent: str, lines: list[str]) -> None:
    """Append the lines of a node and of all nodes below it."""
    children = [child for child, parent in enumerate(bvh.parents) if parent == node]
    name = bvh.names[node]
    is_end_site = name.endswith(END_SUFFIX)
    keyword = 'ROOT' if bvh.parents[node] < 0 else 'JOINT'
    lines += [f'{indent}End Site' if is_end_site else f'{indent}{keyword} {name}', f'{indent}{{']
    inner_indent = indent + '\t'
    lines.append(f'{inner_indent}OFFSET ' + ' '.join(f'{v:.{DECIMALS}f}' for v in bvh.offsets[node]))
    if not is_end_site:
        channels = bvh.channels[node]
        lines.append(f'{inner_indent}CHANNELS {len(channels)} {" ".join(channels)}')
    for child in children:
        _append_node(bvh, child, inner_indent, lines)
    lines.append(f'{indent}}}')
