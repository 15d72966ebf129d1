"""State of a built scene: read access to everything, without any change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from softsim_core.base import Array, Backend, IndexArray, SceneError, float_array
from softsim_core.physics.actuation import ActuatorView
from softsim_core.physics.contact import CollisionModel, CollisionSurface, ContactLimits
from softsim_core.physics.dynamics import (
    Condensed,
    ContactReport,
    StaticResponse,
    Stepper,
    StepReport,
    StepSettings,
    TimeStep,
    command_gains,
    condense_tangent,
    make_stepper,
    reduced_stiffness,
    response_of,
)
from softsim_core.physics.fem import stress_at_nodes
from softsim_core.physics.fem.materials import von_mises
from softsim_core.physics.mechanics import COMMANDED, Model, Pose, Rows, State, quaternion_of
from softsim_core.physics.mesh import SurfaceFollower
from softsim_core.physics.sensing import Sensors, StepObservation
from softsim_core.scene import SceneDescription
from softsim_core.scene.building import BuiltScene, build, contacts, sensors
from softsim_core.simulation.drive import check_values, set_body_motion


class SceneState:
    """A scene, the objects built from it, and their state.

    Args:
        scene: The scene to build; it starts at rest.
        backend: "numba", "scipy" or "auto"; None takes the scene's.
        like: Another instance of the same scene, or of one that differs in numbers only. Its built objects,
            plans and workspace are shared, so only one of the two may be in a call at a time; their states
            are independent.

    Raises:
        SceneError, MeshError, MaterialError: the scene cannot be built.
    """

    _time_step: TimeStep

    def __init__(
        self, scene: SceneDescription, backend: Backend | None = None, like: SceneState | None = None
    ) -> None:
        self.scene = scene
        twin = like if like is not None and like.scene is scene else None
        shaped = () if like is None else tuple(zip(like.scene.bodies, like._built.bodies, strict=True))
        built: BuiltScene = build(scene, shaped) if twin is None else twin._built
        self._built: BuiltScene = built
        self.model, self.bodies = built.model, built.bodies
        self.parameters = replace(
            built.parameters, materials=[dict(values) for values in built.parameters.materials]
        )
        self.rigid_bodies, self._actuators = built.rigid, built.actuators
        self._contacts: CollisionModel | None = None if twin is None else twin._contacts
        if self._contacts is None:
            self._contacts = contacts(scene, built.contact, self.model, self.bodies, self.rigid_bodies)
        else:
            self._contacts = self._contacts.of_another_copy()
        self._sensors = sensors(scene, built, self._contacts)
        self._time_step = _time_step(
            scene, built, backend, self._contacts, None if like is None else like._time_step
        )
        self._state = self._rest_state()
        self._report = StepReport()
        self._forces = np.zeros_like(self.model.rest)
        self._rigid_forces = np.zeros((len(self.model.rigid.names), 6))
        if twin is None:
            followed = [(body.surface, body.embedding, body.nodes.start) for body in self.bodies]
            self._surface = SurfaceFollower(followed, len(self.model.rest))
            cells = [each + body.nodes.start for body in self.bodies for each in body.blocks.values()]
            self._mean_at_nodes = mean_at_nodes(cells, len(self.model.rest))
        else:
            self._surface, self._mean_at_nodes = twin._surface, twin._mean_at_nodes
        self._with_points = [group for group in self.model.filling if len(group.element.points) > 1]
        self._shown_by_points = np.unique(
            np.concatenate([np.zeros(0, np.int64), *(group.cells.ravel() for group in self._with_points)])
        )

    def step_by(self, other: SceneState) -> None:
        """Use the time step of another simulation of the same scene from the next step on.

        Call it between two steps. State, parameters and ongoing motions are not changed. `other` must not be
        used any more.

        Raises:
            SceneError: the scenes differ.
        """
        if other.scene is not self.scene:
            raise SceneError("the other simulation is of another scene; build it of this one's")
        self.model, self._actuators, self._contacts = other.model, other._actuators, other._contacts
        self._time_step = other._time_step

    def _rest_state(self) -> State:
        """Return the state at which the scene is built: at rest except for the velocities of its bodies."""
        state = self.model.rest_state()
        for body, description in zip(self.bodies, self.scene.bodies, strict=True):
            if any(description.velocity):
                velocity = np.array(description.velocity, dtype=float)
                set_body_motion(self.model, state, body, velocity, np.zeros(3))
        self._actuators.measure(self.model, state)
        if COMMANDED in state.extra:
            state.extra[COMMANDED][:] = state.joint_positions
        return state

    @property
    def _stepper(self) -> Stepper:
        """Linear step, for static tangents and stresses."""
        return self._time_step.stepper

    def store_state_in(self, buffer: Array) -> None:
        """Store the state in a part (s,) of a larger array from now on; see State.buffer."""
        state = self.model.empty_state(buffer)
        state.copy_from(self._state)
        self._state = state

    @property
    def state_parts(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Slice of each array of State in its buffer, and its shape."""
        return self._state.parts()

    @property
    def backend(self) -> str:
        """Implementation of the step: "numba" or "scipy"."""
        return self._stepper.name

    @property
    def compiled(self) -> bool:
        """Whether steps are compiled: moving to a pose with compiled steps is faster than statics."""
        return self._stepper.compiled

    @property
    def remembers_path(self) -> bool:
        """Whether an equilibrium depends on the way to it, as with friction of cables."""
        return self._actuators.passive_size > 0

    @property
    def report(self) -> StepReport:
        """Report of the last step."""
        return self._report

    @property
    def forces(self) -> Array:
        """External forces on the nodes in [N], shape (n, 3): writable in place or by assignment.

        Raises:
            ArrayError: another shape or type is assigned; nothing is changed.
        """
        return self._forces

    @forces.setter
    def forces(self, forces: Array) -> None:
        self._forces[:] = float_array(forces, self._forces.shape, "forces")

    @property
    def sensors(self) -> Sensors:
        """Last measurement of every sensor, by name."""
        return self._sensors

    def _sense(self, steps: int, before: State | None = None) -> None:
        """Measure after `steps` steps: all sensors, or with the state `before` a step only those due."""
        start, drag = self._state if before is None else before, self.parameters.rayleigh_mass
        observation = StepObservation(self.model, start, self._state, self._report, self._forces, drag)
        self._sensors.sample(steps, observation, anew=before is None)

    # --- joints ---

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        return self.scene.joint_names

    @property
    def joint_positions(self) -> Array:
        """Measured joint positions in [rad] or [m], shape (j,); for an actuator its coordinate."""
        return self._state.joint_positions.copy()

    @property
    def joint_velocities(self) -> Array:
        """Joint velocities in [rad/s] or [m/s], shape (j,)."""
        return self._state.reduced_velocities[6 * len(self.model.frame_names) :].copy()

    @property
    def joint_efforts(self) -> Array:
        """Torque in [N m] or force in [N] of each drive in the last step, shape (j,)."""
        return self._state.joint_efforts.copy()

    # --- soft bodies ---

    @property
    def positions(self) -> Array:
        """Node positions of all bodies in [m], shape (n, 3)."""
        return self._state.positions.copy()

    @property
    def velocities(self) -> Array:
        """Node velocities of all bodies in [m/s], shape (n, 3)."""
        return self._state.velocities.copy()

    @property
    def tets(self) -> IndexArray:
        """Tetrahedra of all bodies, for quadratic ones their corners, shape (m, 4)."""
        tets = [body.solid.tets[:, :4] + body.nodes.start for body in self.bodies]
        return np.concatenate([np.zeros((0, 4), np.int64), *tets])

    def visual_points(self) -> Array:
        """Return the present vertices of the visual surfaces of all bodies in [m], shape (p, 3)."""
        return self._surface.follow(self._state.positions)

    def visual_values(self, node_values: Array) -> Array:
        """Interpolate nodal values (n,) to the vertices of the visual surfaces, shape (p,)."""
        return self._surface.follow(node_values)

    @property
    def visual_triangles(self) -> IndexArray:
        """Triangles of the visual surfaces of all bodies, as indices into `visual_points`, shape (q, 3)."""
        return self._surface.triangles

    @property
    def visual_rest_points(self) -> Array:
        """Vertices of the visual surfaces at rest, in [m], shape (p, 3)."""
        return self._surface.rest_points

    def reduced_stiffness(self) -> Array:
        """Return the static stiffness of frames and joints at the present state, shape (b, b).

        Free frames come first (velocity, then spin: six each), then joints; see reduced_stiffness in
        dynamics.actuator_statics.
        """
        return reduced_stiffness(self._stepper, self._state, self.parameters, self.forces)

    def condensed_tangent(self, rows: Rows) -> Condensed:
        """Return `reduced_stiffness` and the response to forces on rows; see Condensed.

        Raises:
            FactorisationError: the free nodes have no stable equilibrium.
        """
        return condense_tangent(self._stepper, self._state, self.parameters, self.forces, rows)

    def static_response(self, rows: Rows) -> StaticResponse:
        """Return the response of the present equilibrium to joint commands and to forces on rows.

        Raises:
            FactorisationError: the free nodes have no stable equilibrium.
            LinAlgError: frames or joints have no equilibrium.
        """
        return response_of(self.model, self.condensed_tangent(rows))

    def region_motion(self) -> list[tuple[IndexArray, Array]]:
        """Return nodes (a,) of each moving rigid region, and their shift per unit of each degree of freedom.

        The degrees of freedom are in the order of `reduced_stiffness`; the shifts have shapes (a, 3, b).
        """
        model, subspace = self.model, self.model.motion_subspace(self._state)
        result = []
        for region in model.regions:
            moved = np.zeros((len(region.nodes), 3, model.reduced_size))
            for k in region.reduced.tolist():
                moved[:, :, k] = subspace.jacobian(k, self._state.positions[region.nodes])
            result.append((region.nodes, moved))
        return result

    def stress(self) -> Array:
        """Return the Cauchy stress at the nodes in [Pa], world axes, shape (n, 3, 3).

        It is the mean over the cells around each node; for quadratic cells, the value extrapolated from their
        points.
        """
        return stress_at_nodes(self.model.filling, self._state.positions, self.parameters.materials)

    def command_gains(self) -> Array:
        """Return each joint's coordinate per unit of its command, shape (j,); 0 for effort commands.

        For example, a unit of air pumped into a line under pressure changes the cavity by less than a unit.
        """
        return command_gains(self._stepper, self._state)

    def von_mises(self) -> Array:
        """Return the von Mises stress at the nodes in [Pa], shape (n,).

        It is the mean over the elements around each node; for quadratic cells, that of `stress`.
        """
        nodes, result = self._shown_by_points, np.zeros(len(self.model.rest))
        if len(self._with_points) < len(self.model.filling):
            result += self._mean_at_nodes @ self._stepper.von_mises(self._state, self.parameters)
        if len(nodes):
            places, materials = self._state.positions, self.parameters.materials
            result[nodes] = von_mises(stress_at_nodes(self._with_points, places, materials)[nodes])
        return result

    def frames(self) -> dict[str, Pose]:
        """Return poses of the free frames, of each joint's base (its name) and of its horn (`NAME_horn`)."""
        state, poses = self._state, {}
        for f, name in enumerate(self.model.frame_names):
            poses[name] = Pose(state.frame_positions[f].copy(), quaternion_of(state.frame_rotations[f]))
        for j, joint in enumerate(self.model.joints):
            if not joint.moves_frame:
                continue
            base, turn = self.model.base_frame(j, state)
            poses[joint.name] = Pose(base, quaternion_of(turn))
            origin, rotation = self.model.joint_frame(j, state)
            poses[f"{joint.name}_horn"] = Pose(origin, quaternion_of(rotation))
        return poses

    @property
    def rigid_poses(self) -> tuple[Pose, ...]:
        """Poses of all rigid bodies, free and carried, in scene order."""
        state, poses = self._state, []
        for body in self.rigid_bodies:
            if body.free >= 0:
                position, rotation = state.rigid_positions[body.free], state.rigid_rotations[body.free]
                poses.append(Pose(position.copy(), quaternion_of(rotation)))
                continue
            origin, turn = np.zeros(3), np.eye(3)
            if body.on in self.joint_names:
                origin, turn = self.model.joint_frame(self.joint_names.index(body.on), state)
            elif body.on in self.model.frame_names:
                f = self.model.frame_names.index(body.on)
                origin, turn = state.frame_positions[f], state.frame_rotations[f]
            elif body.on != "world":
                j = self.joint_names.index(body.on.removesuffix("_base"))
                origin, turn = self.model.base_frame(j, state)
            poses.append(Pose(origin + turn @ body.position, quaternion_of(turn @ body.rotation)))
        return tuple(poses)

    @property
    def rigid_velocities(self) -> Array:
        """Velocity in [m/s] of the centre of mass and angular velocity in [rad/s] of rigid bodies with mass.

        World axes, in the order of `rigid_names`, shape (r, 6).
        """
        return self._state.rigid_velocities.copy()

    @property
    def rigid_names(self) -> tuple[str, ...]:
        """Names of the rigid bodies with mass: the rows of `rigid_velocities` and `rigid_forces`."""
        return self.model.rigid.names

    @property
    def rigid_forces(self) -> Array:
        """Force in [N] at the centre of mass and moment in [N m] about it on each rigid body with mass.

        World axes, shape (r, 6). The loads act in every step until they are changed, in place or by
        assignment.

        Raises:
            CommandError: on assignment, another shape, or not finite; nothing is changed.
        """
        return self._rigid_forces

    @rigid_forces.setter
    def rigid_forces(self, loads: ArrayLike) -> None:
        self._rigid_forces[:] = check_values("rigid_forces", loads, self._rigid_forces.shape, "N and N m")

    @property
    def actuators(self) -> tuple[ActuatorView, ...]:
        """Views of the actuators of joints without frame, in joint order."""
        return self._actuators.views(self.model, self._state)

    @property
    def contacts(self) -> ContactReport:
        """Contacts of the last step."""
        return self._report.contacts

    @property
    def contact_limits(self) -> ContactLimits:
        """Contact distances and tolerance, defaults included."""
        return self._built.contact

    @property
    def collision_surfaces(self) -> tuple[CollisionSurface, ...]:
        """Collision surfaces over `collision_points`."""
        return () if self._contacts is None else self._contacts.surfaces

    @property
    def collision_points(self) -> Array:
        """Present vertices of the collision surfaces in [m], shape (v, 3)."""
        return np.zeros((0, 3)) if self._contacts is None else self._contacts.points(self._state)

    @property
    def effector_pose(self) -> Pose | None:
        """Pose of the end effector, or None in a scene without one."""
        if self.scene.effector is None:
            return None
        f = self.model.frame_names.index(self.scene.effector)
        return Pose(self._state.frame_positions[f].copy(), quaternion_of(self._state.frame_rotations[f]))


