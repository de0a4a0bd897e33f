# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros view`: show a recording, a result or the running node in 3D, or draw a picture or a film."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from mocap_ros.bags.reader import is_bag
from mocap_ros.cli.inputs import INPUT_OPTIONS, MODEL_OPTIONS, list_sources, load_models, read_options
from mocap_ros.cli.options import (
    CONFIG_OPTIONS,
    STRICT_OPTIONS,
    Options,
    derive_output_stem,
    load_config,
    option,
    parse_count,
)
from mocap_ros.cli.terminal import (
    Report,
    ShareBar,
    finish,
    interrupt_between_items,
    print_note,
    print_result,
)
from mocap_ros.config import Config
from mocap_ros.detectors.detector import load_detector
from mocap_ros.errors import InputError, MocapError, ModelError
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.text_files import check_output, replace_output
from mocap_ros.formats.video import VideoReader, find_camera, hide_password, write_video
from mocap_ros.recordings.build_scene import build_scene, read_images
from mocap_ros.recordings.input_kind import (
    OPTIONS_BY_KIND,
    READ_FORMATS,
    READ_KINDS,
    InputKind,
    check_options,
    find_kind_with_results,
    name_option,
    require_kind,
)
from mocap_ros.recordings.reconstruct import MAX_PEOPLE, ReconstructionOptions, load_or_reconstruct
from mocap_ros.recordings.save_results import save_detections
from mocap_ros.recordings.watch import WAIT_S, NewestImage, Watch
from mocap_ros.viewing import plots
from mocap_ros.viewing.live_page import LiveScene, PageServer
from mocap_ros.viewing.overlay import Overlay, StampedImage, find_frame, pick_images, reduce_images
from mocap_ros.viewing.page import build_page
from mocap_ros.viewing.scene import Scene

PAGE_SUFFIX, FILM_SUFFIX = '.html', '.mp4'  # any other suffix is that of a picture
BAG_SUFFIX = '.mcap'  # of what --live records
DEFAULT_PORT, MAX_PORT = 8642, 65535  # of --live
POSES = 8  # frames in a picture; many more would be too small to see

DESCRIPTION = (
    'Shows skeletons in 3D beside the 2D input, and over time residual, cadence, kind of motion, undone swaps of '
    'left and right, predicted frames and dropped inputs, on a page: one file that opens in any browser, offline. '
    'The images of a video, or those in a bag, are behind the points. A film (.mp4) shows keypoints and skeletons '
    'in these images. A picture, such as OUT.png, shows some frames of one person: the keypoints and the 3D '
    'result as seen from the camera and from the side, and the error over time where a sequence file holds the '
    'true joints. Skeletons in a result of `reconstruct` or in a bag are shown as they are; the people in any '
    'other input that `reconstruct` accepts are reconstructed.'
)
OPTIONS: Options = {
    **INPUT_OPTIONS,
    'input IN': option(f'{INPUT_OPTIONS["input IN"]} (default: none, for --live)', nargs='?'),
    '-o --output OUT': 'page (.html), film (.mp4) or picture (.png, .svg, .pdf, ...) to write (default: IN.html '
    'in the current folder)',
    '--video FILE': 'video, or bag with images, that the keypoints of IN come from; the video of JSON or a table '
    'also gives times, image size and focal length (default: IN)',
    '--live CAMERA|NAMESPACE': option(
        'serve a page to browsers of this machine: of a camera (0, /dev/video0), a video at its own pace or a '
        'stream (rtsp://...), without ROS; or of what the running node publishes, in a namespace if there is one '
        '(default: show IN)',
        nargs='?',
        const='',
    ),
    '--port N': option(
        f'port of --live (default: {DEFAULT_PORT}; 0: any free one)',
        type=partial(parse_count, low=0, high=MAX_PORT),
    ),
    **MODEL_OPTIONS,
    **STRICT_OPTIONS,
    **CONFIG_OPTIONS,
}


