"""The mechanical model: a scene compiled to arrays, and its generalised coordinates.

Nodes are free (three unknowns each) or belong to a rigid zone that is held still, moves with a joint, or is a
free rigid frame. Frames and joints are the *border*: few unknowns beside the sparse interior. Each border
unknown is a screw: at the point x it moves the body by `angular x (x - origin) + linear` a unit of its
velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.actuation.limits import JointLimits
from softsim_core.arrays import Array, IndexArray
from softsim_core.fem.tetrahedra import Tetrahedra
from softsim_core.mechanics.pose import cross_matrix, rotation_exp
from softsim_core.mechanics.rigid import RigidBodies
from softsim_core.mechanics.state import State

FREE, HELD = -1, -2
"""Zone numbers of nodes that are free, and of nodes that are held still."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A joint compiled: base frame, axis and law; see JointDescription for units.

    `parent` is the index of the joint that carries the base, or -1. A cable's joint moves no frame:
    its position is the travel of the cable.
    """

    name: str
    revolute: bool
    base_position: Array
    base_rotation: Array
    axis: Array
    slide_axis: Array
    limits: JointLimits
    rest: float
    stiffness: float | None
    inertia: float
    parent: int = -1
    cable: bool = False

    def frame(self, position: float, base_shift: float) -> tuple[Array, Array]:
        """Origin (3,) and rotation (3, 3) of the frame that the joint moves."""
        origin = self.base_origin(base_shift)
        if self.revolute:
            return origin, self.base_rotation @ rotation_exp(position * self.axis)
        return origin + self.base_rotation @ (position * self.axis), self.base_rotation

    def base_origin(self, base_shift: float) -> Array:
        """Origin (3,) in [m] of the base frame, shifted by `base_shift` [m] along the slide axis."""
        return self.base_position + base_shift * (self.base_rotation @ self.slide_axis)


@dataclass(frozen=True, slots=True, eq=False)
class Zone:
    """A rigid zone: nodes that follow a frame.

    Attributes:
        name: Name of the attachment.
        frame: Index of the free frame, or -1 when a joint moves the zone.
        joint: Index of the joint, or -1 when the zone is a free frame.
        nodes: Node indices, shape (k,).
        local: Node positions in the frame in [m], shape (k, 3).
        border: Indices of the border unknowns that move it: six of a frame, or a joint's behind those of the
            joints that carry it.
    """

    name: str
    frame: int
    joint: int
    nodes: IndexArray
    local: Array
    border: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A scene compiled to arrays (immutable; what changes in time is State, what a user tunes is Parameters).

    Attributes:
        rest: Rest positions in [m], shape (n, 3).
        elements: Tetrahedra of all bodies.
        element_body: Index of each element's body, shape (m,).
        mass: Lumped node masses in [kg], shape (n,).
        spring: Stiffness in [N/m] that pulls a node to its rest position (soft fixings), shape (n,).
        gravity: Gravity in [m/s^2], shape (3,).
        dt: Time step in [s].
        law: Rotation law of the elements, "polar" or "qr".
        zone_of_node: Zone of each node, or FREE, or HELD, shape (n,).
        zones: Rigid zones that move.
        frame_names: Names of the free frames; frame f owns the border unknowns 6 f .. 6 f + 5 (velocity, then
            spin).
        frame_rest: Rest origins in [m] (f, 3) and rotations (f, 3, 3) of the free frames.
        joints: Joints; joint j owns the border unknown 6 len(frame_names) + j.
        rigid: Rigid bodies with mass; they meet the rest in contacts only.
    """

    rest: Array
    elements: Tetrahedra
    element_body: IndexArray
    mass: Array
    spring: Array
    gravity: Array
    dt: float
    law: str
    zone_of_node: IndexArray
    zones: tuple[Zone, ...]
    frame_names: tuple[str, ...]
    frame_rest: tuple[Array, Array]
    joints: tuple[Joint, ...]
    rigid: RigidBodies

    @property
    def border_size(self) -> int:
        """Number of border unknowns: six a free frame, one a joint."""
        return 6 * len(self.frame_names) + len(self.joints)

    @property
    def free_nodes(self) -> IndexArray:
        """Indices of the free nodes, ascending."""
        return np.flatnonzero(self.zone_of_node == FREE)

    @property
    def compliant_joints(self) -> IndexArray:
        """Indices of the joints that a spring pulls to their command."""
        return np.array(
            [j for j, joint in enumerate(self.joints) if joint.stiffness is not None], dtype=np.int64
        )

    def rest_state(self) -> State:
        """The state at which the scene is built: everything at rest, joints at their rest positions."""
        state = self.empty_state()
        state.positions[:] = self.rest
        state.frame_positions[:], state.frame_rotations[:] = self.frame_rest
        state.joint_positions[:] = [joint.rest for joint in self.joints]
        state.rigid_positions[:] = self.rigid.rest_positions
        state.rigid_rotations[:] = self.rigid.rest_rotations
        self.place_zones(state)
        return state

    def empty_state(self) -> State:
        """A state of the right shape, all zeros."""
        return State(len(self.rest), len(self.frame_names), len(self.joints), len(self.rigid.names))

    def chain(self, joint: int) -> list[int]:
        """A joint behind the joints that carry it, the outermost first."""
        carriers = [joint]
        while self.joints[carriers[0]].parent >= 0:
            carriers.insert(0, self.joints[carriers[0]].parent)
        return carriers

    def joint_frame(self, j: int, state: State) -> tuple[Array, Array]:
        """Origin (3,) and rotation (3, 3) of the frame that joint j moves."""
        position, shift = float(state.joint_positions[j]), float(state.base_shift[0])
        return self._carried(j, state, *self.joints[j].frame(position, shift))

    def base_frame(self, j: int, state: State) -> tuple[Array, Array]:
        """Origin (3,) and rotation (3, 3) of the base of joint j."""
        joint = self.joints[j]
        return self._carried(j, state, joint.base_origin(float(state.base_shift[0])), joint.base_rotation)

    def _carried(self, j: int, state: State, origin: Array, rotation: Array) -> tuple[Array, Array]:
        """Where a frame is now that is at `origin` (3,), `rotation` (3, 3) while joint j's parent rests."""
        parent = self.joints[j].parent
        if parent < 0:
            return origin, rotation
        joint = self.joints[parent]
        rest_origin, rest_rotation = joint.frame(joint.rest, float(state.base_shift[0]))
        now_origin, now_rotation = self.joint_frame(parent, state)
        turn = now_rotation @ rest_rotation.T
        return now_origin + turn @ (origin - rest_origin), turn @ rotation

    def zone_frame(self, zone: Zone, state: State) -> tuple[Array, Array]:
        """Origin (3,) and rotation (3, 3) of the frame a zone follows."""
        if zone.frame >= 0:
            return state.frame_positions[zone.frame], state.frame_rotations[zone.frame]
        return self.joint_frame(zone.joint, state)

    def place_zones(self, state: State) -> None:
        """Move the nodes of all zones, and their velocities, to where frames and joints say."""
        screws = self.screws(state)
        for zone in self.zones:
            origin, rotation = self.zone_frame(zone, state)
            points = origin + zone.local @ rotation.T
            state.positions[zone.nodes] = points
            state.velocities[zone.nodes] = sum(
                (
                    (np.cross(screws.angular[k], points - screws.origin[k]) + screws.linear[k])
                    * state.border_velocities[k]
                    for k in zone.border
                ),
                np.zeros_like(points),
            )

    def screws(self, state: State) -> Screws:
        """The screw of every border unknown at a state."""
        size, frames = self.border_size, len(self.frame_names)
        angular, linear, origin = np.zeros((size, 3)), np.zeros((size, 3)), np.zeros((size, 3))
        for f in range(frames):
            linear[6 * f : 6 * f + 3] = np.eye(3)
            angular[6 * f + 3 : 6 * f + 6] = np.eye(3)
            origin[6 * f : 6 * f + 6] = state.frame_positions[f]
        for j, joint in enumerate(self.joints):
            k = 6 * frames + j
            if joint.cable:
                continue
            origin[k], rotation = self.base_frame(j, state)
            (angular if joint.revolute else linear)[k] = rotation @ joint.axis
        return Screws(angular, linear, origin)

    def advance_border(self, state: State, velocities: Array) -> None:
        """Move frames and joints for one step at the border velocities (exact exponential for rotations)."""
        state.border_velocities[:] = velocities
        for f in range(len(self.frame_names)):
            state.frame_positions[f] += self.dt * velocities[6 * f : 6 * f + 3]
            turn = rotation_exp(self.dt * velocities[6 * f + 3 : 6 * f + 6])
            state.frame_rotations[f] = turn @ state.frame_rotations[f]
        state.joint_positions += self.dt * velocities[6 * len(self.frame_names) :]


@dataclass(frozen=True, slots=True, eq=False)
class Screws:
    """Screws of the border unknowns: angular (b, 3), linear (b, 3), origin (b, 3) in [m]; see the module."""

    angular: Array
    linear: Array
    origin: Array

    def jacobian(self, k: int, points: Array) -> Array:
        """Velocity of `points` (p, 3) a unit velocity of border unknown k, shape (p, 3)."""
        return np.asarray((points - self.origin[k]) @ cross_matrix(self.angular[k]).T + self.linear[k])
