"""The mechanical model: a scene compiled to arrays, and its generalised coordinates.

Nodes are free (three unknowns each) or belong to a rigid region that is fixed, moves with a joint, or is a
free rigid frame. The degrees of freedom of frames and joints are the *reduced coordinates*: few, compared
with the sparse interior. Each has a motion subspace: per unit of its velocity, a point x of the body moves at
`angular x (x - origin) + linear`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.fem import ElementGroup, MassCoupling
from softsim_core.physics.fem.elements import Element
from softsim_core.physics.fem.materials import Material
from softsim_core.physics.mechanics.limits import JointLimits
from softsim_core.physics.mechanics.pose import cross, cross_matrix, rotation_exp
from softsim_core.physics.mechanics.rigid import RigidBodies
from softsim_core.physics.mechanics.state import State

FREE, FIXED = -1, -2
"""Region numbers of free nodes and of fixed nodes."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A compiled joint: base frame, axis and law; see JointDescription for units.

    `base_position` is the base's position at the start; the current one, in [m], is in State.base_positions.
    `parent` is the index of the joint that carries the base, or -1. The joint of an actuator moves no frame:
    its position is the actuator's coordinate.
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
    moves_frame: bool = True

    def frame(self, position: float, base: Array, base_shift: float) -> tuple[Array, Array]:
        """Return the origin (3,) and rotation (3, 3) of the frame that the joint moves.

        `base`: see `base_origin`.
        """
        origin = self.base_origin(base, base_shift)
        if self.revolute:
            return origin, self.base_rotation @ rotation_exp(position * self.axis)
        return origin + self.base_rotation @ (position * self.axis), self.base_rotation

    def base_origin(self, base: Array, base_shift: float) -> Array:
        """Return the origin (3,) in [m] of a base, shifted along the slide axis.

        `base` (3,) is its origin without the shift, `base_shift` the shift in [m].
        """
        return base + base_shift * (self.base_rotation @ self.slide_axis)


