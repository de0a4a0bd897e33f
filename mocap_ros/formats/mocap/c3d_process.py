# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The program that reads a C3D file with ezc3d and writes its content to stdout as .npz; `c3d.py` starts it.

ezc3d is compiled code that trusts what a file states: a damaged file may crash the process, ask for all the
memory, or never end. Therefore it runs in a process of its own, with limits. This program imports nothing of the
package.
"""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Mapping
from typing import Any

import ezc3d
import numpy as np

MAX_LABEL_LISTS = 258  # lists of 255 labels each, enough for the 65,535 points that a file may have


def list_labels(parameters: Mapping[str, Any]) -> list[Any]:
    """Return the labels of all points: a list holds 255, and the others follow in LABELS2, LABELS3 and so on."""
    names = ['LABELS', *(f'LABELS{number}' for number in range(2, MAX_LABEL_LISTS))]
    return [label for name in names if name in parameters for label in parameters[name]['value']]


def main(path: str, memory: int, seconds: int) -> None:
    """Read a file.

    Args:
        path: path of the file.
        memory: bytes of address space that the process may take.
        seconds: s of processor time that it may take.
    """
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    out = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # ezc3d prints warnings
    content = ezc3d.c3d(path)
    parameters = content['parameters']['POINT']
    with os.fdopen(out, 'wb') as stream:
        np.savez(
            stream,
            points=np.asarray(content['data']['points'], np.float64)[:3],
            labels=np.array([str(label) for label in list_labels(parameters)], np.str_),
            unit=np.array(''.join(parameters.get('UNITS', {}).get('value', [])[:1])),
        )


if __name__ == '__main__':
    try:
        main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
    except Exception as error:  # the C++ library raises almost any exception on malformed bytes
        sys.exit(' '.join(str(error).split()) or type(error).__name__)
