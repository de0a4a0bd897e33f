# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fuzz targets, one function for each kind of input from strangers, and valid inputs for mutations to start.

A target takes bytes. It returns where the bytes are read, or where they are refused with one clear error of
`mocap_ros.errors`; whatever else it raises is a fault. The same targets serve coverage-guided runs (`run.py`),
the tests with structured inputs and the replay of the inputs that once failed (`failed/`).
"""

import io
import json
import sqlite3
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from PIL import Image
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mocap_ros.bags.journal import Acceptance, Entry, decode_entry, encode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.rosbag2 import METADATA, encode_yaml, make_topic
from mocap_ros.bags.unpacking import ZSTD_MAGIC
from mocap_ros.config import Config, NodeConfig, RecorderConfig, from_yaml, to_yaml
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import MAX_MESSAGE_CHARACTERS, MocapError
from mocap_ros.formats.bvh import save_bvh
from mocap_ros.formats.cameras_file import load_cameras
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.mocap.joint_maps import load_marker_map
from mocap_ros.formats.mocap.trials import TrialOptions, load_trials
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.result_file import load_result_file
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.formats.tables import load_tables
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info
from mocap_ros.messages.cdr import Header, typestore
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON, OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.images import COMPRESSED_IMAGE, IMAGE, decode_image
from mocap_ros.messages.input_types import KEYPOINT_TYPES, decode_body, decode_frame, decode_ids
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS, decode_skeletons, encode_skeletons
from mocap_ros.messages.transform_tree import TransformTree
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.models.model_file import decode_base_poses, decode_lifter, load_base_poses, save_base_poses
from mocap_ros.npz_file import write_npz
from mocap_ros.recordings.load_keypoints import load_input
from mocap_ros.skeleton import CMU15, keypoint_layout
from tests.support.bodies import gather, make_person_3d
from tests.support.camera_messages import camera_info, encode, encode_ros1_camera_info, make_transforms
from tests.support.foreign_messages import create_blank_message, make_inputs
from tests.support.input_files import Z_UP_TO_Y_UP, make_bvh, make_poses
from tests.support.pipeline_inputs import BAG_STEP_NS, START_NS, make_keypoints
from tests.support.table_files import FORMS

IMAGE_SIZE = 640, 480  # px
LIMITS = NodeConfig()
VIDEO = ReadingOptions(fps=30.0, image_size=IMAGE_SIZE)
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
    _read_all(partial(load_input, place, VIDEO) for place in (path, folder))


def read_tables(data: bytes, folder: Path) -> None:
    """Read bytes as a table of every suffix."""
    paths = [folder / f'a.{suffix}' for suffix in ('csv', 'trc', 'npy')]
    for path in [*paths, folder / 'a_0.txt']:
        path.write_bytes(data)
    _read_all(partial(load_tables, place, VIDEO) for place in (*paths, folder))


def read_npz(data: bytes, folder: Path) -> None:
    """Read an .npz file as everything that it may be."""
    path = folder / 'a.npz'
    path.write_bytes(data)
    files = (partial(load, path) for load in (load_sequence, load_result_file, load_trials))
    _read_all((*files, *(partial(decode, data, 'a.npz') for decode in (decode_base_poses, decode_lifter))))


def read_yaml(data: bytes, folder: Path) -> None:
    """Read parameters, cameras, a map of markers, and a manifest of trials, which is CSV."""
    text = data.decode(errors='replace')
    (folder / 'a.yaml').write_text(text, encoding='utf-8', newline='')
    (folder / 'a.npz').write_bytes(b'')
    options = TrialOptions(manifest=folder / 'a.yaml')
    files = partial(load_marker_map, folder / 'a.yaml'), partial(load_trials, folder / 'a.npz', options)
    _read_all((partial(from_yaml, text, 'a.yaml'), partial(load_cameras, folder / 'a.yaml'), *files))


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
    """Recover what can be recovered of a bag, whose first bytes say what it is."""
    names = {b'SQLite': 'a.db3', ZSTD_MAGIC: 'a.mcap.zstd'}
    path = folder / next((name for start, name in names.items() if data.startswith(start)), 'a.mcap')
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
    'tables': read_tables,
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

Examples = Callable[[], list[bytes]]

CHUNK_BYTES = 2000  # of the example of MCAP: several chunks, so that there is an index to mutate
FRAMES = 3  # of the examples: short inputs are mutated faster
KEYPOINTS_MESSAGES = [make_keypoints(i) for i in range(FRAMES)]
# Another version of the keypoints, which are therefore converted.
OTHER_VERSION = """std_msgs/Header header
mocap_ros_msgs/Keypoints2D[] people
uint8[<=4] note
================================================================================
MSG: mocap_ros_msgs/Keypoints2D
string id
float32[] x
float64[] y
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def make_messages() -> list[bytes]:
    """Return a message of every type, behind the byte that chooses the type."""
    header = Header(7 * BAG_STEP_NS, 'camera')
    image, compressed, jpeg = create_blank_message(IMAGE), create_blank_message(COMPRESSED_IMAGE), io.BytesIO()
    image.height, image.width, image.step, image.encoding = 2, 2, 6, 'rgb8'
    image.data = np.arange(12, dtype=np.uint8)
    Image.new('RGB', (8, 8)).save(jpeg, 'JPEG')
    compressed.format, compressed.data = 'jpeg', np.frombuffer(jpeg.getvalue(), np.uint8)
    skeletons = encode_skeletons(header, gather([make_person_3d('a'), make_person_3d('b')]))
    bodies = make_inputs(HRI_SKELETON, 0)
    by_type = {
        **{t: make_inputs(t, 0)[0][1] for t in (KEYPOINTS, YOLO_DETECTIONS, ZED_OBJECTS, OPENPOSE_POSES)},
        HRI_SKELETON: bodies[1][1],
        HRI_IDS: bodies[0][1],
        CAMERA_INFO: camera_info(),
        TRANSFORMS: make_transforms(('map', 'camera', 0, (1, 2, 3)), ('camera', 'a', 5, (0, 0, 0))),
        SKELETONS: skeletons,
        IMAGE: encode(image, IMAGE),
        COMPRESSED_IMAGE: encode(compressed, COMPRESSED_IMAGE),
        'journal': encode_entry(Entry('input', 3, Acceptance.DROPPED, 'late', '/keypoints', {'tracker.lag': 0.2})),
    }
    return [bytes([number]) + by_type[name] for number, (name, _) in enumerate(MESSAGE_READERS)]


