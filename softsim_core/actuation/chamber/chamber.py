r"""A chamber: its volume, what it pushes, and how that turns with the wall.

With the shape functions N of the nodes of each face, over the reference triangle,

.. math:: V = \tfrac13 \sum \int x \cdot (x_\xi \times x_\eta), \quad
    \partial V / \partial x_a = \tfrac13 \sum \int \bigl(N_a \, x_\xi \times x_\eta
        + N_{a,\xi} \, x_\eta \times x + N_{a,\eta} \, x \times x_\xi\bigr)

exact for linear and quadratic faces. A pressure p pushes with p dV/dx, and -p d2V/dx2 is its stiffness: both
of a potential -p V, so symmetric. V is of third order in x, so one constant tensor per kind of face holds
them all:

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

from softsim_core.actuation.actuator import (
    Actuator,
    ActuatorView,
    GeometricStiffness,
    Transmission,
    no_geometric_stiffness,
    pressed_blocks,
)
from softsim_core.actuation.building import Placed, Surroundings
from softsim_core.actuation.chamber.description import ChamberDescription
from softsim_core.actuation.chamber.hollow import hollow_of
from softsim_core.actuation.chamber.pump_line import LEAST, PumpLine
from softsim_core.arrays import Array, IndexArray
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows
from softsim_core.mechanics.state import State

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
_WEAK = 1e-9
"""Parts of the stiffness below this share of the largest are left out."""
_PLAIN = {3: [[0, 1, 2]], 6: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}
"""The plain triangles that show a face, by how many nodes it has."""
REACHED = 1e-9
"""A pressure this near to another, as a part of the atmosphere's, has reached it."""


class _Measured(NamedTuple):
    """Volume in [m^3] and its slopes in [m^2], shape (k, 3), at places of the nodes in [m], shape (k, 3)."""

    places: Array
    volume: float
    row: Array


@dataclass(frozen=True, slots=True, eq=False)
class ChamberView(ActuatorView):
    """What one can see of a chamber.

    Attributes:
        volume: Of its hollow in [m^3].
    """

    volume: float = 0.0


