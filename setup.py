# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

import re
import xml.etree.ElementTree as ET
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).resolve().parent  # also where colcon links this file from its build folder
PACKAGE = ET.parse(ROOT / 'package.xml').getroot()
NAME = PACKAGE.findtext('name')
VERSION = PACKAGE.findtext('version')
# package.xml allows only numbers: that they are not released yet is what the first heading of the changelog says.
IS_UNRELEASED = f'## {VERSION} (unreleased)' in (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8').splitlines()
MAINTAINER = PACKAGE.find('maintainer')
# What `mocap-ros batch` needs, on this machine and on the workers: 60 MB to download, 48 of them pyarrow.
CLUSTER = ['distributed>=2024.2', 'fsspec>=2024.2', 'universal-pathlib>=0.2.2,<0.4', 'pyarrow>=15']
VIDEO = ['av>=14.2,<19', 'Pillow>=9.1']
URLS = {url.get('type'): url.text for url in PACKAGE.findall('url')}
# A package index shows the README elsewhere, so its links to files of the repository name the repository there.
README = re.sub(
    r'(!?)(\[[^\]]*\]\()(?!https?:|#)',
    lambda link: f'{link[1]}{link[2]}{URLS["repository"]}/{"raw" if link[1] else "blob"}/main/',
    (ROOT / 'README.md').read_text(encoding='utf-8'),
)

setup(
    name=NAME,
    version=f'{VERSION}.dev0' if IS_UNRELEASED else VERSION,
    description=PACKAGE.findtext('description'),
    long_description=README,
    long_description_content_type='text/markdown',
    url=URLS['website'],
    project_urls={
        'Source': URLS['repository'],
        'Issues': URLS['bugtracker'],
        'Changelog': f'{URLS["repository"]}/blob/main/CHANGELOG.md',
    },
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get('email'),
    license=PACKAGE.findtext('license'),
    license_files=[PACKAGE.find('license').get('file')],
    keywords=['motion capture', 'human pose', '3D reconstruction', 'monocular', 'keypoints', 'ROS 2'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Developers',
        'Intended Audience :: Science/Research',
        'License :: OSI Approved :: Apache Software License',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 15)),
        'Topic :: Multimedia :: Graphics :: 3D Modeling',
        'Topic :: Scientific/Engineering :: Image Processing',
        'Typing :: Typed',
    ],
    python_requires='>=3.10',
    packages=find_packages(include=[f'{NAME}*']),
    # An editable installation is then a path, which Python also searches from the folder above a clone; otherwise
    # it would take the clone itself for the package there, a folder of the same name.
    package_dir={'': '.'},
    package_data={
        NAME: ['models/shipped/*.npz', 'demo/*.npz', 'messages/msg/*.msg', 'py.typed', 'viewing/page_files/*']
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/mocap_ros.*')),
        (f'share/{NAME}/launch', glob('config/launch/*.launch.py')),
    ],
    entry_points={
        'console_scripts': [
            'mocap-ros = mocap_ros.cli.main:main',
            'detector_node = mocap_ros.ros.detector_main:main',
            'mocap_node = mocap_ros.ros.main:main',
        ],
    },
    install_requires=[
        'numpy>=1.24,<3',
        'scipy>=1.10,<2',
        'numba>=0.58,<1',
        'mcap>=1.6,<2',
        'apsw>=3.46,<4',  # which rosbags reads SQLite3 bags with
        'rosbags>=0.11.9,<0.12',
        'matplotlib>=3.6,<4',
        'PyYAML>=6.0,<7',
        'tqdm>=4.64,<5',
    ],
    extras_require={
        'audit': ['cyclonedx-bom>=5,<8', 'pip-audit>=2.7,<3'],
        'c3d': ['ezc3d>=1.6,<2'],
        'cluster': CLUSTER,
        'collision': ['coal>=3.0.2,<4'],  # distances between capsules, in one test; 400 MB with its libraries
        'fuzz': ['atheris>=2.3,<4'],  # coverage-guided fuzzing, 35 MB; its tests do without
        'mediapipe': [
            "mediapipe==0.10.21; python_version < '3.13'",  # the last version whose wheels hold a model
            "mediapipe>=0.10.30,<2; python_version >= '3.13'",  # needs a model file
            *VIDEO,
        ],
        'train': ['torch>=2.4,<3'],
        'test': [
            *CLUSTER,
            'ezc3d>=1.6,<2',
            'pytest>=7.4,<10',
            'pytest-cov>=5,<8',
            'hypothesis>=6.90,<7',
            'mcap-ros2-support>=0.5.5,<0.7',
            'av>=14.2,<19',
            'onnx>=1.16,<2',
            'onnxruntime>=1.18,<2',
        ],
        'dev': [
            'ruff==0.17.*',
            'mypy==2.4.*',
            'import-linter==2.16.*',
            'pre-commit>=4,<5',
            'types-PyYAML>=6.0,<7',
            'types-tqdm>=4.64,<5',
        ],
        'docs': ['furo>=2024.8', 'myst-parser>=4,<6', 'sphinx>=8.1,<10'],
        's3': ['s3fs>=2024.2'],
        'video': [*VIDEO, 'onnxruntime>=1.18,<2'],
    },
    zip_safe=False,
)
