r"""Pressure chamber: the faces of its cavity, its volume, forces and their stiffness, the line of its pump.

The amount a is the air that was pumped in and has not left, as the volume in [m^3] that it has at atmospheric
pressure. With the volume V of cavity and line at the start of the scene and the gauge pressure p, each part
of the air follows :math:`(P_0 + p) V^k = const` from atmospheric pressure on:

.. math:: s + V + c p = (V + a) \, r(p), \quad r(p) = (1 + p / P_0)^{-1/k}

where c is the compliance of the hoses. 1 / k = 0 describes water, which is incompressible.

With the shape functions N of the nodes of each face, over the reference triangle,

.. math:: V = \tfrac13 \sum \int x \cdot (x_\xi \times x_\eta), \quad
    \partial V / \partial x_a = \tfrac13 \sum \int \bigl(N_a \, x_\xi \times x_\eta
        + N_{a,\xi} \, x_\eta \times x + N_{a,\eta} \, x \times x_\xi\bigr)

exact for linear and quadratic faces. A pressure p has the forces p dV/dx and the stiffness -p d2V/dx2. Both
derive from the potential -p V, so the stiffness is symmetric. V is of third order in x, so one constant
tensor per kind of face determines them all:

.. math:: \frac{\partial^2 V}{\partial x_a \partial x_b} = [v_{ab}]_\times, \quad
    v_{ab} = \sum_c T_{abc} x_c, \quad
    \frac{\partial V}{\partial x_a} = \tfrac12 \sum_b v_{ab} \times x_b, \quad
    V = \tfrac13 \sum_a x_a \cdot \frac{\partial V}{\partial x_a}

Sources: Schweizerhof, Ramm 1984, Displacement dependent pressure loads; Bonet, Wood 2008, Nonlinear
continuum mechanics for finite element analysis, 8.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.base import Array, IndexArray, SceneError, listing
from softsim_core.physics.actuation import (
    Actuator,
    ActuatorView,
    GeometricStiffness,
    MeasuredSize,
    Placed,
    Surroundings,
    Transmission,
    no_geometric_stiffness,
    pressed_blocks,
)
from softsim_core.physics.actuation.chamber.description import ChamberDescription, closed_hollow
from softsim_core.physics.mechanics import FIXED, Model, Rows, State
from softsim_core.physics.mesh import boundary_faces, flip_faces

FLAT = 0.02
"""Largest distance of a rim from its plane, as a share of its radius."""


class Hollow(NamedTuple):
    """Boundary of a chamber.

    Attributes:
        faces: Node indices of its faces in the body's mesh, pointing out of the cavity, shape (m, a).
        lids: Node positions in [m] of the faces of fixed plates that close it, shape (k, a, 3).
    """

    faces: IndexArray
    lids: Array


def hollow_of(name: str, described: ChamberDescription, surroundings: Surroundings) -> Hollow:
    """Return the boundary of a chamber.

    Raises:
        SceneError: the body has no such cavity, or it is open.
    """
    body, surface, mesh = described.body, described.surface, surroundings.meshes[described.body]
    if surface is None:
        faces = closed_hollow(name, described, mesh)
        return Hollow(faces, np.zeros((0, faces.shape[1], 3)))
    if surface not in mesh.surfaces:
        hint = f"its surfaces are {listing(mesh.surfaces)}" if mesh.surfaces else "its mesh names none"
        raise SceneError(
            f"chamber {name}: body {body} has no surface {surface!r}: {hint}; name a physical group of "
            "faces in its Gmsh file"
        )
    faces = flip_faces(boundary_faces(mesh))
    rows = {tuple(sorted(corners)): k for k, corners in enumerate(faces[:, :3].tolist())}
    chosen = [rows.get(tuple(sorted(corners)), -1) for corners in mesh.surfaces[surface].tolist()]
    if -1 in chosen:
        raise SceneError(
            f"chamber {name}: {chosen.count(-1)} of the {len(chosen)} faces of surface {surface!r} are no "
            f"boundary of body {body}; name faces that its cells leave free"
        )
    faces = faces[np.unique(chosen)]
    first = surroundings.first_node[body]
    regions = surroundings.model.region_of_node[first : first + len(mesh.points)]
    lids = _lids(name, surface, faces, mesh.points, np.flatnonzero(regions == FIXED))
    corners = np.concatenate([mesh.points[faces[:, :3]], lids[:, :3]])
    middle = corners.mean(axis=(0, 1))
    a, b, c = np.moveaxis(corners - middle, 1, 0)
    if np.einsum("ki,ki->", a, np.cross(b, c)) <= 0.0:
        raise SceneError(
            f"chamber {name}: surface {surface!r} goes around body {body} from outside; name the faces "
            "of a hollow"
        )
    return Hollow(faces, lids)


def _lids(name: str, surface: str, faces: IndexArray, points: Array, fixed: IndexArray) -> Array:
    """Return faces of plates at the world that close an open surface, a fan in each opening.

    `fixed` are the nodes attached to the world.
    """
    sides = np.concatenate(
        [faces[:, [k, (k + 1) % 3, *([3 + k] if faces.shape[1] == 6 else [])]] for k in range(3)]
    )
    _, first, counts = np.unique(np.sort(sides[:, :2], axis=1), axis=0, return_index=True, return_counts=True)
    rim = sides[first[counts == 1]]
    if (counts > 2).any():
        raise SceneError(
            f"chamber {name}: an edge of surface {surface!r} has more than two faces; mend its mesh"
        )
    loose = ~np.isin(rim, fixed).all(axis=1)
    if loose.any():
        place = points[rim[np.flatnonzero(loose)[0], :2]].mean(axis=0).round(6).tolist()
        raise SceneError(
            f"chamber {name}: surface {surface!r} is open, at {int(loose.sum())} edges that are not attached "
            f"to the world (one at {place} m); close it, or attach its rim to the plate that closes it"
        )
    _, opening = connected_components(
        sp.coo_matrix((np.ones(len(rim)), rim[:, :2].T), shape=(len(points),) * 2), directed=False
    )
    found = [np.zeros((0, faces.shape[1], 3))]
    for one in np.unique(opening[rim[:, 0]]).tolist():
        edges = rim[opening[rim[:, 0]] == one]
        places = points[np.unique(edges)]
        middle = places.mean(axis=0)
        _, sizes, _ = np.linalg.svd(places - middle)
        if sizes[2] > FLAT * sizes[1]:
            raise SceneError(
                f"chamber {name}: the rim of surface {surface!r} around {middle.round(6).tolist()} m is not "
                "flat, and no plate closes it; let the surface end in a plane"
            )
        a, b, c = points[edges[:, 1]], points[edges[:, 0]], np.broadcast_to(middle, (len(edges), 3))
        fan = [a, b, c]
        if faces.shape[1] == 6:
            fan += [points[edges[:, 2]], 0.5 * (b + c), 0.5 * (c + a)]
        found.append(np.stack(fan, axis=1))
    return np.concatenate(found)


LEAST = 1e-3
"""Smallest absolute pressure, as a share of the atmosphere's, and smallest content of air, as a share of the
initial volume, below which a pump removes no more.
"""


@dataclass(frozen=True, slots=True)
class PumpLine:
    """Line between pump and chamber, see the module.

    Attributes:
        volume: V in [m^3].
        atmosphere: P0 in [Pa].
        softness: 1 / k in [-].
        compliance: c in [m^3/Pa].
        leak: Leak rate, as volume at atmospheric pressure in [m^3/s], per gauge pressure in [Pa].
        flow_limit: Largest flow of the pump in or out, as volume at atmospheric pressure in [m^3/s].
    """

    volume: float
    atmosphere: float
    softness: float
    compliance: float
    leak: float
    flow_limit: float

    def share(self, pressure: float) -> float:
        """Return r(p) in [-], the volume of air at a gauge pressure in [Pa] over that in the atmosphere."""
        return float(max(1.0 + pressure / self.atmosphere, LEAST) ** -self.softness)

    def growth(self, amount: float, pressure: float) -> float:
        """Return the growth s of the cavity in [m^3] with an amount in [m^3] at a pressure in [Pa]."""
        if self.softness == 0.0:
            return amount - self.compliance * pressure
        left = self._content(amount) * self.share(pressure) - self.volume
        return left - self.compliance * pressure

    def slope(self, amount: float, pressure: float) -> float:
        """Return -ds/dp of `growth` in [m^3/Pa], >= 0."""
        absolute = max(self.atmosphere + pressure, LEAST * self.atmosphere)
        return self.compliance + self._content(amount) * self.share(pressure) * self.softness / absolute

    def amount(self, growth: float, pressure: float) -> float:
        """Return the amount in [m^3] at which a cavity with the growth s in [m^3] has a pressure in [Pa]."""
        taken_up = growth + self.compliance * pressure
        if self.softness == 0.0:
            return taken_up
        return (self.volume + taken_up) / self.share(pressure) - self.volume

    def _content(self, amount: float) -> float:
        return max(self.volume + amount, LEAST * self.volume)


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
_WEAK = 1e-9
"""Share of the largest stiffness below which parts are left out."""
_PLAIN = {3: [[0, 1, 2]], 6: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}
"""Plain triangles of a face, by its number of nodes."""
REACHED = 1e-9
"""Difference of two pressures, as a share of the atmosphere's, up to which they count as equal."""