def run(args: argparse.Namespace) -> int:
    """Load the scene of the input, and write its page or its picture."""
    if args.live is not None:
        source = find_live_source(args.live)
        return _run_live(args) if source is None else _run_camera(args, source)
    if args.input is None:
        raise InputError('what is to be shown? Give a file, or --live')
    if args.port is not None:
        raise InputError('--port applies only to --live')
    output: Path = args.output or Path(f'{derive_output_stem(args.input)}{PAGE_SUFFIX}')
    is_picture = output.suffix not in (PAGE_SUFFIX, FILM_SUFFIX)
    if is_picture:
        plots.check_picture_format(output, PAGE_SUFFIX, FILM_SUFFIX)
    require_kind(args.input, READ_KINDS, READ_FORMATS)
    kind = find_kind_with_results(args.input)
    check_options(args.input, vars(args) | {'video': None}, kind)
    config = load_config(args)
    sources = list_sources(args, config)
    check_output(output, *sources)
    with ShareBar('view') as report:
        count = 1 if is_picture or args.person else MAX_PEOPLE
        reading = _read_options(args, config, kind)
        options = ReconstructionOptions(config, load_models(args, config), reading, count)
        recording = load_or_reconstruct(args.input, options, report)
        scene = build_scene(args.input.name, recording)
    for line in recording.notes:
        print_note(line)
    notes: list[str] = []
    video = args.video or args.input
    with ShareBar('images') as report, replace_output(output, *sources) as unfinished:
        images = read_images(video, config.node, args.topic, notes)
        images = _check_times(scene, images, video, notes, report, is_given=args.video is not None)
        if output.suffix == PAGE_SUFFIX:
            scene = replace(scene, images=reduce_images(scene, images))
            unfinished.write_text(build_page(scene), encoding='utf-8')
            if scene.images and scene.images.jpegs:
                size_mb, step = sum(map(len, scene.images.jpegs)) / 1e6, scene.images.step
                every = 'every image' if step == 1 else f'one image of {step}'
                notes.append(f'{output}: holds {every}, {size_mb:.1f} MB')
        elif output.suffix == FILM_SUFFIX:
            write_video(unfinished, Overlay(scene).draw_film(images))
        else:
            save_picture(scene, unfinished, images)
    for line in notes:
        print_note(line)
    print_result(output)
    return finish(args.input, scene.summary, scene.is_wrong, is_strict=args.strict) if scene.summary else 0


def _read_options(args: argparse.Namespace, config: Config, kind: InputKind) -> ReadingOptions:
    """Return how the input is read; a video beside other inputs than JSON and tables has the images alone."""
    options = read_options(args, config)
    if 'video' in OPTIONS_BY_KIND[kind] and args.video and not is_bag(args.video):
        return options
    return options._replace(video=None)


def _check_times(
    scene: Scene, images: Iterable[StampedImage], path: Path, notes: list[str], report: Report, *, is_given: bool
) -> Iterator[StampedImage]:
    """Yield the images; `notes` gets a line if they seem to be of another recording."""
    size, frames = scene.image_size, len(scene.stamps_ns)
    are_far, (start_ns, *_, end_ns) = [], (*scene.stamps_ns, scene.stamps_ns[-1] + 1)
    for image in images:
        report(min(max((image.stamp_ns - start_ns) / (end_ns - start_ns), 0.0), 1.0))
        are_far.append(find_frame(scene, image.stamp_ns) < 0)
        size = image.image.shape[1::-1]
        yield image
    if are_far and all(are_far):
        notes.append(f'{path}: no image is at the time of a frame, so that none is shown')
    elif is_given and (size != scene.image_size or len(are_far) != frames) and not is_bag(path):
        given = f'{scene.title} has {frames} frames of {scene.image_size[0]} x {scene.image_size[1]} px'
        notes.append(f'{path}: {len(are_far)} images of {size[0]} x {size[1]} px, but {given}; is it that video?')


