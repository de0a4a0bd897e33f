# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What kind of input a path is, which options apply to it, and the sentences that refuse what is wrong."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import Enum
from pathlib import Path

from mocap_ros.bags.mcap_scan import begins_with
from mocap_ros.bags.reader import Bag, is_bag
from mocap_ros.errors import InputError
from mocap_ros.formats.npz_arrays import list_keys
from mocap_ros.formats.reading_options import NO_OPTIONS, ReadingOptions
from mocap_ros.formats.result_file import is_result_file
from mocap_ros.formats.tables import list_tables
from mocap_ros.input_file import NEITHER_FILE_NOR_FOLDER, is_special_file
from mocap_ros.messages.skeletons import SKELETONS

VIDEO_SUFFIXES = (
    '.mp4', '.m4v', '.mov', '.avi', '.mkv', '.webm', '.mpg', '.mpeg', '.wmv', '.flv', '.gif',
    '.ts', '.mts', '.m2ts',
)  # fmt: skip
IMAGE_SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff', '.webp', '.heic')
TABLE_SUFFIXES = ('.csv', '.npy', '.trc')
WRITTEN_SUFFIXES = ('.bvh',)  # of files that are written, but not read
WRITTEN_TABLE = b'time_s,'  # the beginning of tables (.csv) that are written

# What the commands read, in the words of messages.
KEYPOINT_FORMATS = (
    'a sequence file (.npz), a bag, JSON of a detector (a file, or a folder as of OpenPose), a table (.csv, '
    '.npy, .trc), or a video'
)
BAG_FORMATS = 'a bag (folder, .mcap, .db3 or .bag)'


class InputKind(Enum):
    """Kind of an input; the value describes it in a sentence that begins with the path."""

    SEQUENCE = 'is a sequence file'
    RESULT = 'is a result of reconstruct'
    WRITTEN = 'is of a format that mocap-ros writes but does not read'
    BAG = 'is a bag'
    SKELETONS = 'is a bag of skeletons'
    OPENPOSE = 'is a folder of JSON files'
    JSON = 'is a JSON file'
    TABLE = 'is a table, or a folder of tables'
    VIDEO = 'is a video'
    CAMERA = 'is shown live'
    NODE = 'is what the node publishes'
    IMAGE = 'is an image'
    IMAGES = 'is a folder of images'
    EMPTY_FILE = 'is an empty file'
    FOLDER = 'is a folder without a bag and without files of a detector'
    OTHER = 'is a file of an unknown type'
    SPECIAL = NEITHER_FILE_NOR_FOLDER
    MISSING = 'No such file or directory'


KEYPOINT_KINDS = (
    InputKind.SEQUENCE, InputKind.BAG, InputKind.OPENPOSE, InputKind.JSON, InputKind.TABLE, InputKind.VIDEO,
)  # fmt: skip
READ_KINDS = (*KEYPOINT_KINDS, InputKind.RESULT)
READ_FORMATS = f'{KEYPOINT_FORMATS}, or a result (.npz, .mcap)'
KIND_BY_SUFFIXES = {
    VIDEO_SUFFIXES: InputKind.VIDEO,
    IMAGE_SUFFIXES: InputKind.IMAGE,
    WRITTEN_SUFFIXES: InputKind.WRITTEN,
    ('.json',): InputKind.JSON,
    TABLE_SUFFIXES: InputKind.TABLE,
}


# Options of the command line that apply to a kind of input. To give one that applies to no input is an error.
_PARAMETERS = 'config', 'set', 'pitch'
_TO_RECONSTRUCT = 'hfov', 'focal', 'model', *_PARAMETERS
_UNTIMED = 'person', 'fps', 'image_size', 'layout', 'video', *_TO_RECONSTRUCT
OPTIONS_BY_KIND: Mapping[InputKind, tuple[str, ...]] = {
    InputKind.SEQUENCE: _TO_RECONSTRUCT,
    InputKind.BAG: ('person', 'topic', 'camera_info', 'image_size', *_TO_RECONSTRUCT),
    InputKind.VIDEO: ('person', 'detector', *_TO_RECONSTRUCT),
    InputKind.OPENPOSE: _UNTIMED,
    InputKind.JSON: _UNTIMED,
    InputKind.TABLE: ('normalised', *_UNTIMED),
    InputKind.CAMERA: ('detector', *_TO_RECONSTRUCT),
    InputKind.RESULT: (),
    InputKind.SKELETONS: ('person', 'topic', 'camera_info', *_PARAMETERS),
    InputKind.NODE: (),
}
OPTIONS = frozenset[str]().union(*OPTIONS_BY_KIND.values())
READING_OPTIONS = OPTIONS.intersection(NO_OPTIONS._fields)
RESULT_KINDS = (InputKind.RESULT, InputKind.SKELETONS)