class _VolumeSlopes(NamedTuple):
    """Volume in [m^3] and its slopes in [m^2], shape (k, 3), at node positions in [m], shape (k, 3)."""

    places: Array
    volume: float
    row: Array


@dataclass(frozen=True, slots=True, eq=False)
class ChamberView(ActuatorView):
    """Visible state of a chamber.

    Attributes:
        volume: Volume of its cavity in [m^3].
    """

    volume: float = 0.0

    @property
    def measured_size(self) -> MeasuredSize:
        """Volume of its cavity in [m^3], which the coordinate enlarges."""
        return MeasuredSize(self.volume - self.value, 1.0)


class Chamber(Actuator):
    """Chamber: a cavity of one body under pressure.

    Args:
        placed: Its joint and description.
        surroundings: Model and meshes for which it is built.

    Raises:
        SceneError: the body has no such cavity, see hollow_of.
    """

    kind = "chamber"

    def __init__(self, placed: Placed, surroundings: Surroundings) -> None:
        described: ChamberDescription = placed.description
        faces, lids = hollow_of(placed.name, described, surroundings)
        nodes, numbered = np.unique(faces, return_inverse=True)
        super().__init__(
            placed.name,
            placed.joint,
            nodes + surroundings.first_node[described.body],
            by_multiplier=described.control == "pressure",
        )
        self.faces: IndexArray = numbered.reshape(faces.shape)
        self.surface = self.place[self.faces]
        count = faces.shape[1]
        twist, self.pairs = _TWISTS[count], np.triu_indices(count, 1)
        one, two = self.pairs  # dV/dx as a sum of x_b x x_c over the pairs b < c
        self.shares = 0.5 * (twist[:, two, one] - twist[:, one, two])
        self._turning = twist.transpose(2, 0, 1).reshape(count, -1)
        corner = np.arange(self.faces.size)
        self._spread = sp.csr_matrix((np.ones(len(corner)), (self.faces.ravel(), corner)))
        rest = surroundings.model.rest[self.place]
        self.middle = rest.mean(axis=0)
        self._last_volume = _VolumeSlopes(np.full(rest.shape, np.nan), 0.0, rest)
        self.at_rest = self._volume((rest - self.middle)[self.faces])
        self.rest_volume = self.at_rest + self._volume(lids - self.middle)
        self.line = _line(described, self.rest_volume)
        lowest = (LEAST - 1.0) * self.line.atmosphere if self.line.softness else -self.line.atmosphere
        self._limits = max(described.min_pressure, lowest), described.max_pressure
        past = self.line.flow_limit < math.inf or (
            not self.by_multiplier and (self.line.softness > 0.0 or self.line.leak > 0.0)
        )
        self.keeps = 2 if past else 0  # the amount of air, and the volume that the pump has moved in

    def value(self, model: Model, state: State) -> float:
        """Return the growth of the volume in [m^3]."""
        return self._measure_volume(state).volume - self.at_rest

    def row(self, model: Model, state: State) -> Array:
        """Return dV/dx in [m^2], shape (k, 3)."""
        return self._measure_volume(state).row

    def transmission(self, command: float, multiplier: float) -> Transmission:
        """Return the transmission at rest under a command, linearised at a pressure.

        In volume control, a line that leaks is empty at rest because no pump runs permanently.
        """
        line, (low, high) = self.line, self._limits
        if self.by_multiplier:
            most = line.flow_limit / line.leak if line.leak else math.inf
            low = high = min(max(self._clamp_pressure(command), -most), most)
            return Transmission(command, 0.0, low, high)
        if line.leak:
            low = high = 0.0
        return self._tangent(command, 0.0, multiplier, (low, high))

    def command_of(self, value: float, multiplier: float) -> float:
        """Return the command at rest: the pressure in pressure control, else the amount of air."""
        return multiplier if self.by_multiplier else self.line.amount(value, multiplier)

    def begin(self, state: State, internal: Array, command: float, span: float) -> Transmission:
        """Return the transmission of a step of `span` [s] that starts from a state and an amount of air.

        In pressure control, the regulator adds or releases air at its flow limit until the pressure is
        reached.
        """
        line, (low, high) = self.line, self._limits
        pressure = float(state.joint_efforts[self.joint])
        amount, pumped = internal.tolist()
        most, lost = span * line.flow_limit, span * line.leak
        if not self.by_multiplier:
            return self._tangent(amount + _between(command - pumped, most), lost, pressure, (low, high))
        target = self._clamp_pressure(command)
        rates = state.reduced_velocities[len(state.reduced_velocities) - len(state.joint_positions) :]
        ahead = float(state.joint_positions[self.joint] + span * rates[self.joint])
        if line.amount(ahead, target) + lost * target > amount:
            return self._tangent(amount + most, lost, pressure, (low, target))
        return self._tangent(amount - most, lost, pressure, (target, high))

    def end(self, state: State, internal: Array, command: float, span: float) -> None:
        """Update the amount of air and the pumped volume after a step of `span` [s].

        Where the pressure is at a bound, the amount of air is the one that this pressure needs.
        """
        line, (low, high) = self.line, self._limits
        growth, pressure = (float(each[self.joint]) for each in (state.joint_positions, state.joint_efforts))
        amount, pumped = internal.tolist()
        flow, near = span * line.flow_limit, REACHED * line.atmosphere
        free = low + near < pressure < high - near
        if self.by_multiplier:
            missing = self._clamp_pressure(command) - pressure
            flow, free = math.copysign(flow, missing), free and abs(missing) > near
        else:
            flow = _between(command - pumped, flow)
            pumped += flow
        amount += flow - span * line.leak * pressure
        internal[:] = amount if free else line.amount(growth, pressure), pumped

    def settle(self, state: State, internal: Array, command: float) -> None:
        """Set the amount of air and the pumped volume to their values at rest."""
        growth, pressure = (float(each[self.joint]) for each in (state.joint_positions, state.joint_efforts))
        internal[:] = self.line.amount(growth, pressure), 0.0 if self.by_multiplier else command

    def _clamp_pressure(self, command: float) -> float:
        """Return the commanded pressure, within its limits."""
        return min(max(command, self._limits[0]), self._limits[1])

    def _tangent(
        self, amount: float, lost: float, pressure: float, bounds: tuple[float, float]
    ) -> Transmission:
        """Return the line's constraint about a pressure, for an amount less `lost` times the pressure."""
        line, share = self.line, self.line.share(pressure)
        left = amount - lost * pressure
        slope = line.slope(left, pressure) + lost * share
        return Transmission(line.growth(left, pressure) + slope * pressure, slope, *bounds, share)

    def geometric_stiffness(self, model: Model, state: State, multiplier: float) -> GeometricStiffness:
        """Return -p d2V/dx2 as the eigenvectors and eigenvalues of each face's block."""
        if multiplier == 0.0:
            return no_geometric_stiffness()
        size = 3 * self.faces.shape[1]
        blocks = pressed_blocks(self.surface_stiffness(state, multiplier))
        parts = blocks.swapaxes(2, 3).reshape(-1, size, size)
        weights, vectors = np.linalg.eigh(parts)
        chosen = np.abs(weights) > _WEAK * np.abs(weights).max()
        face, which = np.nonzero(chosen)
        rows = np.swapaxes(vectors, 1, 2)[face, which].reshape(len(face), -1, 3)
        count = self.faces.shape[1]
        return GeometricStiffness(
            Rows(count * np.arange(len(face) + 1), self.place[self.faces[face]].ravel(), rows.reshape(-1, 3)),
            weights[face, which],
        )

    def surface_stiffness(self, state: State, multiplier: float) -> Array:
        """Return the vectors v of the blocks [v]x of -p d2V/dx2 by face in [N/m], shape (m, 3, a, a)."""
        assert self.surface is not None
        corners = (state.positions[self.surface] - self.middle).swapaxes(1, 2)
        count = corners.shape[2]
        v = np.reshape(corners, (-1, count)) @ (-multiplier * self._turning)
        return np.asarray(v.reshape(-1, 3, count, count))

    def view(self, model: Model, state: State, multiplier: float) -> ChamberView:
        """Return the cavity surface as plain triangles, four per quadratic face, and its volume."""
        places = state.positions[self.place]
        drawn = self.faces[:, _PLAIN[self.faces.shape[1]]].reshape(-1, 3)
        return ChamberView(
            name=self.name,
            kind=self.kind,
            points=np.zeros((0, 3)),
            value=self.value(model, state),
            multiplier=multiplier,
            surface=places[drawn],
            volume=self.rest_volume + self.value(model, state),
        )

    def _measure_volume(self, state: State) -> _VolumeSlopes:
        """Return volume and slopes at a state, cached because a step asks several times for the same one."""
        places = state.positions[self.place]
        if not np.array_equal(places, self._last_volume.places):
            corners = (places - self.middle)[self.faces]
            slopes = self._slopes(corners)
            row = np.asarray(self._spread @ slopes.reshape(-1, 3))
            row.flags.writeable = False
            self._last_volume = _VolumeSlopes(places, float((corners * slopes).sum() / 3.0), row)
        return self._last_volume

    def _slopes(self, corners: Array) -> Array:
        """Return dV/dx of the nodes of each face, shape (m, a, 3)."""
        one, two = (corners[:, each] for each in self.pairs)
        turned = one[..., _NEXT] * two[..., _LAST] - one[..., _LAST] * two[..., _NEXT]
        return np.asarray(self.shares @ turned)

    def _volume(self, corners: Array) -> float:
        return float((corners * self._slopes(corners)).sum() / 3.0)


