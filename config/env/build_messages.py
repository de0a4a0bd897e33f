# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Build message packages of others that no ROS here provides, from the fields that mocap_ros knows of them.

    build_messages.py PREFIX PACKAGE...

Packages that Python can import are left alone. A package has only the types that mocap_ros reads or writes; a ROS
that has the whole package should be used instead.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from mocap_ros.messages.foreign_types import DEFINITIONS

ROOT = Path(__file__).resolve().parents[2]
SITE = f'lib/python{sys.version_info[0]}.{sys.version_info[1]}/site-packages'
# Fields of types of ROS itself that its wheels have not; rosbags knows them, so mocap_ros need not.
OF_ROS = {
    'tf2_msgs/msg/TFMessage': 'geometry_msgs/TransformStamped[] transforms',
    'shape_msgs/msg/MeshTriangle': 'uint32[3] vertex_indices',
    'shape_msgs/msg/Mesh': 'shape_msgs/MeshTriangle[] triangles\ngeometry_msgs/Point[] vertices',
    'shape_msgs/msg/Plane': 'float64[4] coef',
    'shape_msgs/msg/SolidPrimitive': 'uint8 type\nfloat64[<=3] dimensions\ngeometry_msgs/Polygon polygon',
}
MARK = 'built_by_mocap_ros'  # file in the share folder of a package, with the hash of its fields
TEXTS: Mapping[str, str] = {**DEFINITIONS, **OF_ROS}


def build(prefix: Path, packages: Sequence[str], sources: Path) -> None:
    """Build packages from sources that are made in a folder, and install them; those that are there are kept."""
    prefixes = ';'.join([str(prefix), *os.environ.get('AMENT_PREFIX_PATH', sys.prefix).split(os.pathsep)])
    for package in packages:
        texts = {n.rpartition('/')[2]: t for n, t in TEXTS.items() if n.startswith(f'{package}/')}
        key = hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()
        done = prefix / 'share' / package / MARK
        if done.is_file() and done.read_text() == key:
            continue
        source, binary = sources / package, sources / f'{package}_build'
        shutil.rmtree(source, ignore_errors=True)
        (source / 'msg').mkdir(parents=True)
        for name, text in texts.items():
            (source / 'msg' / f'{name}.msg').write_text(text + '\n')
        for file in ('CMakeLists.txt', 'package.xml'):
            text = (ROOT / 'msg_defs' / file).read_text().replace('mocap_ros_msgs', package)
            (source / file).write_text(_add_dependencies(text, package, texts))
        options = [
            '-DBUILD_TESTING=OFF',
            f'-DCMAKE_INSTALL_PREFIX={prefix}',
            f'-DCMAKE_PREFIX_PATH={prefixes}',
            f'-DPYTHON_INSTALL_DIR={SITE}',
            f'-DPython3_EXECUTABLE={sys.executable}',
        ]
        for command in (
            ['cmake', '-S', str(source), '-B', str(binary), *options],
            ['cmake', '--build', str(binary), '--parallel'],
            ['cmake', '--install', str(binary)],
        ):
            subprocess.run(command, check=True)
        done.write_text(key)


def _add_dependencies(text: str, package: str, definitions: Mapping[str, str]) -> str:
    """Return a CMakeLists.txt with the packages whose types these definitions use besides the usual ones."""
    used = {name for d in definitions.values() for name in re.findall(r'^(\w+)/', d, re.MULTILINE)}
    others = sorted(used - {package, 'geometry_msgs', 'std_msgs'})
    found = ''.join(f'find_package({name} REQUIRED)\n' for name in others)
    text = text.replace('find_package(std_msgs REQUIRED)', f'{found}find_package(std_msgs REQUIRED)')
    return text.replace('DEPENDENCIES geometry_msgs', ' '.join(['DEPENDENCIES', *others, 'geometry_msgs']))


if __name__ == '__main__':
    target = Path(sys.argv[1]).resolve()
    ours = [p for p in sys.argv[2:] if find_spec(p) is None or (target / 'share' / p / MARK).is_file()]
    build(target, ours, ROOT / 'build' / 'messages')