class Chamber(Actuator):
    """A hollow of one body.

    Args:
        placed: Its joint and description.
        surroundings: What it is built into.

    Raises:
        SceneError: the body has no such hollow, see hollow_of.
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
        one, two = self.pairs  # dV/dx from x_b x x_c of each pair b < c
        self.shares = 0.5 * (twist[:, two, one] - twist[:, one, two])
        self._turning = twist.transpose(2, 0, 1).reshape(count, -1)
        corner = np.arange(self.faces.size)
        self._spread = sp.csr_matrix((np.ones(len(corner)), (self.faces.ravel(), corner)))
        rest = surroundings.model.rest[self.place]
        self.middle = rest.mean(axis=0)
        self._known = _Measured(np.full(rest.shape, np.nan), 0.0, rest)
        self.at_rest = self._volume((rest - self.middle)[self.faces])
        self.rest_volume = self.at_rest + self._volume(lids - self.middle)
        self.line = _line(described, self.rest_volume)
        lowest = (LEAST - 1.0) * self.line.atmosphere if self.line.softness else -self.line.atmosphere
        self._limits = max(described.min_pressure, lowest), described.max_pressure
        past = self.line.flow_limit < math.inf or (
            not self.by_multiplier and (self.line.softness > 0.0 or self.line.leak > 0.0)
        )
        self.keeps = 2 if past else 0  # the amount of air, and how much the pump has pushed in

    def value(self, model: Model, state: State) -> float:
        """By how much the volume has grown, in [m^3]."""
        return self._measured(state).volume - self.at_rest

    def row(self, model: Model, state: State) -> Array:
        """DV/dx in [m^2], shape (k, 3)."""
        return self._measured(state).row

    def transmission(self, command: float, multiplier: float) -> Transmission:
        """See Actuator; where nothing pumps for good, a line that leaks is empty at rest."""
        line, (low, high) = self.line, self._limits
        if self.by_multiplier:
            most = line.flow_limit / line.leak if line.leak else math.inf
            low = high = min(max(self._wanted(command), -most), most)
            return Transmission(command, 0.0, low, high)
        if line.leak:
            low = high = 0.0
        return self._tangent(command, 0.0, multiplier, (low, high))

    def command_of(self, value: float, multiplier: float) -> float:
        """See Actuator."""
        return multiplier if self.by_multiplier else self.line.amount(value, multiplier)

    def begin(self, state: State, kept: Array, command: float, span: float) -> Transmission:
        """See Actuator. A regulator gives all it can until the pressure is there, or takes all it can."""
        line, (low, high) = self.line, self._limits
        pressure = float(state.joint_efforts[self.joint])
        amount, pumped = kept.tolist()
        most, lost = span * line.flow_limit, span * line.leak
        if not self.by_multiplier:
            return self._tangent(amount + _between(command - pumped, most), lost, pressure, (low, high))
        wanted = self._wanted(command)
        rates = state.reduced_velocities[len(state.reduced_velocities) - len(state.joint_positions) :]
        ahead = float(state.joint_positions[self.joint] + span * rates[self.joint])
        if line.amount(ahead, wanted) + lost * wanted > amount:
            return self._tangent(amount + most, lost, pressure, (low, wanted))
        return self._tangent(amount - most, lost, pressure, (wanted, high))

    def end(self, state: State, kept: Array, command: float, span: float) -> None:
        """See Actuator; at a bound of the pressure, as much air was let in or out as it took."""
        line, (low, high) = self.line, self._limits
        growth, pressure = (float(each[self.joint]) for each in (state.joint_positions, state.joint_efforts))
        amount, pumped = kept.tolist()
        flow, near = span * line.flow_limit, REACHED * line.atmosphere
        free = low + near < pressure < high - near
        if self.by_multiplier:
            missing = self._wanted(command) - pressure
            flow, free = math.copysign(flow, missing), free and abs(missing) > near
        else:
            flow = _between(command - pumped, flow)
            pumped += flow
        amount += flow - span * line.leak * pressure
        kept[:] = amount if free else line.amount(growth, pressure), pumped

    def settle(self, state: State, kept: Array, command: float) -> None:
        """See Actuator."""
        growth, pressure = (float(each[self.joint]) for each in (state.joint_positions, state.joint_efforts))
        kept[:] = self.line.amount(growth, pressure), 0.0 if self.by_multiplier else command

    def _wanted(self, command: float) -> float:
        """The pressure that a command of pressure asks for, within its limits."""
        return min(max(command, self._limits[0]), self._limits[1])

    def _tangent(
        self, amount: float, lost: float, pressure: float, bounds: tuple[float, float]
    ) -> Transmission:
        """What the line keeps about a pressure, of an amount less `lost` times the pressure."""
        line, share = self.line, self.line.share(pressure)
        left = amount - lost * pressure
        slope = line.slope(left, pressure) + lost * share
        return Transmission(line.growth(left, pressure) + slope * pressure, slope, *bounds, share)

    def geometric_stiffness(self, model: Model, state: State, multiplier: float) -> GeometricStiffness:
        """See Actuator: the eigenvectors of each face's part of -p d2V/dx2."""
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
        """See Actuator: v of -p d2V/dx2 of each face."""
        assert self.surface is not None
        corners = (state.positions[self.surface] - self.middle).swapaxes(1, 2)
        count = corners.shape[2]
        v = np.reshape(corners, (-1, count)) @ (-multiplier * self._turning)
        return np.asarray(v.reshape(-1, 3, count, count))

    def view(self, model: Model, state: State, multiplier: float) -> ChamberView:
        """See Actuator: the hollow as plain triangles, four for a quadratic face."""
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

    def _measured(self, state: State) -> _Measured:
        """What it has at a state; a step asks several times for the same one."""
        places = state.positions[self.place]
        if not np.array_equal(places, self._known.places):
            corners = (places - self.middle)[self.faces]
            slopes = self._slopes(corners)
            row = np.asarray(self._spread @ slopes.reshape(-1, 3))
            row.flags.writeable = False
            self._known = _Measured(places, float((corners * slopes).sum() / 3.0), row)
        return self._known

    def _slopes(self, corners: Array) -> Array:
        """DV/dx of the nodes of each face, shape (m, a, 3)."""
        one, two = (corners[:, each] for each in self.pairs)
        turned = one[..., _NEXT] * two[..., _LAST] - one[..., _LAST] * two[..., _NEXT]
        return np.asarray(self.shares @ turned)

    def _volume(self, corners: Array) -> float:
        return float((corners * self._slopes(corners)).sum() / 3.0)


def _line(described: ChamberDescription, volume: float) -> PumpLine:
    """The line of a chamber whose hollow has a volume in [m^3] at rest."""
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
    """The value, no farther from 0 than `most`."""
    return min(max(value, -most), most)


def _linear() -> tuple[Array, Array, Array, Array]:
    """Weights, shape functions and their two slopes at the middle of a triangle."""
    first, second = np.array([[-1.0, 1.0, 0.0]]), np.array([[-1.0, 0.0, 1.0]])
    return np.array([0.5]), np.full((1, 3), 1.0 / 3.0), first, second


def _quadratic() -> tuple[Array, Array, Array, Array]:
    """The same of a triangle of six nodes, at six points: exact up to degree 4.

    Source of the points: Dunavant 1985, High degree efficient symmetrical Gaussian quadrature rules.
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
    """The tensor T, see the module, shape (a, a, a)."""

    def lesser(one: Array, two: Array, by: Array) -> Array:
        half = np.einsum("q,qa,qb,qc->abc", weights, one, two, by)
        return np.asarray(half - half.swapaxes(0, 1))

    turned = lesser(values, second, first) - lesser(values, first, second) - lesser(first, second, values)
    return np.asarray(turned / 3.0)


_TWISTS = {3: _twist(*_linear()), 6: _twist(*_quadratic())}
"""T of faces by how many nodes they have."""