def _line(described: ChamberDescription, volume: float) -> PumpLine:
    """Return the line of a chamber with a cavity of a volume in [m^3] at rest."""
    air = described.line_volume is not None
    return PumpLine(
        volume=volume + (described.line_volume or 0.0),
        atmosphere=described.atmosphere,
        softness=1.0 / described.exponent if air else 0.0,
        compliance=described.line_compliance,
        leak=described.leak,
        flow_limit=described.flow_limit,
    )


def _between(value: float, most: float) -> float:
    """Return the value, limited to the interval from -most to most."""
    return min(max(value, -most), most)


def _linear() -> tuple[Array, Array, Array, Array]:
    """Return weights, shape functions and their two slopes at the middle of a triangle."""
    first, second = np.array([[-1.0, 1.0, 0.0]]), np.array([[-1.0, 0.0, 1.0]])
    return np.array([0.5]), np.full((1, 3), 1.0 / 3.0), first, second


def _quadratic() -> tuple[Array, Array, Array, Array]:
    """Return weights, shape functions and slopes of a triangle of six nodes at six points.

    They are exact up to degree 4. Source of the points: Dunavant 1985, High degree efficient symmetrical
    Gaussian quadrature rules.
    """
    places, weights = [], []
    for weight, one in ((0.223381589678011, 0.445948490915965), (0.109951743655322, 0.091576213509771)):
        other = 1.0 - 2.0 * one
        places += [(one, one), (one, other), (other, one)]
        weights += [0.5 * weight] * 3
    xi, eta = np.array(places).T
    zero, rest = np.zeros(6), 1.0 - xi - eta
    corners = [rest * (2 * rest - 1), xi * (2 * xi - 1), eta * (2 * eta - 1)]
    values = [*corners, 4 * rest * xi, 4 * xi * eta, 4 * eta * rest]
    first = [1 - 4 * rest, 4 * xi - 1, zero, 4 * (rest - xi), 4 * eta, -4 * eta]
    second = [1 - 4 * rest, zero, 4 * eta - 1, -4 * xi, 4 * xi, 4 * (rest - eta)]
    return np.array(weights), np.stack(values, 1), np.stack(first, 1), np.stack(second, 1)


def _twist(weights: Array, values: Array, first: Array, second: Array) -> Array:
    """Return the tensor T, see the module, shape (a, a, a)."""

    def lesser(one: Array, two: Array, by: Array) -> Array:
        half = np.einsum("q,qa,qb,qc->abc", weights, one, two, by)
        return np.asarray(half - half.swapaxes(0, 1))

    turned = lesser(values, second, first) - lesser(values, first, second) - lesser(first, second, values)
    return np.asarray(turned / 3.0)


_TWISTS = {3: _twist(*_linear()), 6: _twist(*_quadratic())}
"""T of faces by their number of nodes."""
