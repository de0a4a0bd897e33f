"""Reader of C3D files, which hold labelled markers; it needs the library `ezc3d` of the extra `c3d`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, MocapError, describe_read_error

Array = NDArray[np.float64]

METRES_BY_UNIT = {'m': 1.0, 'dm': 0.1, 'cm': 0.01, 'mm': 0.001}  # length in m of each unit that a file may name


def load_c3d(path: Path) -> tuple[dict[str, Array], float | None]:
    """Read the positions of all markers.

    Returns:
        The positions (F, 3) of each marker by its label, in the file's frame and unit, NaN where the marker was
        not seen; the label is without the subject's name, which ends with a colon. And the unit in m, or None
        where the file does not name it.

    Raises:
        InputError: the file cannot be read; the error names the file.
        MocapError: `ezc3d` is not installed.
    """
    try:
        import ezc3d
    except ImportError:
        raise MocapError(f"{path}: C3D needs ezc3d: pip install 'mocap_ros[c3d]'") from None
    if not path.is_file():
        raise InputError(f'{path}: no such file')
    try:
        content = ezc3d.c3d(str(path))
        points = np.asarray(content['data']['points'], np.float64)
        parameters = content['parameters']['POINT']
        labels = [str(label) for label in parameters['LABELS']['value']]
        unit = ''.join(parameters.get('UNITS', {}).get('value', [])[:1]).strip().lower()
    except Exception as error:  # the C++ library raises almost any exception on malformed bytes
        raise InputError(f'{path}: not a C3D file ({describe_read_error(error)})') from None
    names = [label.rpartition(':')[2].strip() for label in labels]
    positions = np.moveaxis(points[:3], 0, -1)
    return {name: positions[i] for i, name in enumerate(names) if i < len(positions)}, METRES_BY_UNIT.get(unit)