def _check_live_options(args: argparse.Namespace, kind: InputKind, *others: str) -> None:
    place = f'--live {hide_password(args.live)}'.strip()
    check_options(place, vars(args), kind)
    for name in ('input', 'strict', *others):
        if getattr(args, name):
            given = args.input if name == 'input' else name_option(name)
            raise InputError(f'{place}: {kind.value}, to which {given} does not apply')


def _run_live(args: argparse.Namespace) -> int:
    _check_live_options(args, InputKind.NODE, 'output')
    try:
        from mocap_ros.ros.live_view import serve
    except ImportError as error:
        raise MocapError(
            f'--live needs ROS 2, which this Python does not have ({error}); `make setup` installs it'
        ) from None
    serve(DEFAULT_PORT if args.port is None else args.port, args.live, lambda line: print_result(line, flush=True))
    return 0


def _run_camera(args: argparse.Namespace, source: Path | str) -> int:
    _check_live_options(args, InputKind.CAMERA)
    if args.output is not None and args.output.suffix != BAG_SUFFIX:
        raise InputError(f'{args.output}: unknown file type; --live records {BAG_SUFFIX}')
    config = load_config(args)
    if args.output is not None:
        check_output(args.output)
    is_camera = not isinstance(source, Path) or not source.is_file()
    scene = LiveScene(shown := hide_password(str(source)), shown)
    models, is_recorded = load_models(args, config), args.output is not None
    port = DEFAULT_PORT if args.port is None else args.port
    with (
        closing(load_detector(args.detector)) as detector,
        VideoReader(source, is_camera=is_camera) as reader,
        PageServer(scene, port) as server,
    ):
        watch = Watch(detector, models, config, scene, hfov=args.hfov, focal=args.focal, is_recorded=is_recorded)
        print_result(f'{server.address} shows {shown} in any browser of this machine; Ctrl-C ends', flush=True)
        ending = _watch_images(reader, watch, lambda: reader.is_live or is_recorded or scene.is_viewed)
    if args.output is not None and (ending is None or watch.has_people):
        detections = watch.collect()
        with replace_output(args.output) as unfinished:
            save_detections(unfinished, detections)
        print_result(f'{args.output}: {len(detections.people)} images')
    if ending is not None:
        raise ending
    return 0


def _watch_images(reader: VideoReader, watch: Watch, may_begin: Callable[[], bool]) -> MocapError | None:
    """Watch until the video ends or Ctrl-C; return the error of a camera that breaks off."""
    with suppress(KeyboardInterrupt, EOFError):
        while not may_begin():
            time.sleep(WAIT_S)
        with NewestImage(reader) as images, interrupt_between_items() as until_interrupted:
            try:
                for shot in until_interrupted(iter(images.take, ())):
                    if shot is not None:
                        watch.show(shot, reader.find_focal_length((shot.image.shape[1], shot.image.shape[0])))
            except (InputError, ModelError) as error:
                return error
    return None


def find_live_source(name: str) -> Path | str | None:
    """Return the device of a camera, a video file or the address of a stream; None for what is a namespace."""
    if '://' in name:
        return name
    if '.' in name and not Path(name).is_file():  # which no namespace has
        raise InputError(f'--live {name}: no such file, and no camera')
    return find_camera(name) or (Path(name) if Path(name).is_file() else None)


def save_picture(scene: Scene, path: Path, images: Iterable[StampedImage] = ()) -> None:
    """Draw `POSES` frames of the person seen in most frames, evenly distributed over those with a skeleton."""
    data = scene.to_plot_data()
    known = np.flatnonzero(np.isfinite(data.joints).all(axis=(1, 2)))
    if not len(known):
        raise InputError(f'{scene.title}: no frame has a skeleton')
    frames = known[np.linspace(0, len(known) - 1, min(POSES, len(known))).round().astype(int)].tolist()
    labels = [f'{scene.times[frame]:.2f} s' for frame in frames]
    data = replace(data, images=pick_images(scene, images, frames))
    plots.save_figure(plots.draw_poses_figure(data, frames, scene.title, labels), path)
