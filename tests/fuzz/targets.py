# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fuzz targets: one function for each kind of input from strangers.

A target takes bytes. It returns where the bytes are read, or where they are refused with one clear error of
`mocap_ros.errors`; whatever else it raises is a fault. The same targets serve coverage-guided runs (`run.py`),
the tests with structured inputs and the replay of the inputs that once failed (`failed/`).
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from mocap_ros.bags.journal import decode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recovery import recover
from mocap_ros.config import NodeConfig, from_yaml
from mocap_ros.errors import MAX_MESSAGE_CHARACTERS, MocapError
from mocap_ros.formats.detections import Video
from mocap_ros.formats.mocap.joint_maps import load_marker_map
from mocap_ros.formats.mocap.trials import TrialOptions, load_trials
from mocap_ros.formats.sequence_file import load_result_file, load_sequence
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE, decode_image
from mocap_ros.messages.input_types import KEYPOINT_TYPES, decode_body, decode_frame, decode_ids
from mocap_ros.messages.skeletons import SKELETONS, decode_skeletons
from mocap_ros.messages.transform_tree import TransformTree
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.models.model_file import decode_base_poses, decode_lifter
from mocap_ros.runtime.load_keypoints import InputOptions, load_input

IMAGE_SIZE = 640, 480  # px
LIMITS = NodeConfig()
VIDEO = Video(fps=30.0, image_size=IMAGE_SIZE)
FILE_SEPARATOR = b'\n%%%%\n'  # between the files of an input that has several
MAX_MESSAGES = 1000  # messages of a bag that a target decodes; a reader has no such limit, and none is needed

Read = Callable[[bytes, Path], object]  # reads bytes, and may write files into the folder, which is empty


def check(name: str, data: bytes) -> bool:
    """Give an input to a target; return whether it was read, and not refused by one clear error."""
    with TemporaryDirectory(prefix='fuzz') as folder:
        try:
            TARGETS[name](data, Path(folder))
        except MocapError as error:
            _check_message(str(error), '' if name in UNNAMED else folder)
            return False
        return True


def _check_message(message: str, place: str = '') -> None:
    """Check that an error is one printable line that names the place and says more than a Python error."""
    assert message.strip(), 'the error says nothing'
    assert place in message, f'the error does not name the file: {message}'
    assert message.isprintable(), f'the error is not one printable line: {message!r}'
    assert len(message) <= MAX_MESSAGE_CHARACTERS, f'the error has {len(message)} characters'
    for words in ('Unable to allocate', 'MemoryError', 'Traceback', ' object is not ', 'sys.'):
        assert words not in message, message


def _read_all(readers: Iterable[Callable[[], object]]) -> None:
    """Call all readers; raise the last error of this package where all of them refuse the input."""
    refusal, is_read = None, False
    for read in readers:
        try:
            read()
            is_read = True
        except MocapError as error:  # noqa: PERF203
            _check_message(str(error))
            refusal = error
    if refusal is not None and not is_read:
        raise refusal


def _read_transforms(raw: bytes) -> None:
    tree = TransformTree()
    for is_static in (True, False):
        tree.add(raw, is_static=is_static)
    with suppress(MocapError):
        tree.find('map', 'camera', 0, 0.1)
    tree.encode_all()


MESSAGE_READERS: tuple[tuple[str, Callable[[bytes], object]], ...] = (
    *((t, lambda raw, t=t: decode_frame(raw, t, LIMITS, IMAGE_SIZE)) for t in KEYPOINT_TYPES),
    (HRI_SKELETON, lambda raw: decode_body(raw, 'b0', IMAGE_SIZE, LIMITS)),
    (HRI_IDS, lambda raw: decode_ids(raw, LIMITS)),
    (CAMERA_INFO, lambda raw: (decode_camera_info(raw), decode_camera_info(raw, rectified=True))),
    (TRANSFORMS, _read_transforms),
    (SKELETONS, decode_skeletons),
    (IMAGE, lambda raw: decode_image(raw, IMAGE, LIMITS)),
    (COMPRESSED_IMAGE, lambda raw: decode_image(raw, COMPRESSED_IMAGE, LIMITS)),
    ('journal', decode_entry),
)