def _name_points(flat: list[float]) -> list[dict[str, object]]:
    points = zip(keypoint_layout('coco17').joints, np.reshape(flat, (-1, 3)).tolist(), strict=True)
    return [{'x': x, 'y': y, 'confidence': s, 'class': name} for name, (x, y, s) in points]


def make_json() -> list[bytes]:
    flat = np.nan_to_num(make_recording().keypoints[:2]).round(1).reshape(2, -1).tolist()
    people = [
        {'keypoints': np.reshape(f, (-1, 3))[:, :2].tolist(), 'keypoint_scores': f[2::3], 'bbox_score': 0.9}
        for f in flat
    ]
    columns = [{'x': f[::3], 'y': f[1::3], 'visible': f[2::3]} for f in flat]
    results = [{'image_id': i, 'keypoints': f, 'score': 0.9, 'idx': [1]} for i, f in enumerate(flat)]
    forms: list[object] = [
        results,
        {
            'images': [{'id': i, 'file_name': f'a_{i}.jpg', 'width': 640, 'height': 480} for i in range(2)],
            'annotations': results,
            'categories': [{'keypoints': ['nose', 'left_eye', 'right_eye']}],
        },
        {'instance_info': [{'frame_id': i, 'instances': [p]} for i, p in enumerate(people)]},
        [[{'keypoints': c, 'track_id': 3, 'confidence': 0.8}] for c in columns],
        {'people': [{'person_id': [4], 'pose_keypoints_2d': flat[0]}]},
        [[{'keypoints': p['keypoints'], 'scores': p['keypoint_scores'], 'labels': [*range(17)]}] for p in people],
        [{'predictions': [{'keypoints': _name_points(f)}], 'image': {'width': 640, 'height': 480}} for f in flat],
    ]
    return [json.dumps(form).encode() for form in forms]


