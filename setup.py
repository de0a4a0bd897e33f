import xml.etree.ElementTree as ET
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = ET.parse(Path(__file__).with_name('package.xml')).getroot()
NAME = PACKAGE.findtext('name')
MAINTAINER = PACKAGE.find('maintainer')

setup(
    name=NAME,
    version=PACKAGE.findtext('version'),
    description=PACKAGE.findtext('description'),
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get('email'),
    license=PACKAGE.findtext('license'),
    python_requires='>=3.10',
    packages=find_packages(include=[f'{NAME}*']),
    package_data={NAME: ['models/shipped/*.npz', 'demo/*.npz', 'messages/msg/*.msg', 'py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/mocap_ros.*')),
        (f'share/{NAME}/launch', glob('config/launch/*.launch.py')),
    ],
    entry_points={
        'console_scripts': [
            'mocap-ros = mocap_ros.cli.main:main',
            'mocap_node = mocap_ros.ros.main:main',
        ],
    },
    install_requires=[
        'numpy>=1.24,<3',
        'scipy>=1.10,<2',
        'mcap>=1.6,<2',
        'rosbags>=0.11.9,<0.12',
        'matplotlib>=3.6,<4',
        'PyYAML>=6.0,<7',
        'tqdm>=4.64,<5',
    ],
    extras_require={
        'c3d': ['ezc3d>=1.6,<2'],
        'train': ['torch>=2.2,<3'],
        'test': [
            'ezc3d>=1.6,<2',
            'pytest>=7.4,<10',
            'hypothesis>=6.90,<7',
            'mcap-ros2-support>=0.5.5,<0.7',
        ],
        'dev': [
            'ruff==0.17.*',
            'mypy==2.4.*',
            'import-linter==2.16.*',
            'types-PyYAML>=6.0,<7',
            'types-tqdm>=4.64,<5',
        ],
    },
    zip_safe=False,
)