@dataclass(frozen=True, slots=True, eq=False)
class RigidRegion:
    """A rigid region: nodes that follow a frame.

    Attributes:
        name: Name of the attachment.
        frame: Index of the free frame, or -1 when a joint moves the region.
        joint: Index of the joint, or -1 when the region is a free frame.
        nodes: Node indices, shape (k,).
        local: Node positions in the frame in [m], shape (k, 3).
        reduced: Indices of the reduced coordinates that move it: the six of a frame, or those of the joints
            that carry it, its own joint last.
    """

    name: str
    frame: int
    joint: int
    nodes: IndexArray
    local: Array
    reduced: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A scene compiled to arrays (immutable; State has what changes in time, Parameters what a user tunes).

    Attributes:
        rest: Rest positions in [m], shape (n, 3).
        groups: The cells of all bodies, one group for each pair of element and material law, then those of
            layers and fibres.
        mass: Lumped node masses in [kg], shape (n,).
        coupling: Consistent mass beyond the lumped masses; None: all mass is lumped.
        spring: Stiffness in [N/m] that pulls a node to its rest position (soft fixings), shape (n,).
        gravity: Gravity in [m/s^2], shape (3,).
        dt: Time step in [s].
        region_of_node: RigidRegion of each node, or FREE, or FIXED, shape (n,).
        regions: Rigid regions that move.
        frame_names: Names of the free frames; frame f owns the reduced coordinates 6 f .. 6 f + 5 (velocity,
            then spin).
        frame_rest: Rest origins in [m] (f, 3) and rotations (f, 3, 3) of the free frames.
        joints: Joints; joint j owns the reduced coordinate 6 len(frame_names) + j.
        rigid: Rigid bodies with mass, which interact with the rest through contacts only.
        extra_state: Shapes of the arrays in State.extra, by name.
    """

    rest: Array
    groups: tuple[ElementGroup, ...]
    mass: Array
    spring: Array
    gravity: Array
    dt: float
    region_of_node: IndexArray
    regions: tuple[RigidRegion, ...]
    frame_names: tuple[str, ...]
    frame_rest: tuple[Array, Array]
    joints: tuple[Joint, ...]
    rigid: RigidBodies
    extra_state: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    coupling: MassCoupling | None = None

    def momentum(self, velocities: Array) -> Array:
        """Return M v in [kg m/s], shape (n, 3), at velocities (n, 3) of the nodes."""
        result = self.mass[:, None] * velocities
        return result if self.coupling is None else np.asarray(result + self.coupling.matrix @ velocities)

    @property
    def weight(self) -> Array:
        """Return the weight of the nodes in [N], shape (n, 3)."""
        if self.coupling is None:
            return np.asarray(self.mass[:, None] * self.gravity)
        return self.momentum(np.tile(self.gravity, (len(self.mass), 1)))

    def with_inertia(self, factor: float, dt: float) -> Model:
        """Return the model with its inertia scaled, with the same weight, for steps of `dt` [s]."""
        return replace(
            self,
            dt=dt,
            mass=factor * self.mass,
            gravity=self.gravity / factor,
            joints=tuple(replace(each, inertia=factor * each.inertia) for each in self.joints),
            coupling=None if self.coupling is None else self.coupling.scale(factor),
        )

    @property
    def reduced_size(self) -> int:
        """Number of reduced coordinates: six per free frame, one per joint."""
        return 6 * len(self.frame_names) + len(self.joints)

    @property
    def free_nodes(self) -> IndexArray:
        """Indices of the free nodes, ascending."""
        return np.flatnonzero(self.region_of_node == FREE)

    @property
    def compliant_joints(self) -> IndexArray:
        """Indices of the joints that a spring pulls to their command."""
        return np.array(
            [j for j, joint in enumerate(self.joints) if joint.stiffness is not None], dtype=np.int64
        )

    @property
    def filling(self) -> tuple[ElementGroup, ...]:
        """The cells that fill bodies, without layers and fibres."""
        return tuple(group for group in self.groups if group.fills)

    def law(self, parameter_set: int) -> Material:
        """Return the material law of a body, or of a layer or fibres; see Parameters.materials."""
        return self._group(parameter_set).material

    def element(self, body: int) -> Element:
        """Return the element of the cells of a body."""
        return self._group(body).element

    def _group(self, parameter_set: int) -> ElementGroup:
        return next(group for group in self.groups if (group.parameter_set == parameter_set).any())

    def rest_state(self) -> State:
        """Return the state as built: everything at rest, joints at their rest positions."""
        state = self.empty_state()
        state.positions[:] = self.rest
        state.frame_positions[:], state.frame_rotations[:] = self.frame_rest
        state.joint_positions[:] = [joint.rest for joint in self.joints]
        state.base_positions[:] = np.array([joint.base_position for joint in self.joints]).reshape(-1, 3)
        state.rigid_positions[:] = self.rigid.rest_positions
        state.rigid_rotations[:] = self.rigid.rest_rotations
        state.rigid_velocities[:] = self.rigid.rest_velocities
        self.place_regions(state)
        return state

    def empty_state(self, buffer: Array | None = None) -> State:
        """Return a state of the right shape, all zeros or in a given buffer.

        The state uses the `buffer` (s,) with its contents.
        """
        frames, rigid = len(self.frame_names), len(self.rigid.names)
        return State(len(self.rest), frames, len(self.joints), rigid, self.extra_state, buffer)

    def chain(self, joint: int) -> list[int]:
        """Return the joints that carry a joint, the outermost first, then the joint itself."""
        carriers = [joint]
        while self.joints[carriers[0]].parent >= 0:
            carriers.insert(0, self.joints[carriers[0]].parent)
        return carriers

    def joint_frame(self, j: int, state: State) -> tuple[Array, Array]:
        """Return the origin (3,) and rotation (3, 3) of the frame that joint j moves."""
        position, shift = float(state.joint_positions[j]), float(state.base_shift[0])
        return self._move_with_parent(
            j, state, *self.joints[j].frame(position, state.base_positions[j], shift)
        )

    def base_frame(self, j: int, state: State) -> tuple[Array, Array]:
        """Return the origin (3,) and rotation (3, 3) of the base of joint j."""
        joint, shift = self.joints[j], float(state.base_shift[0])
        return self._move_with_parent(
            j, state, joint.base_origin(state.base_positions[j], shift), joint.base_rotation
        )

    def _move_with_parent(self, j: int, state: State, origin: Array, rotation: Array) -> tuple[Array, Array]:
        """Return the current pose of a frame that joint j's parent carries.

        The frame is at `origin` (3,), `rotation` (3, 3) while the parent is at rest.
        """
        parent = self.joints[j].parent
        if parent < 0:
            return origin, rotation
        joint = self.joints[parent]
        base, shift = state.base_positions[parent], float(state.base_shift[0])
        rest_origin, rest_rotation = joint.frame(joint.rest, base, shift)
        now_origin, now_rotation = self.joint_frame(parent, state)
        turn = now_rotation @ rest_rotation.T
        return now_origin + turn @ (origin - rest_origin), turn @ rotation

    def region_frame(self, region: RigidRegion, state: State) -> tuple[Array, Array]:
        """Return the origin (3,) and rotation (3, 3) of the frame that a region follows."""
        if region.frame >= 0:
            return state.frame_positions[region.frame], state.frame_rotations[region.frame]
        return self.joint_frame(region.joint, state)

    def place_regions(self, state: State) -> None:
        """Set positions and velocities of the nodes of all regions from frames and joints."""
        moving = bool(state.reduced_velocities.any())
        motion_subspace = self.motion_subspace(state) if moving else None
        for region in self.regions:
            origin, rotation = self.region_frame(region, state)
            points = origin + region.local @ rotation.T
            state.positions[region.nodes] = points
            state.velocities[region.nodes] = 0.0
            if motion_subspace is not None:
                for k in region.reduced.tolist():
                    motion = motion_subspace.jacobian(k, points)
                    state.velocities[region.nodes] += motion * state.reduced_velocities[k]

    def motion_subspace(self, state: State) -> MotionSubspace:
        """Return the motion subspaces of all reduced coordinates at a state."""
        size, frames = self.reduced_size, len(self.frame_names)
        angular, linear, origin = np.zeros((size, 3)), np.zeros((size, 3)), np.zeros((size, 3))
        for f in range(frames):
            linear[6 * f : 6 * f + 3] = np.eye(3)
            angular[6 * f + 3 : 6 * f + 6] = np.eye(3)
            origin[6 * f : 6 * f + 6] = state.frame_positions[f]
        for j, joint in enumerate(self.joints):
            k = 6 * frames + j
            if not joint.moves_frame:
                continue
            origin[k], rotation = self.base_frame(j, state)
            (angular if joint.revolute else linear)[k] = rotation @ joint.axis
        return MotionSubspace(angular, linear, origin)

    def displace(self, state: State, nodes: Array, reduced: Array) -> None:
        """Move everything at once: free nodes by `nodes` (k, 3) in [m], frames and joints by `reduced` (b,).

        Rotations use the exponential map; the nodes of regions follow. Velocities stay.
        """
        frames = len(self.frame_names)
        state.positions[self.free_nodes] += nodes
        for f in range(frames):
            state.frame_positions[f] += reduced[6 * f : 6 * f + 3]
            turn = rotation_exp(reduced[6 * f + 3 : 6 * f + 6])
            state.frame_rotations[f] = turn @ state.frame_rotations[f]
        state.joint_positions += reduced[6 * frames :]
        self.place_regions(state)

    def advance_reduced(self, state: State, velocities: Array) -> None:
        """Move frames and joints for one step at the reduced velocities (exact exponential for rotations)."""
        state.reduced_velocities[:] = velocities
        for f in range(len(self.frame_names)):
            state.frame_positions[f] += self.dt * velocities[6 * f : 6 * f + 3]
            turn = rotation_exp(self.dt * velocities[6 * f + 3 : 6 * f + 6])
            state.frame_rotations[f] = turn @ state.frame_rotations[f]
        state.joint_positions += self.dt * velocities[6 * len(self.frame_names) :]


@dataclass(frozen=True, slots=True, eq=False)
class MotionSubspace:
    """Motion subspaces of the reduced coordinates: angular, linear, origin in [m], (b, 3) each.

    See the module.
    """

    angular: Array
    linear: Array
    origin: Array

    def jacobians(self, chosen: IndexArray, points: Array) -> Array:
        """Return velocities of `points` (p, 3) per unit velocity of k coordinates, shape (p, k, 3)."""
        levers = points[:, None] - self.origin[chosen]
        turned = np.swapaxes([cross_matrix(each) for each in self.angular[chosen]], 1, 2)
        return np.asarray(np.einsum("pki,kij->pkj", levers, turned) + self.linear[chosen])

    def work(self, chosen: IndexArray, points: Array, forces: Array) -> Array:
        """Return the work of `forces` (p, 3) on `points` (p, 3) per unit motion of k coordinates, (k,)."""
        force, moment = forces.sum(axis=0), cross(points, forces).sum(axis=0)
        moments = moment - cross(self.origin[chosen], force)
        return np.asarray(self.linear[chosen] @ force + np.einsum("ki,ki->k", self.angular[chosen], moments))

    def jacobian(self, k: int, points: Array) -> Array:
        """Return velocities of `points` (p, 3) per unit velocity of reduced coordinate k, shape (p, 3)."""
        return np.asarray((points - self.origin[k]) @ cross_matrix(self.angular[k]).T + self.linear[k])
