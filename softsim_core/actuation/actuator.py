"""What an actuator is: a coordinate of the body, commanded, with the force that holds it there.

An actuator has a coordinate s(x) of the nodes and of the reduced coordinates (frames and joints), a command
q, and a multiplier t, which acts on the body as H^T t with the row H = ds/dx. With the compliance c of its
transmission the step, statics and inverse control keep

    s - q + c t = 0    while t is within its bounds; at a bound, t stays there and s goes where it goes

A cable has the shortening of its way as s and its tension as t, a chamber its volume and its pressure. An
actuator with `by_multiplier` takes t itself as command. Where a transmission is not linear, as the air of a
line, q and c are those of its tangent at the present t: see `transmission`. What it has to keep from step to
step, such as an amount of air, stands in the state: see `begin`. Every actuator belongs to a joint of the
scene, whose position is s, whose effort is t, and whose limits are those of the command.

What a new kind has to say is `place`, `value` and `row`; everything else has a default. Where the row turns
with the body, `geometric_stiffness` has to be said, too: statics need it, and so do the steps of bodies whose
law keeps its stress from step to step (rubber on quadratic cells). The stress under a taut cable takes
stiffness from such a body, the cable gives it back; with the first alone in the matrix, damping that is
proportional to it feeds the swinging instead. Steps take the rows with weights above 0, or in place of rows
the `surface_stiffness` of an actuator that presses on faces.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.pose import cross_matrices
from softsim_core.mechanics.rows import Rows, no_rows
from softsim_core.mechanics.state import State


class Transmission(NamedTuple):
    """What an actuator keeps, s - q + c t = 0 while t is within its bounds.

    Attributes:
        command: q.
        compliance: c >= 0.
        lower, upper: Bounds of t; equal ones impose it.
        gain: By how much q grows per unit of what is commanded.
    """

    command: float
    compliance: float
    lower: float
    upper: float
    gain: float = 1.0


class GeometricStiffness(NamedTuple):
    """What multipliers add to the stiffness, -d(H^T t)/dx = R^T diag(w) R.

    Attributes:
        rows: R on nodes and reduced coordinates.
        weight: w in [N/m] (for rows without unit) of each row, of either sign and not 0, shape (rows,).
    """

    rows: Rows
    weight: Array


@dataclass(frozen=True, slots=True, eq=False)
class ActuatorView:
    """What one can see of an actuator.

    Attributes:
        name: Name of its joint.
        kind: Name of its kind, such as "cable".
        points: The line that shows it in [m], world axes, shape (k, 3); without points none is drawn.
        value: Its coordinate s, in [m] for a cable.
        multiplier: What it acts with, in [N] for a cable.
        pulled_from_outside: Whether the first point lies outside the body, where the actuator starts.
        surface: Corners of the triangles that show it in [m], world axes, shape (m, 3, 3).
    """

    name: str
    kind: str
    points: Array
    value: float
    multiplier: float
    pulled_from_outside: bool = False
    surface: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))


class Actuator(ABC):
    """One actuator in NumPy.

    Args:
        name: Name of its joint.
        joint: Index of this joint in the model.
        place: What its coordinate depends on, the same in every state: indices of nodes, and number of nodes
            + reduced coordinate (see Model) of frames and joints, shape (k,).
        compliance: c >= 0: s - q + c t = 0, in [m/N] where s is a length.
        by_multiplier: Whether the command is t instead of s.
    """

    kind = "actuator"
    surface: IndexArray | None = None
    """Nodes of the faces that its multiplier presses on, shape (m, a); None: it presses on none."""
    keeps = 0
    """How many numbers it keeps from step to step."""

    def __init__(
        self,
        name: str,
        joint: int,
        place: IndexArray,
        *,
        compliance: float = 0.0,
        by_multiplier: bool = False,
    ) -> None:
        self.name, self.joint, self.place = name, joint, np.asarray(place, dtype=np.int64)
        self.compliance, self.by_multiplier = compliance, by_multiplier

    @abstractmethod
    def value(self, model: Model, state: State) -> float:
        """The coordinate s."""

    @abstractmethod
    def row(self, model: Model, state: State) -> Array:
        """H = ds/dx at `place`, shape (k, 3); of frames and joints only the first column counts."""

    def bounds(self, command: float) -> tuple[float, float]:
        """Smallest and largest multiplier under a command, which is q, or the wanted t with `by_multiplier`.

        Equal bounds impose the multiplier.
        """
        return (command, command) if self.by_multiplier else (-math.inf, math.inf)

    def transmission(self, command: float, multiplier: float) -> Transmission:
        """What it keeps at rest under a command, linearised at a multiplier."""
        return Transmission(command, self.compliance, *self.bounds(command))

    def command_of(self, value: float, multiplier: float) -> float:
        """The command under which it rests at a coordinate with a multiplier."""
        return multiplier if self.by_multiplier else value + self.compliance * multiplier

    def begin(self, state: State, kept: Array, command: float, span: float) -> Transmission:
        """What it keeps in a step of `span` [s] from a state; `kept` (k,) is what it kept of earlier ones.

        Only asked where `keeps` is not 0.
        """
        raise NotImplementedError(f"an actuator of kind {self.kind} that keeps numbers has to say `begin`")

    def end(self, state: State, kept: Array, command: float, span: float) -> None:
        """Change `kept` (k,) in place, after a step of `span` [s] that ended in a state."""
        raise NotImplementedError(f"an actuator of kind {self.kind} that keeps numbers has to say `end`")

    def settle(self, state: State, kept: Array, command: float) -> None:
        """Write `kept` (k,) as it is at rest."""
        raise NotImplementedError(f"an actuator of kind {self.kind} that keeps numbers has to say `settle`")

    def geometric_stiffness(self, model: Model, state: State, multiplier: float) -> GeometricStiffness:
        """-d(H^T t)/dx at a multiplier t; needed where H turns with the body."""
        return no_geometric_stiffness()

    def surface_stiffness(self, state: State, multiplier: float) -> Array:
        """The geometric stiffness face by face, in [N/m]: v of the blocks [v]x of all pairs of nodes.

        Shape (m, 3, a, a); an even pressure has such blocks, and v_ab = -v_ba.
        """
        raise NotImplementedError(f"an actuator of kind {self.kind} with a surface has to say its stiffness")

    def view(self, model: Model, state: State, multiplier: float) -> ActuatorView:
        """What one can see of it."""
        return ActuatorView(self.name, self.kind, np.zeros((0, 3)), self.value(model, state), multiplier)


def pressed_blocks(vectors: Array) -> Array:
    """The blocks [v]x, shape (m, a, a, 3, 3), of vectors (m, 3, a, a); see Actuator.surface_stiffness."""
    return cross_matrices(np.moveaxis(vectors, 1, -1))


def no_geometric_stiffness() -> GeometricStiffness:
    """That of an actuator whose row does not turn."""
    return GeometricStiffness(no_rows(), np.zeros(0))