def _time_step(
    scene: SceneDescription,
    built: BuiltScene,
    backend: Backend | None,
    collisions: CollisionModel | None,
    like: TimeStep | None,
) -> TimeStep:
    """Return the time step that a scene asks for."""
    model, solver = built.model, scene.solver
    size = float(np.linalg.norm(np.ptp(model.rest, axis=0))) if len(model.rest) else math.inf
    second_order = solver.time_integration == "bossak"

    def collisions_of(other: Model) -> CollisionModel | None:
        if other is model:
            return collisions
        return contacts(scene, built.contact, other, built.bodies, built.rigid)

    return TimeStep(
        model,
        built.actuators,
        StepSettings(
            solver.iterations,
            solver.last_move(size),
            solver.spectral_radius if second_order else None,
            solver.substeps,
        ),
        partial(
            make_stepper,
            backend=backend or solver.backend,
            actuators=built.actuators,
            solver=solver.linear_solver,
            touching=collisions is not None,
            threads=None if isinstance(solver.threads, str) else solver.threads,
        ),
        collisions_of,
        like,
    )


def mean_at_nodes(elements: Sequence[IndexArray], count: int) -> csr_array:
    """Return a matrix (n, m) that averages values of m elements at `count` nodes; 0 at nodes without element.

    Args:
        elements: Node indices of the elements, body by body, shapes (., a).
        count: Number of nodes n.
    """
    nodes = np.concatenate([np.zeros(0, np.int64), *(cells.ravel() for cells in elements)])
    around = np.bincount(nodes, minlength=count)
    sizes = [cells.shape[1] for cells in elements for _ in range(len(cells))]
    element = np.repeat(np.arange(len(sizes)), sizes)
    return csr_array((1.0 / around[nodes], (nodes, element)), shape=(count, len(sizes)))