def read_message(data: bytes, _: Path) -> None:
    """Read a message whose first byte chooses the type."""
    if data:
        MESSAGE_READERS[data[0] % len(MESSAGE_READERS)][1](data[1:])


def read_json(data: bytes, folder: Path) -> None:
    """Read one person from JSON in the form of COCO and in that of OpenPose."""
    path = folder / 'a_0_keypoints.json'
    path.write_bytes(data)
    _read_all(partial(load_input, place, InputOptions(VIDEO)) for place in (path, folder))


def read_npz(data: bytes, folder: Path) -> None:
    """Read an .npz file as everything that it may be."""
    path = folder / 'a.npz'
    path.write_bytes(data)
    files = (partial(load, path) for load in (load_sequence, load_result_file, load_trials))
    _read_all((*files, *(partial(decode, data, 'a.npz') for decode in (decode_base_poses, decode_lifter))))


def read_yaml(data: bytes, folder: Path) -> None:
    """Read parameters, a map of markers, and a manifest of trials, which is CSV."""
    text = data.decode(errors='replace')
    (folder / 'a.yaml').write_text(text, encoding='utf-8', newline='')
    (folder / 'a.npz').write_bytes(b'')
    options = TrialOptions(manifest=folder / 'a.yaml')
    files = partial(load_marker_map, folder / 'a.yaml'), partial(load_trials, folder / 'a.npz', options)
    _read_all((partial(from_yaml, text, 'a.yaml'), *files))


def _read_bag(path: Path) -> None:
    with Bag(path) as bag:
        assert isinstance(bag.qos, dict)
        assert bag.latched_topics <= set(bag.topics)
        assert bag.duration_s is not None
        assert bag.count(bag.topics) >= 0
        bag.topics_of_type(KEYPOINT_TYPES)
        for _, message in zip(range(MAX_MESSAGES), bag.messages(list(bag.topics)), strict=False):
            with suppress(MocapError):
                if message.type in KEYPOINT_TYPES:
                    decode_frame(message.raw, message.type, LIMITS, IMAGE_SIZE)


def recover_bag(data: bytes, folder: Path) -> None:
    """Recover what can be recovered of a bag; the first bytes of an SQLite3 bag say what it is."""
    path = folder / ('a.db3' if data.startswith(b'SQLite') else 'a.mcap')
    path.write_bytes(data)
    _recover(path, folder / 'recovered')


def _recover(path: Path, out: Path) -> None:
    """Recover a bag; what was recovered must be a whole bag."""
    recover(path, out)
    try:
        _read_bag(out)
    except MocapError as error:
        if 'its definition cannot be parsed' not in str(error):  # nobody knows what a damaged text was
            raise AssertionError(f'the recovered bag is not whole: {error}') from None


def read_bag_folder(data: bytes, folder: Path) -> None:
    """Read a bag folder: metadata.yaml and the file of messages, separated by `FILE_SEPARATOR`."""
    metadata, _, content = data.partition(FILE_SEPARATOR)
    (folder / 'a_0.mcap').write_bytes(content)
    (folder / 'a_0.mcap.zstd').write_bytes(content)
    (folder / 'metadata.yaml').write_bytes(metadata)
    _read_bag(folder)


def _as_file(name: str, read: Callable[[Path], object]) -> Read:
    """Return a target that writes the bytes into a file, which is then read."""

    def read_file(data: bytes, folder: Path) -> None:
        (folder / name).write_bytes(data)
        read(folder / name)

    return read_file


TARGETS: dict[str, Read] = {
    'messages': read_message,
    'json': read_json,
    'bvh': _as_file('a.bvh', load_trials),
    'c3d': _as_file('a.c3d', load_trials),
    'npz': read_npz,
    'yaml': read_yaml,
    'mcap': _as_file('a.mcap', _read_bag),
    'db3': _as_file('a.db3', _read_bag),
    'ros1': _as_file('a.bag', _read_bag),
    'recovery': recover_bag,
    'folder': read_bag_folder,
}
# Targets whose input is no file, or is also read from memory; the errors of all others name the file or folder.
UNNAMED = ('messages', 'npz', 'yaml')
