"""C3D files: labelled markers. The library `ezc3d` reads them; it comes with the extra `c3d`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, MocapError, reader_reason

Array = NDArray[np.float64]

METRES = {'m': 1.0, 'dm': 0.1, 'cm': 0.01, 'mm': 0.001}
VERTICAL = {'x': 0, 'y': 1, 'z': 2}


def load_c3d(path: Path) -> tuple[dict[str, Array], float | None]:
    """The markers over time.

    Returns:
        (F, 3) positions by label, without the subject's name before a colon, in the file's frame and unit, NaN
        where a marker was not seen; and that unit in m, or None where the file does not say.

    Raises:
        InputError: the file cannot be read; names it.
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
    except Exception as error:  # C++ behind it raises almost anything on garbage
        raise InputError(f'{path}: not a C3D file ({reader_reason(error)})') from None
    names = [label.rpartition(':')[2].strip() for label in labels]
    positions = np.moveaxis(points[:3], 0, -1)
    return {name: positions[i] for i, name in enumerate(names) if i < len(positions)}, METRES.get(unit)
