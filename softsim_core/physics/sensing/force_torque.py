r"""A force and torque sensor between a joint and all that hangs on it, such as at the flange of an arm.

Newton's and Euler's laws for everything that hangs there, deformable bodies of masses m at x, over a step of
length h:

.. math:: f = \sum m \frac{v_k - v_{k-1}}{h} - \sum m g - \sum f_{out}, \quad
          \tau = \sum (x - p) \times (\dots)

The outer forces include contacts, pulls and drag; moments are about the origin p of the frame. A velocity of
the step is the displacement in it divided by h, so its change is the acceleration at the start of the step:
positions and axes are taken there, and the result is of second order in h. Internal stress, such as that of
cables and air, adds nothing to the sums; a cable that is pulled from elsewhere counts in the measurement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np

from softsim_core.base import LOCAL, Array, IndexArray, Placement, SceneError, Vector
from softsim_core.physics.mechanics import FIXED, FREE, Carrier, Model, cross
from softsim_core.physics.sensing.description import (
    PLACE,
    Mount,
    Quantity,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
    both,
)
from softsim_core.physics.sensing.sensor import Place, Sensor, StepObservation


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceTorqueDescription(SimulatedSensorDescription):
    """Force in [N] and moment in [N m] of a joint on everything that hangs on it, as a sensor at a flange.

    Attributes:
        on: The joint; the deformable bodies attached to it and to joints that it carries count.
        pose: The sensor's frame in the frame that the joint moves (its scale is not used).
        force_noise: Standard deviation in [N] of each component of the force.
        moment_noise: Standard deviation in [N m] of each component of the moment.
        force_bias: Bias of the force in [N].
        moment_bias: Bias of the moment in [N m].
    """

    kind: ClassVar[str] = "force_torque"
    output_quantity: ClassVar[Quantity] = Quantity.WRENCH
    named_parts: ClassVar[Mapping[str, str]] = {"on": PLACE}
    on: str
    pose: Placement = field(default=Placement(), metadata=LOCAL)
    force_noise: float = 0.0
    moment_noise: float = 0.0
    force_bias: Vector = (0.0, 0.0, 0.0)
    moment_bias: Vector = (0.0, 0.0, 0.0)

    @property
    def mount(self) -> Mount:
        """Its own frame."""
        return Mount(self.on, self.pose)


class ForceTorqueSensor(Sensor):
    """Sensor of the force and moment between a joint and the bodies that hang on it.

    Raises:
        SceneError: there is no such joint, or a body that hangs on it is held elsewhere, too.
    """

    def __init__(self, described: ForceTorqueDescription, scenery: Scenery) -> None:
        super().__init__(
            both(described.force_noise, described.moment_noise),
            both(described.force_bias, described.moment_bias),
        )
        model, owner = scenery.soft.model, described.owner
        names = [joint.name for joint in model.joints]
        if described.on not in names:
            raise SceneError(f"{owner}: {described.on} is no joint; name a revolute or prismatic one")
        joint = names.index(described.on)
        self._place = Place(Carrier(joint=joint)).within(described.pose)
        beyond = [j for j in range(len(names)) if joint in model.chain(j)]
        nodes, hanging = [np.zeros(0, np.int64)], []
        starts = sorted((first, name) for name, first in scenery.soft.first_node.items())
        for (first, name), (end, _) in pairwise([*starts, (len(model.rest), "")]):
            own = np.arange(first, end)
            if _hangs(model, own, beyond, f"{owner}: the body {name}"):
                nodes.append(own)
                hanging.append(name)
        for name, place in scenery.places.items():
            if name in scenery.body_names and (place.carrier.joint in beyond or place.carrier.base in beyond):
                hanging.append(name)
        self._nodes = np.concatenate(nodes)
        self._bodies = np.array([scenery.body_names.index(name) for name in hanging], dtype=np.int64)

    def measure(self, observation: StepObservation) -> Array:
        """Return the force, then the moment, shape (6,)."""
        model, state, before = observation.model, observation.state, observation.before
        change = model.momentum(state.velocities - before.velocities) / model.dt
        free = (model.region_of_node == FREE)[:, None]  # moving a base is no motion
        rates = np.where(free, (state.positions - before.positions) / model.dt, state.velocities)
        missing = change - model.weight - observation.forces + observation.drag * model.momentum(rates)
        points = before.positions[self._nodes]
        origin, rotation = self._place.pose(model, before)
        touching = observation.contacts
        own = np.isin(touching.bodies, self._bodies)
        outside = (own[:, 0].astype(float) - own[:, 1])[:, None] * touching.forces
        force = missing[self._nodes].sum(axis=0) - outside.sum(axis=0)
        moment = cross(points - origin, missing[self._nodes]).sum(axis=0)
        moment -= cross(touching.points - origin, outside).sum(axis=0)
        return np.concatenate([force @ rotation, moment @ rotation])


def _hangs(model: Model, nodes: IndexArray, joints: Sequence[int], owner: str) -> bool:
    """Return whether one of some joints is attached to nodes of a body.

    Raises:
        SceneError: one is, and something else is attached to the body as well.
    """
    region = model.region_of_node[nodes]
    holding = {model.regions[r].joint for r in np.unique(region[region >= 0])} - {-1}  # not free frames
    if not holding.intersection(joints):
        return False
    if (region == FIXED).any() or model.spring[nodes].any() or holding.difference(joints):
        raise SceneError(
            f"{owner} is held elsewhere, too, so its motion does not determine what the joint does to it; "
            "choose another joint"
        )
    return True


FORCE_TORQUE = SensorKind(ForceTorqueDescription, ForceTorqueSensor)
