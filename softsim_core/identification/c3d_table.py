"""Tables of motion capture: C3D files, as Qualisys, Vicon and OptiTrack write them.

Source: https://www.c3d.org, The C3D file format.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import DataError
from softsim_core.identification.table import Table

TIME: Final = "time_s"
"""The column with the time since the file's first frame."""


def read_c3d(file: Path, columns: Sequence[str]) -> Table:
    """Points and analog channels of a C3D file, a row for each frame in which all that is asked for was seen.

    A point's columns are LABEL:x_UNIT, LABEL:y_UNIT and LABEL:z_UNIT with the unit of the file, such as
    `tip:x_mm`; of an analog channel, LABEL, its first sample in the frame; and `time_s`.

    Args:
        file: The file.
        columns: What is asked for.

    Raises:
        DataError: it cannot be read, or what is asked for is in no frame.
    """
    try:
        import c3d
    except ImportError as error:
        raise DataError(
            file, "", "C3D files need the package c3d (pip install c3d), or export CSV"
        ) from error
    try:
        with file.open("rb") as stream:
            reader = c3d.Reader(stream)
            frames = [(points[:, :4], analog[:, :1]) for _, points, analog in reader.read_frames(copy=True)]
            told = _columns(reader, frames)
            rate = float(reader.point_rate)
    except Exception as error:  # a damaged file fails anywhere inside
        raise DataError(file, "", f"cannot be read as C3D ({error})") from error
    if not frames or not rate > 0.0:
        raise DataError(file, "", "holds no frames, or no rate of them")
    told[TIME] = np.arange(len(frames)) / rate
    asked = [told[name] for name in columns if name in told]
    seen = np.all([np.isfinite(each) for each in asked], axis=0) if asked else np.ones(len(frames), bool)
    if not seen.any():
        raise DataError(file, "", f"no frame shows all of {', '.join(columns)}")
    kept = {name: values[seen] for name, values in told.items()}
    return Table(file, kept, (np.flatnonzero(seen) + 1).tolist())


def _columns(reader: Any, frames: Sequence[tuple[Array, Array]]) -> dict[str, Array]:
    """All columns of the frames; nan where a point was not seen."""
    unit = reader.get("POINT:UNITS")
    name = "mm" if unit is None else unit.string_value.strip() or "mm"
    told: dict[str, Array] = {}
    for k, label in enumerate(map(str.strip, reader.point_labels)):
        points = np.array([frame[k] for frame, _ in frames], dtype=float).reshape(-1, 4)
        points[points[:, 3] < 0.0] = np.nan
        told |= {f"{label}:{axis}_{name}": points[:, i] for i, axis in enumerate("xyz")}
    for k, label in enumerate(map(str.strip, reader.analog_labels if reader.analog_used else ())):
        told[label] = np.array([analog[k, 0] for _, analog in frames], dtype=float)
    return told
