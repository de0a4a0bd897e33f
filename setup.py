# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the package shares with ROS, from package.xml; all else is in setup.cfg, which colcon reads as well."""

import re
import xml.etree.ElementTree as ET
from glob import glob
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, setup

ROOT = Path(__file__).resolve().parent  # also where colcon links this file from its build folder
PACKAGE = ET.parse(ROOT / 'package.xml').getroot()
NAME = PACKAGE.findtext('name')
MAINTAINER = PACKAGE.find('maintainer')
URLS = {url.get('type'): url.text for url in PACKAGE.findall('url')}
# A package index shows the README elsewhere, so its links to files of the repository name the repository there.
README = re.sub(
    r'(!?)(\[[^\]]*\]\()(?!https?:|#)',
    lambda link: f'{link[1]}{link[2]}{URLS["repository"]}/{"raw" if link[1] else "blob"}/main/',
    (ROOT / 'README.md').read_text(encoding='utf-8'),
)
# setuptools translates the sources with Cython, which since 3.1 puts what all modules need, two thirds of each,
# into one. Python's own flags define the overflow of signed integers: -fwrapv costs the loops a quarter of their
# speed, and none of them overflows. The search for common subexpressions of whole functions is a quarter of the
# build and gains nothing, and debugging symbols would be six sevenths of the size. Cython converts structs that
# hold arrays by pointers of another type, which GCC 14 takes for an error.
SHARED = 'mocap_ros.engine._shared'
FLAGS = [
    *('-O3', '-fno-gcse', '-fno-gcse-after-reload', '-g0', '-fno-wrapv', '-ffp-contract=off'),
    '-Wno-error=incompatible-pointer-types',
]
ENGINE = [
    Extension(
        source.removesuffix('.pyx').replace('/', '.'),
        [source],
        depends=glob('mocap_ros/engine/*.pxd'),
        extra_compile_args=FLAGS,
    )
    for source in sorted(glob('mocap_ros/engine/*.pyx'))
]
if find_spec('Cython') and find_spec('Cython.Build.SharedModule'):
    ENGINE.append(Extension(SHARED, [f'{SHARED.replace(".", "/")}.c'], extra_compile_args=['-O1', '-g0']))
    for module in ENGINE:
        module.shared_utility_qualified_name = SHARED

setup(
    name=NAME,
    version=PACKAGE.findtext('version'),  # setup.cfg marks one that is not released
    description=PACKAGE.findtext('description'),
    long_description=README,
    long_description_content_type='text/markdown',
    url=URLS['website'],
    project_urls={'Source': URLS['repository'], 'Issues': URLS['bugtracker']},
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get('email'),
    license=PACKAGE.findtext('license'),
    python_requires='>=3.10',  # in setup.cfg it would be no text, which colcon cannot take
    ext_modules=ENGINE,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/mocap_ros.*')),
        (f'share/{NAME}/launch', glob('config/launch/*.launch.py')),
    ],
)