def make_tables() -> list[bytes]:
    """Return a table of each form."""
    points = np.nan_to_num(make_recording().keypoints[:2]).round(1)
    tables = []
    for write in FORMS.values():
        with TemporaryDirectory() as folder:
            path = write(Path(folder), points)
            tables.append((path if path.is_file() else next(path.iterdir())).read_bytes())
    return tables


def make_bvhs() -> list[bytes]:
    with TemporaryDirectory() as folder:
        save_bvh(Path(folder) / 'a.bvh', build_armature(make_poses()[:2] @ Z_UP_TO_Y_UP.T, 30.0))
        whole = (Path(folder) / 'a.bvh').read_bytes()
    return [make_bvh(lambda text: text).encode(), whole]


def make_c3ds() -> list[bytes]:
    import ezc3d

    content = ezc3d.c3d()
    content['parameters']['POINT']['RATE']['value'] = [100]
    content['parameters']['POINT']['UNITS']['value'] = ['mm']
    content['parameters']['POINT']['LABELS']['value'] = [f'anna:{j}' for j in CMU15.joints]
    points = np.ones((4, 15, FRAMES))
    points[:3] = make_poses()[:FRAMES].transpose(2, 1, 0) * 1000
    content['data']['points'] = points
    with TemporaryDirectory() as folder:
        content.write(str(Path(folder) / 'a.c3d'))
        return [(Path(folder) / 'a.c3d').read_bytes()]


def make_npzs() -> list[bytes]:
    """Return a sequence file, a result file, an archive of joints, and base poses."""
    return [to_bytes(partial(write_npz, arrays=arrays)) for arrays in make_arrays()]


def to_bytes(write: Callable[[io.BytesIO], object]) -> bytes:
    stream = io.BytesIO()
    write(stream)
    return stream.getvalue()


def make_arrays() -> list[dict[str, NDArray[np.generic]]]:
    demo = make_recording().sequence()
    names = np.array(CMU15.joints)
    joints = np.arange(FRAMES * 45.0).reshape(FRAMES, 15, 3)
    model = to_bytes(lambda stream: save_base_poses(load_base_poses('walk').truncate(2), stream))
    with np.load(io.BytesIO(model)) as archive:
        base_poses = dict(archive)
    return [
        {
            'keypoints': demo.keypoints[:FRAMES].astype(np.float32),
            'joint_names': np.array(demo.joint_names),
            'timestamps': demo.timestamps[:FRAMES],
            'image_size': np.array(IMAGE_SIZE),
            'camera_matrix': np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
            'distortion': np.zeros(5),
            'joints3d': joints,
            'joints3d_names': names,
        },
        {
            'timestamps': np.arange(FRAMES) / 30,
            'joint_names': names,
            'joints3d': joints,
            'seen': np.ones((FRAMES, 15), bool),
            'residual_px': np.ones(FRAMES),
            'theta': np.zeros((FRAMES, 2)),
        },
        {'_joints': names, '35_01': joints},
        base_poses,
    ]


def make_yamls() -> list[bytes]:
    """Return a file of parameters, a map of markers and a manifest of trials."""
    markers = '\n'.join(f'{joint}: [{joint}]' for joint in CMU15.joints)
    tracker = {'mocap_node': {'ros__parameters': {'tracker': {'lag': 0.2}, 'node': {'output_frame': 'map'}}}}
    return [
        yaml.safe_dump(tracker).encode(),
        b'tracker: {model: walk, iterations: 4}\n',
        to_yaml(Config())[:800].encode(),
        markers.encode(),
        b'trial,subject,category,interior_glitches\n35_01,35,walk,0\n',
    ]


def make_mcaps() -> list[bytes]:
    """Return files without compression and checksums, which mutations would break, and one of each compression."""
    topic = make_topic('/keypoints', KEYPOINTS)
    qos = {'offered_qos_profiles': encode_yaml([dict(q) for q in topic.qos])}
    plain, *others = CompressionType
    compressed = (make_mcap(compression, topic.definition, qos) for compression in others)
    return [make_mcap(plain), make_mcap(plain, OTHER_VERSION), *compressed]


