"""BVH files written."""

from __future__ import annotations

from pathlib import Path

from mocap_ros.formats.mocap.bvh import END, Bvh

DECIMALS = 6


def save_bvh(path: Path, bvh: Bvh) -> None:
    """Write a file; one root."""
    lines = ['HIERARCHY']
    _write_node(bvh, 0, '', lines)
    lines += ['MOTION', f'Frames: {len(bvh.motion)}', f'Frame Time: {bvh.frame_time:.{DECIMALS + 2}f}']
    lines += [' '.join(f'{value:.{DECIMALS}f}' for value in row) for row in bvh.motion]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def _write_node(bvh: Bvh, node: int, indent: str, lines: list[str]) -> None:
    children = [child for child, parent in enumerate(bvh.parents) if parent == node]
    name = bvh.names[node]
    is_end = name.endswith(END)
    kind = 'ROOT' if bvh.parents[node] < 0 else 'JOINT'
    lines += [f'{indent}End Site' if is_end else f'{indent}{kind} {name}', f'{indent}{{']
    inside = indent + '\t'
    lines.append(f'{inside}OFFSET ' + ' '.join(f'{v:.{DECIMALS}f}' for v in bvh.offsets[node]))
    if not is_end:
        channels = bvh.channels[node]
        lines.append(f'{inside}CHANNELS {len(channels)} {" ".join(channels)}')
    for child in children:
        _write_node(bvh, child, inside, lines)
    lines.append(f'{indent}}}')
