# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Builds foreign interface packages for tests, once, into build/foreign."""

import os

from tests.support.paths import ROOT, load_module

PREFIX = ROOT / 'build' / 'foreign'
PACKAGES = ('yolo_msgs', 'hri_msgs')
builder = load_module(ROOT / 'config' / 'env' / 'build_messages.py')


def environment(env: dict[str, str]) -> dict[str, str]:
    """Return an environment in which the packages are found, after building what is not there yet."""
    builder.build(PREFIX, PACKAGES, PREFIX / 'src')

    def before(name: str, folder: os.PathLike[str]) -> dict[str, str]:
        return {name: os.pathsep.join([str(folder), *filter(None, [env.get(name)])])}

    return {
        **env,
        **before('PYTHONPATH', PREFIX / builder.SITE),
        **before('LD_LIBRARY_PATH', PREFIX / 'lib'),
        **before('AMENT_PREFIX_PATH', PREFIX),
    }
