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

import ezc3d
import numpy as np

MAX_LABEL_LISTS = 258  # lists of 255 labels each, enough for the 65,535 points that a file may have


def main(path: str, memory: int, seconds: int) -> None:
    """Read a file in a process that may take this address space in bytes and this processor time in s."""
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    out = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # ezc3d prints warnings
    content = ezc3d.c3d(path)
    parameters = content['parameters']['POINT']
    lists = ['LABELS', *(f'LABELS{number}' for number in range(2, MAX_LABEL_LISTS))]
    labels = [label for name in lists if name in parameters for label in parameters[name]['value']]
    with os.fdopen(out, 'wb') as stream:
        np.savez(
            stream,
            points=np.asarray(content['data']['points'], np.float64)[:3],
            labels=np.array([str(label) for label in labels], np.str_),
            unit=np.array(''.join(parameters.get('UNITS', {}).get('value', [])[:1])),
        )


if __name__ == '__main__':
    try:
        main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
    except Exception as error:  # the C++ library raises almost any exception on malformed bytes
        sys.exit(' '.join(str(error).split()) or type(error).__name__)
