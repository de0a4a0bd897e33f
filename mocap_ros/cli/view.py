# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros view`: show any recording or result in 3D over time."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from mocap_ros.bags.reader import is_bag
from mocap_ros.cli.keypoint_input import (
    add_input_options,
    add_model_option,
    list_sources,
    load_models,
    name_file_in_errors,
    read_video_options,
    show_detection_progress,
)
from mocap_ros.cli.lines import print_remark, print_result
from mocap_ros.cli.options import add_config_options, load_config
from mocap_ros.cli.progress import show_progress
from mocap_ros.config import Config
from mocap_ros.errors import ConfigError, InputError, MocapError
from mocap_ros.formats.result_file import is_result_file
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.runtime.bag_images import read_images
from mocap_ros.runtime.load_scene import SceneOptions, load_keyframe_marks, load_scene, place_marks
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.rerun_recording import APPLICATION, LiveDrawing, import_rerun, write_recording
from mocap_ros.viewing.rerun_viewer import require_display, start_viewer
from mocap_ros.viewing.scene import Scene, SceneImage

SUFFIXES = ('.html', '.rrd')  # of the files that this command writes
# Options that say how an input is read and reconstructed.
OPTIONS_OF_INPUTS = (
    *('--person', '--camera-info', '--fps', '--image-size', '--hfov', '--focal', '--layout', '--detector'),
    *('--keyframes', '--model', '--config', '--set'),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Shows skeletons in 3D beside the 2D input, and over time residual, cadence, kind of motion, undone swaps '
        'of left and right, predicted frames and dropped inputs. Skeletons in a result of `reconstruct` (.npz, '
        '.mcap) or in a bag are shown as they are; all people in any other input that `reconstruct` accepts are '
        'reconstructed. Without -o a window of Rerun shows them (an optional part); OUT.html is one file that '
        'opens in any browser, offline.'
    )
    add_input_options(parser, is_required=False)
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUT',
        help='file to write: .html (a page for any browser) or .rrd (a recording for Rerun) (default: show the '
        'recording in a window of Rerun)',
    )
    parser.add_argument(
        '--keyframes',
        type=Path,
        metavar='FILE',
        help='keyframes to mark on the time line, in the file that `keyframes` writes (default: none)',
    )
    parser.add_argument(
        '--live',
        action='store_true',
        help='show what a running node publishes on `skeletons`, beside its keypoints, instead of an input '
        '(default: show IN)',
    )
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='namespace of the running node, for --live (default: none)'
    )
    add_model_option(parser)
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Load the scene of the input and show or write it."""
    output: Path | None = args.output
    if args.live:
        return _show_live(args)
    if args.input is None:
        raise InputError('give an input to show, or --live to show what a running node publishes')
    given = any((args.topic, args.camera_info, args.model, args.config, args.set))
    if given and args.input.is_file() and is_result_file(args.input):
        raise InputError(
            f'{args.input}: holds a result, which is shown as it is; --topic, --camera-info, --model, --config '
            'and --set apply to keypoints only'
        )
    if output is None:
        return _show(args)
    if output.suffix not in SUFFIXES:
        raise InputError(f'{output}: unknown file type; expected {", ".join(SUFFIXES)}')
    if output.suffix == '.rrd':
        import_rerun()
    config = load_config(args)
    sources = list_sources(args, config)
    check_output(output, *sources)
    scene = _load(args, config)
    with replace_output(output, *sources) as unfinished:
        if output.suffix == '.rrd':
            write_recording(scene, unfinished, images=_read_images(args, config, scene))
        else:
            unfinished.write_text(build_page(scene), encoding='utf-8')
    print_result(output)
    return 0


def _show(args: argparse.Namespace) -> int:
    """Show the scene in a window of Rerun until the window is closed."""
    import_rerun()
    require_display()
    config = load_config(args)
    scene = _load(args, config)
    with TemporaryDirectory(prefix='mocap_ros_') as folder:
        recording = Path(folder) / 'scene.rrd'
        write_recording(scene, recording, images=_read_images(args, config, scene))
        with start_viewer(recording) as (viewer, _):
            viewer.wait()
    return 0


def _show_live(args: argparse.Namespace) -> int:
    """Show what a node publishes in a window of Rerun until the window is closed."""
    if args.input is not None or args.output is not None:
        raise InputError('--live shows what a node publishes; it takes no input and no -o')
    for option in OPTIONS_OF_INPUTS:
        if getattr(args, option.removeprefix('--').replace('-', '_')):
            raise InputError(f'--live shows what a node publishes; {option} applies to an input only')
    rr = import_rerun()
    require_display()
    try:
        from mocap_ros.ros.live_view import KEYPOINTS_TOPIC, watch
        from mocap_ros.ros.names import find_name_fault
    except ImportError as error:
        raise MocapError(
            f'--live needs ROS 2, which this Python does not have ({error}); `make setup` installs it'
        ) from None
    topic = args.topic or KEYPOINTS_TOPIC
    for option, name, fault in (
        ('--namespace', args.namespace, find_name_fault(KEYPOINTS_TOPIC, args.namespace)),
        ('--topic', topic, find_name_fault(topic, args.namespace)),
    ):
        if fault:
            raise ConfigError(f'{option} {name!r}: {fault}')
    recording = rr.RecordingStream(APPLICATION, send_properties=False)
    with start_viewer() as (viewer, address):
        recording.connect_grpc(address)
        print_result('Waiting for skeletons; close the window or press Ctrl+C to end', flush=True)
        line = watch(LiveDrawing(recording), lambda: viewer.poll() is None, args.namespace, topic)
    print_result(line)
    return 0


def _read_images(args: argparse.Namespace, config: Config, scene: Scene) -> Iterable[SceneImage]:
    """Read the images of a bag with a progress bar; nothing else holds images."""
    if not is_bag(args.input):
        return []
    images = read_images(args.input, scene.stamps_ns, config.node, args.topic)
    return show_progress(images, 'images')


def _load(args: argparse.Namespace, config: Config) -> Scene:
    """Load the scene that the options describe, and print on stderr what was left out."""
    marks, marks_start_ns = ([], None) if args.keyframes is None else load_keyframe_marks(args.keyframes)
    options = SceneOptions(
        config=config,
        models=load_models(args, config),
        video=read_video_options(args),
        person=args.person,
        topic=args.topic,
        camera_info=args.camera_info,
        show_detection=show_detection_progress,
    )
    scene, lines = load_scene(args.input, options, lambda items, total: show_progress(items, 'view', total))
    for line in lines:
        print_remark(line)
    if marks_start_ns is not None:
        with name_file_in_errors(args.keyframes):
            marks = place_marks(marks, marks_start_ns, scene.stamps_ns)
    return replace(scene, marks=tuple(sorted((*scene.marks, *marks), key=lambda mark: mark.time_s)))
