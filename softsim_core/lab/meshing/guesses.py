"""Initial guesses for an unknown part: its fixing, its tip, and the route of a cable."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, Box, Vector, vector
from softsim_core.lab.meshing.part import own_axes
from softsim_core.physics.mechanics import euler_of, rotation_log
from softsim_core.physics.mesh import TetMesh, boundary_surface

_UPRIGHT = 0.8  # of the longest side: a part of this height is fixed at its lowest face
_UNEVEN = 2.5e-3  # of the diagonal: unevenness of a flat face after meshing
_SLAB, _THICKEST = 0.01, 0.2  # of the length: thickness of the fixed region
_LEVELS = 7
_DEPTH = 0.1  # of the section: depth of a cable below its surface


class Guess(NamedTuple):
    """Guesses from which the first scene of a part is written.

    Attributes:
        axes: Its own axes as columns, shape (3, 3): those of the file, unless the part is rotated in it.
        axis: Index of its longest axis: 2 if it stands upright.
        length: Length along this axis in [m].
        base_box: Region of the nodes at its low end.
        tip: Region of the nodes at its high end.
        tip_place: Centre of that end in [m].
        cable: Points in [m] inside the part, from the low end to the high one, nearer to one side.
        pull_point: Pull point of the cable, before the low end, in [m].
    """

    axes: Array
    axis: int
    length: float
    base_box: Box
    tip: Box
    tip_place: Vector
    cable: tuple[Vector, ...]
    pull_point: Vector

    @property
    def tilt_deg(self) -> float:
        """Rotation of its axes relative to those of the file in [deg]."""
        return float(np.degrees(np.linalg.norm(rotation_log(self.axes))))


def guess(mesh: TetMesh) -> Guess:
    """Return guesses for a mesh: fixed at its lowest face, or at the low end of its longest side.

    All guesses for a part that is rotated in its file are along its own axes.
    """
    axes = own_axes(boundary_surface(mesh))
    if np.array_equal(axes, np.eye(3)):
        return _along_axes(mesh)
    return _transform_guess(_along_axes(replace(mesh, points=mesh.points @ axes)), axes)


def _transform_guess(found: Guess, axes: Array) -> Guess:
    """Transform guesses along the axes of a file to a part with axes of its own."""
    angles = vector(np.degrees(euler_of(axes)))

    def place(own: Vector) -> Vector:
        return vector(axes @ np.array(own))

    base, tip = (
        Box(center=place(own.center), size=own.size, rotation_deg=angles)
        for own in (found.base_box, found.tip)
    )
    return found._replace(
        axes=axes,
        base_box=base,
        tip=tip,
        tip_place=place(found.tip_place),
        cable=tuple(place(each) for each in found.cable),
        pull_point=place(found.pull_point),
    )


def _along_axes(mesh: TetMesh) -> Guess:
    """Return guesses along the axes of the file."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    size = high - low
    axis = 2 if size[2] >= _UPRIGHT * size.max() else int(size.argmax())
    tip = end_face(mesh.points, axis, at_top=True)
    cable = _cable(mesh, axis)
    pull = np.array(cable[0])
    pull[axis] = low[axis] - 0.1 * size[axis]
    top = mesh.points[mesh.points[:, axis] >= high[axis] - 0.5 * tip.size[axis]]
    middle = 0.5 * (top.min(axis=0) + top.max(axis=0))
    middle[axis] = high[axis]
    base = end_face(mesh.points, axis)
    return Guess(np.eye(3), axis, float(size[axis]), base, tip, vector(middle), cable, vector(pull))


def end_face(points: Array, axis: int = 2, at_top: bool = False) -> Box:
    """Return a slab around the nodes (n, 3) at an end of an axis, thick enough to contain more than a tip."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    others = [k for k in range(3) if k != axis]
    depth = (high[axis] - points[:, axis]) if at_top else (points[:, axis] - low[axis])
    share = min(max(_SLAB, _UNEVEN * float(np.linalg.norm(size)) / float(size[axis])), _THICKEST)
    while share < _THICKEST:
        chosen = points[depth <= share * size[axis]][:, others]
        if len(chosen) > 3 and np.ptp(chosen, axis=0).min() > 0.05 * size[others].min():
            break
        share *= 1.5
    centre, lengths = 0.5 * (low + high), 1.1 * size
    centre[axis] = high[axis] if at_top else low[axis]
    lengths[axis] = 2.0 * share * size[axis]
    return Box(center=vector(centre), size=vector(lengths))


def _cable(mesh: TetMesh, axis: int) -> tuple[Vector, ...]:
    """Return centres of elements along the axis, nearest to a line below the surface of the wider side."""
    middles = mesh.points[mesh.tets[:, :4]].mean(axis=1)
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    size = high - low
    side = max((k for k in range(3) if k != axis), key=lambda k: size[k])
    found = []
    for level in low[axis] + size[axis] * (np.arange(_LEVELS) + 0.5) / _LEVELS:
        near = middles[np.abs(middles[:, axis] - level) <= 0.5 * size[axis] / _LEVELS]
        if not len(near):
            continue
        middle_point = 0.5 * (near.min(axis=0) + near.max(axis=0))
        middle_point[axis] = level
        middle_point[side] = near[:, side].min() + _DEPTH * np.ptp(near[:, side])
        found.append(vector(near[np.linalg.norm(near - middle_point, axis=1).argmin()]))
    return tuple(found)