def make_mcap(
    compression: CompressionType,
    definition: str = '',
    metadata: dict[str, str] | None = None,
    messages: Sequence[bytes] = KEYPOINTS_MESSAGES,
) -> bytes:
    has_checksums = compression != CompressionType.NONE
    stream = io.BytesIO()
    writer = McapWriter(
        stream, chunk_size=CHUNK_BYTES, compression=compression, enable_crcs=has_checksums,
        enable_data_crcs=has_checksums,
    )  # fmt: skip
    writer.start('ros2', 'fuzz')
    schema = writer.register_schema(KEYPOINTS, 'ros2msg', definition.encode())
    channel = writer.register_channel('/keypoints', 'cdr', schema, metadata or {})
    for i, raw in enumerate(messages):
        writer.add_message(channel, START_NS + i * BAG_STEP_NS, raw, START_NS)
    writer.add_attachment(START_NS, START_NS, 'mocap_ros.yaml', 'text/yaml', b'a: 1')
    writer.add_metadata('rosbag2', {'serialized_metadata': 'ros_distro: kilted'})
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def make_databases(messages: Sequence[bytes] = KEYPOINTS_MESSAGES) -> list[bytes]:
    """Return a bag in SQLite3, in pages so small that mutations of a short file reach all of it."""
    with TemporaryDirectory() as folder:
        with Writer(Path(folder) / 'a', version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
            for i, raw in enumerate(messages):
                writer.write(connection, START_NS + i * BAG_STEP_NS, raw)
        file = Path(folder) / 'a' / 'a.db3'
        with closing(sqlite3.connect(file)) as database:
            database.execute('PRAGMA page_size=512')
            database.execute('VACUUM')
        return [file.read_bytes()]


def make_ros1_bags(raw: bytes = b'') -> list[bytes]:
    """Return bags of ROS 1 with a message, by default a CameraInfo, of each compression."""
    store, bags = get_typestore(Stores.ROS1_NOETIC), []
    raw = raw or encode_ros1_camera_info(store)
    with TemporaryDirectory() as folder:
        for compression in (None, *Ros1Writer.CompressionFormat):
            writer = Ros1Writer(Path(folder) / f'{compression}.bag')
            if compression is not None:
                writer.set_compression(compression)
            with writer:
                connection = writer.add_connection('/camera_info', CAMERA_INFO, typestore=store)
                for i in range(2):
                    writer.write(connection, START_NS + i * BAG_STEP_NS, raw)
            bags.append(writer.path.read_bytes())
    return bags


def make_folders() -> list[bytes]:
    """Return bag folders: metadata.yaml and the file of messages, as it is and compressed."""
    with TemporaryDirectory() as folder:
        with Recorder(Path(folder) / 'a', RecorderConfig(min_free_mb=0, compression='none')) as recorder:
            for i in range(2):
                recorder.write('/keypoints', KEYPOINTS, make_keypoints(i), START_NS + i * BAG_STEP_NS, START_NS)
        (file,) = (Path(folder) / 'a').glob('*.mcap')
        metadata = (Path(folder) / 'a' / METADATA).read_text().replace(file.name, 'a_0.mcap')
        content = file.read_bytes()
    compressed = metadata.replace('.mcap', '.mcap.zstd')
    for field, value in (('format', 'zstd'), ('mode', 'FILE')):
        compressed = compressed.replace(f"compression_{field}: ''", f'compression_{field}: {value}')
    return [
        metadata.encode() + FILE_SEPARATOR + content,
        compressed.encode() + FILE_SEPARATOR + zstandard.ZstdCompressor().compress(content),
    ]


EXAMPLES: dict[str, Examples] = {
    'messages': make_messages,
    'json': make_json,
    'tables': make_tables,
    'bvh': make_bvhs,
    'c3d': make_c3ds,
    'npz': make_npzs,
    'yaml': make_yamls,
    'mcap': make_mcaps,
    'db3': make_databases,
    'ros1': make_ros1_bags,
    'recovery': lambda: [*make_mcaps(), *make_databases()],
    'folder': make_folders,
}
