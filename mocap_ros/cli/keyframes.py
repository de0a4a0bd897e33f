"""`mocap-ros keyframes`: a long sequence summarised by a handful of poses."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from tqdm import tqdm

from mocap_ros.cli.options import (
    about,
    add_config_options,
    add_input_options,
    config_from,
    input_from,
    name_of,
    seen_in,
)
from mocap_ros.errors import InputError
from mocap_ros.formats.text_files import writing
from mocap_ros.offline.keyframes.keyframe_set import Keyframes
from mocap_ros.offline.keyframes.observations import Observed, observe
from mocap_ros.offline.keyframes.reconstruct import summarise, suspects
from mocap_ros.viewing import plots
from mocap_ros.viewing.keyframe_plots import distances_figure, keyframes_figure

MOST_SPANS = 6
HEADER = """\
# Keyframes of {name}: time from its beginning, s; how many frames each represents, and when.
# To make one's 3D pose by Taylor's method, add the limbs that point towards the camera, by their outer joints
# (the others point away), and optionally the scale, px per m:    forward: [lelbow, lwrist]    scale: 250
# Then: mocap-ros reconstruct --method keyframes --choices THIS_FILE
"""


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'keyframes',
        help='a long sequence summarised by a few poses',
        description='Finds the poses that one person goes through (Loy et al. 2004), upper and lower body '
        'separately; prints them and saves them with two pictures: the keyframes and when each occurs, and the '
        'distances between the poses of all frames. `reconstruct --method keyframes` makes 3D of them.',
    )
    add_input_options(p)
    p.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUT.yaml',
        help='keyframes; the pictures stand beside it (default: IN_keyframes.yaml in this folder)',
    )
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Find, save, draw and print."""
    output = args.output or Path(f'{name_of(args.input)}_keyframes.yaml')
    if output.suffix not in ('.yaml', '.yml'):
        raise InputError(f'{output}: can write .yaml')
    config = config_from(args)
    sequence = input_from(args, config)
    with about(args.input), stages() as say:
        say('keypoints')
        observed = observe(*seen_in(sequence, config), config.tracker)
        observed = observed.without(suspects(observed))
        keyframes = summarise(observed, config.keyframes, say)
        say('pictures')
        poses = keyframes_figure(observed, keyframes, args.input.name)
        distances = distances_figure(observed, keyframes, config.keyframes.beta, args.input.name)
    pictures = {output.with_suffix('.png'): poses, output.with_name(f'{output.stem}_distances.png'): distances}
    with writing(output):
        output.write_text(as_yaml(observed, keyframes, args.input.name), encoding='utf-8')
    for path, figure in pictures.items():
        with writing(path):
            plots.save_figure(figure, path)
    print_table(observed, keyframes)
    print(*(str(path) for path in (output, *pictures)), sep='\n')
    return 0


class stages:  # noqa: N801, a function to its users
    """Says on a terminal what is being done, and nothing in a pipe."""

    def __enter__(self) -> Callable[[str], None]:
        self.bar = tqdm(bar_format='{desc} {elapsed}', disable=not sys.stderr.isatty(), leave=False)
        return self.say

    def say(self, what: str) -> None:
        """The next stage."""
        self.bar.set_description_str(what)

    def __exit__(self, *_: object) -> None:
        self.bar.close()


def entries(observed: Observed, keyframes: tuple[Keyframes, Keyframes]) -> list[dict[str, Any]]:
    """What is said of every keyframe, upper body first, by time."""
    times = observed.times - observed.times[0]
    return [
        {
            'half': half.half.name,
            'time': round(float(times[half.frames[key]]), 6),
            'represents': int((half.assigned == key).sum()),
            'spans': [[round(float(times[a]), 3), round(float(times[b]), 3)] for a, b in half.spans(int(key))],
        }
        for half in keyframes
        for key in half.by_time
    ]


def as_yaml(observed: Observed, keyframes: tuple[Keyframes, Keyframes], name: str) -> str:
    """The keyframes as the file that `reconstruct --choices` reads."""
    lines = yaml.safe_dump({'keyframes': entries(observed, keyframes)}, sort_keys=False, default_flow_style=None)
    return HEADER.format(name=' '.join(name.split())) + lines


def print_table(observed: Observed, keyframes: tuple[Keyframes, Keyframes]) -> None:
    """One line a keyframe, and the totals."""
    print(f'{"half":<6} {"time, s":>9} {"frames":>7}  when, s')
    for entry in entries(observed, keyframes):
        spans = [f'{a:.1f}-{b:.1f}' for a, b in entry['spans'][:MOST_SPANS]]
        more = ', ...' if len(entry['spans']) > MOST_SPANS else ''
        print(f'{entry["half"]:<6} {entry["time"]:>9.2f} {entry["represents"]:>7}  {", ".join(spans)}{more}')
    seconds = float(observed.times[-1] - observed.times[0])
    for half in keyframes:
        print(
            f'{half.half.name} body: {len(half.frames)} keyframes cover {half.coverage:.1%} of '
            f'{int(half.seen.sum())} frames, {seconds:.1f} s'
        )
