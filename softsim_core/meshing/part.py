"""Reading a part: its surface in metres, from a file whose unit the file itself often does not tell."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import MeshError
from softsim_core.mesh.readers import read_surface
from softsim_core.mesh.types import SurfaceMesh
from softsim_core.units import MILLIMETRE
from softsim_core.values import Placement
from softsim_core.wrong_names import known_names

UNITS = {"um": 1.0e-6, "mm": MILLIMETRE, "cm": 1.0e-2, "m": 1.0, "in": 2.54e-2}
"""Units of length that a file may be in, in [m]."""
_SMALL, _LARGE = 1.0e-2, 3.0
"""Longest sides in [m] outside of which the unit is doubted."""
_SMALLEST, _LARGEST = 1.0e-7, 1.0e4
"""Longest sides in [m] outside of which a part is refused."""


@dataclass(frozen=True, slots=True)
class Unit:
    """The unit of a part's file, for sentences about places in it.

    Attributes:
        name: One of UNITS.
        metres: Its length in [m].
    """

    name: str
    metres: float

    def length(self, metres: float) -> str:
        """A length as the file's user reads it: "12.3 mm"."""
        return f"{metres / self.metres:.4g} {self.name}"

    def size(self, metres: Array) -> str:
        """Lengths along the axes: "10 x 20 x 5 mm"."""
        return " x ".join(f"{each / self.metres:.4g}" for each in metres) + f" {self.name}"

    def place(self, metres: Array) -> str:
        """A place: "(1, 2, 3) mm"."""
        rounded = np.round(metres / self.metres, 4) + 0.0  # no -0
        return "(" + ", ".join(f"{each:.5g}" for each in rounded) + f") {self.name}"


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part as its file holds it.

    Attributes:
        surface: Triangles in [m], as they were found, named after the file.
        unit: The file's unit.
        told: Sentences about what was noticed.
    """

    surface: SurfaceMesh
    unit: Unit
    told: tuple[str, ...] = ()


def unit(name: str) -> Unit:
    """A unit by its name.

    Raises:
        MeshError: the name is not known.
    """
    if name not in UNITS:
        raise MeshError(name, f"is no unit of length that is known; {known_names(name, UNITS, 'known are')}")
    return Unit(name, UNITS[name])


_CURVED = frozenset((".step", ".stp", ".iges", ".igs", ".brep", ".x_t", ".sldprt", ".ipt", ".f3d", ".fcstd"))
"""CAD programs' own files; the readers there are of their curved faces are under the LGPL."""


def read_part(path: str | PathLike[str], unit_name: str = "mm") -> Part:
    """The surface of a part.

    Args:
        path: A file that `mesh.read_surface` reads: STL, OBJ, PLY, OFF and others.
        unit_name: Unit of its lengths, one of UNITS; CAD programs export STL in mm.

    Raises:
        MeshError: the file cannot be read, has no extent, or cannot be in that unit.
    """
    file, in_unit = Path(path), unit(unit_name)
    if file.suffix.lower() in _CURVED:
        raise MeshError(
            file, "is a CAD model of curved faces, which is not read; export it as STL, OBJ, PLY or OFF"
        )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        surface = read_surface(file, Placement(scale=in_unit.metres))
    told = [str(each.message).removeprefix(f"mesh {file}: ") for each in caught]
    size = np.ptp(surface.points, axis=0)
    longest = float(size.max())
    if not _SMALLEST <= longest <= _LARGEST:
        raise MeshError(
            file, f"is {longest:.3g} m long, if its unit is {unit_name}; say the unit it is in with --unit"
        )
    if not _SMALL <= longest <= _LARGE:
        told.append(f"it is {longest:.3g} m long, if its unit is {unit_name}: is that so? else say --unit")
    return Part(surface, in_unit, tuple(told))
