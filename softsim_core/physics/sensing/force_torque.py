r"""A force and torque sensor between a joint and what hangs on it, such as at the flange of an arm.

Newton's and Euler's laws of all that hangs there, deformable bodies of masses m at x, over a step of h:

.. math:: f = \sum m \frac{v_k - v_{k-1}}{h} - \sum m g - \sum f_{out}, \quad
          \tau = \sum (x - p) \times (\dots)

with contacts, pulls and drag among the forces from outside, about the origin p of the frame. A velocity of
the step is how far something came in it over h, so its change is the acceleration at the start of the step:
places and axes are taken there, and the whole is of second order in h. What is stressed inside, as cables and
air, adds nothing to the sums; a cable that is pulled from elsewhere is part of what is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from softsim_core.base import LOCAL, Array, IndexArray, Placement, SceneError, Vector
from softsim_core.physics.mechanics import FIXED, FREE, Carrier, Model, cross
from softsim_core.physics.sensing.description import (
    PLACE,
    Reference,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
    both,
)
from softsim_core.physics.sensing.sensor import Place, Seen, Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceTorqueDescription(SimulatedSensorDescription):
    """What a joint does to all that hangs on it, as a sensor at a flange: force in [N], moment in [N m].

    Attributes:
        on: The joint; it and joints that it carries hold the deformable bodies that count.
        pose: The sensor's frame in that which the joint moves (its scale is not used).
        force_noise: Standard deviation in [N] of each component.
        moment_noise: The same in [N m].
        force_bias: In [N].
        moment_bias: In [N m].
    """

    kind: ClassVar[str] = "force_torque"
    on: str
    pose: Placement = field(default=Placement(), metadata=LOCAL)
    force_noise: float = 0.0
    moment_noise: float = 0.0
    force_bias: Vector = (0.0, 0.0, 0.0)
    moment_bias: Vector = (0.0, 0.0, 0.0)

    def check(self) -> None:
        """See SimulatedSensorDescription."""
        self.need_noise(force_noise=self.force_noise, moment_noise=self.moment_noise)
        self.need_bias(force_bias=self.force_bias, moment_bias=self.moment_bias)

    def references(self) -> tuple[Reference, ...]:
        """See SimulatedSensorDescription."""
        return (Reference("on", self.on, PLACE),)


class ForceTorqueSensor(Sensor):
    """See the module.

    Args:
        nodes: Nodes of the bodies that hang on the joint, shape (k,).
        bodies: Numbers of all bodies, rigid ones too, that hang on it.
        place: The frame.
        noise, bias: Of force and moment, shape (6,).
    """

    def __init__(
        self, nodes: IndexArray, bodies: Sequence[int], place: Place, noise: Array, bias: Array
    ) -> None:
        super().__init__(noise, bias)
        self._nodes, self._bodies, self._place = nodes, np.array(bodies, dtype=np.int64), place

    def measure(self, seen: Seen) -> Array:
        """Force, then moment, shape (6,)."""
        model, state, before = seen.model, seen.state, seen.before
        change = model.momentum(state.velocities - before.velocities) / model.dt
        free = (model.region_of_node == FREE)[:, None]  # bases may be re-placed, which is no motion
        rates = np.where(free, (state.positions - before.positions) / model.dt, state.velocities)
        missing = change - model.weight - seen.forces + seen.drag * model.momentum(rates)
        points = before.positions[self._nodes]
        origin, rotation = self._place.pose(model, before)
        touching = seen.contacts
        own = np.isin(touching.bodies, self._bodies)
        outside = (own[:, 0].astype(float) - own[:, 1])[:, None] * touching.forces
        force = missing[self._nodes].sum(axis=0) - outside.sum(axis=0)
        moment = cross(points - origin, missing[self._nodes]).sum(axis=0)
        moment -= cross(touching.points - origin, outside).sum(axis=0)
        return np.concatenate([force @ rotation, moment @ rotation])


def _built(described: ForceTorqueDescription, scenery: Scenery) -> ForceTorqueSensor:
    model, owner = scenery.soft.model, f"sensor {described.name}"
    names = [joint.name for joint in model.joints]
    if described.on not in names:
        raise SceneError(f"{owner}: {described.on} is no joint; name a revolute or prismatic one")
    joint = names.index(described.on)
    beyond = [j for j in range(len(names)) if joint in model.chain(j)]
    nodes, bodies = [np.zeros(0, np.int64)], []
    for name, own in _nodes_of_bodies(scenery).items():
        if _hangs(model, own, beyond, f"{owner}: the body {name}"):
            nodes.append(own)
            bodies.append(scenery.body_names.index(name))
    for name, place in scenery.places.items():
        if name in scenery.body_names and (place.carrier.joint in beyond or place.carrier.base in beyond):
            bodies.append(scenery.body_names.index(name))
    return ForceTorqueSensor(
        np.concatenate(nodes),
        bodies,
        Place(Carrier(joint=joint)).within(described.pose),
        both(described.force_noise, described.moment_noise),
        both(described.force_bias, described.moment_bias),
    )


def _nodes_of_bodies(scenery: Scenery) -> dict[str, IndexArray]:
    """Nodes of each deformable body."""
    first = scenery.soft.first_node
    ends = [*sorted(first.values())[1:], len(scenery.soft.model.rest)]
    names = sorted(first, key=lambda name: first[name])
    return {name: np.arange(first[name], end) for name, end in zip(names, ends, strict=True)}


def _hangs(model: Model, nodes: IndexArray, joints: Sequence[int], owner: str) -> bool:
    """Whether one of some joints holds nodes of a body.

    Raises:
        SceneError: and something else holds it, too.
    """
    held = model.region_of_node[nodes]
    holding = {model.regions[r].joint for r in np.unique(held[held >= 0])} - {-1}  # free frames hold nothing
    if not holding.intersection(joints):
        return False
    if (held == FIXED).any() or model.spring[nodes].any() or holding.difference(joints):
        raise SceneError(
            f"{owner} is held elsewhere, too, so its motion does not tell what the joint does to it; choose "
            "another joint"
        )
    return True


FORCE_TORQUE = SensorKind(ForceTorqueDescription, _built)