def name_option(name: str) -> str:
    """Return an option as it is written on the command line."""
    return f'--{name.replace("_", "-")}'


def check_options(place: object, given: Mapping[str, object], *kinds: InputKind) -> None:
    """Check that the options that are given a value apply to an input, or to one of several of these kinds."""
    applicable = {name for kind in kinds for name in OPTIONS_BY_KIND[kind]}
    unused = [name_option(name) for name, value in given.items() if value and name in OPTIONS - applicable]
    if unused:
        raise InputError(f'{place}: {kinds[0].value}, to which {", ".join(unused)} does not apply')


def select_options(options: ReadingOptions, kind: InputKind) -> ReadingOptions:
    """Return options without those that do not apply to a kind of input."""
    unused = READING_OPTIONS.difference(OPTIONS_BY_KIND.get(kind, ()))
    return options._replace(**{name: getattr(NO_OPTIONS, name) for name in unused})


def find_kind_with_results(path: Path) -> InputKind:
    """Return the kind of an input; a bag counts as a result if there are skeletons in it."""
    kind = find_input_kind(path)
    if kind is InputKind.BAG:
        with Bag(path) as bag:
            return InputKind.SKELETONS if bag.topics_of_type([SKELETONS]) else kind
    return kind


def find_input_kind(path: Path) -> InputKind:
    """Return the kind of a file or folder, by its name and, where that says nothing, by its content.

    A file whose content is damaged is of the kind that its name says.
    """
    if not path.exists():
        return InputKind.MISSING
    if is_special_file(path):
        return InputKind.SPECIAL
    if is_bag(path):
        return InputKind.BAG
    if path.is_dir():
        return _find_folder_kind(path)
    if not path.stat().st_size:
        return InputKind.EMPTY_FILE
    for suffixes, kind in KIND_BY_SUFFIXES.items():
        if path.suffix.lower() in suffixes:
            return InputKind.WRITTEN if begins_with(path, WRITTEN_TABLE) else kind
    if is_result_file(path):
        return InputKind.RESULT
    return InputKind.SEQUENCE if path.suffix.lower() == '.npz' or list_keys(path) else InputKind.OTHER


def _find_folder_kind(folder: Path) -> InputKind:
    names = [path.name.lower() for path in folder.iterdir()]
    if any(name.endswith('.json') for name in names):
        return InputKind.OPENPOSE
    if any(name.endswith(IMAGE_SUFFIXES) for name in names):
        return InputKind.IMAGES
    return InputKind.TABLE if list_tables(folder) else InputKind.FOLDER


def require_kind(path: Path, accepted: Collection[InputKind], formats: str) -> InputKind:
    """Return the kind of an input; an InputError names the `formats` expected where it is none of `accepted`."""
    kind = find_input_kind(path)
    if kind in accepted:
        return kind
    if kind in (InputKind.MISSING, InputKind.SPECIAL):
        hint = '; folders are separated by / on this system' if '\\' in str(path) else ''
        raise InputError(f'{path}: {kind.value}{hint if kind is InputKind.MISSING else ""}')
    if kind in (InputKind.IMAGE, InputKind.IMAGES):
        advice = f'run a 2D keypoint detector on it, and give the keypoints as {KEYPOINT_FORMATS}'
    elif kind is InputKind.RESULT and InputKind.SEQUENCE in accepted:
        advice = 'give the sequence file that it was made from'
    elif kind is InputKind.VIDEO:
        advice = f'expected {formats}; `mocap-ros detect` finds the keypoints in it'
    elif kind in KEYPOINT_KINDS:
        advice = f'expected {formats}; `mocap-ros reconstruct` reads it'
    else:
        advice = f'expected {formats}'
    raise InputError(f'{path}: {kind.value}; {advice}')
