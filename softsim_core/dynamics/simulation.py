"""A running scene: step, command, snapshot, and everything one can look at."""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Sequence
from functools import cache
from time import perf_counter

import numpy as np
from scipy.sparse import csr_array

from softsim_core.actuation.cable import Cables, CableView, no_cables
from softsim_core.actuation.limits import check_command
from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.surfaces import CollisionSurface
from softsim_core.dynamics.bases import MovableBases
from softsim_core.dynamics.contact_step import NOTHING, ContactReport, ContactStepper
from softsim_core.dynamics.drive import JointDrive
from softsim_core.dynamics.scipy_step import ScipyStepper
from softsim_core.dynamics.statics import StaticSolution, solve_static
from softsim_core.dynamics.stepper import Inputs, Stepper
from softsim_core.errors import SceneError, SolverDivergedError, listing
from softsim_core.fem.material import LinearMaterial
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.pose import Pose, quaternion_of
from softsim_core.mechanics.state import MEMORY, pack, unpack
from softsim_core.mesh.follower import SurfaceFollower
from softsim_core.scene.builder import build
from softsim_core.scene.contact_builder import contacts
from softsim_core.scene.description import Backend, SceneDescription

RUNAWAY_SPEED = 1.0e4
"""A node faster than this, in [m/s], has run away."""


class Simulation:
    """A scene that runs in fixed steps. The same commands at the same steps give the same bytes.

    Args:
        scene: What to simulate.
        backend: "numba", "scipy" or "auto"; None takes the scene's.

    Raises:
        SceneError, MeshError, MaterialError: the scene cannot be built.
    """

    def __init__(self, scene: SceneDescription, backend: Backend | None = None) -> None:
        self.scene = scene
        built = build(scene)
        self.model, self.parameters, self.bodies = built.model, built.parameters, built.bodies
        self.rigid_bodies, self._cables = built.rigid, built.cables
        self._stepper = make_stepper(self.model, backend or scene.solver.backend, self._cables)
        self._contacts = contacts(scene, self.model, self.bodies, self.rigid_bodies)
        if self._contacts is not None or self.model.rigid.names:
            self._stepper = ContactStepper(self._stepper, self._contacts)
        self._state = self.model.rest_state()
        self._last_good = self.model.rest_state()
        self._drive = JointDrive(scene)
        self._bases = MovableBases(self.model.joints)
        self.forces = np.zeros_like(self.model.rest)
        self._steps = 0
        self._step_time = self._controllers_time = 0.0
        self._header = hashlib.sha256(repr(self._fingerprint()).encode()).digest()
        self._surface = SurfaceFollower(
            [(body.surface, body.embedding, body.nodes.start) for body in self.bodies], len(self.model.rest)
        )
        self._mean_at_nodes = mean_at_nodes(self.model.elements.nodes, len(self.model.rest))

    # --- time ---

    @property
    def dt(self) -> float:
        """Time step in [s]."""
        return self.model.dt

    @property
    def step_count(self) -> int:
        """Steps since the start."""
        return self._steps

    @property
    def time(self) -> float:
        """Simulated time in [s]."""
        return self.step_count * self.dt

    @property
    def backend(self) -> str:
        """Implementation of the step: "numba" or "scipy"."""
        return self._stepper.name

    @property
    def stage_times(self) -> dict[str, float]:
        """Time of each stage of the last step in [ms], and of the whole step; see dynamics.stages."""
        times = {**self._stepper.stage_times, "step": self._step_time}
        return {"controllers": self._controllers_time, **times} if self.scene.controllers else times

    def step(self) -> None:
        """Advance by one dt.

        Raises:
            SolverDivergedError: the step gave a non-finite or runaway state; the state stays the last good
            one.
        """
        started = perf_counter()
        for controller in self.scene.controllers:
            if controller.on_begin is not None:
                controller.on_begin(self)
        begun = perf_counter()
        self._drive.advance(self.time, self.dt)
        self._last_good.copy_from(self._state)
        inputs = Inputs(self._drive.positions, self.forces, self._drive.base_shift)
        try:
            speed = self._stepper.step(self._state, inputs, self.parameters)
        except (RuntimeError, np.linalg.LinAlgError):  # SciPy's words for a matrix or strain beyond numbers
            speed = math.nan
        if not speed < RUNAWAY_SPEED:  # also catches NaN
            self._refuse_step()
        if self._bases.advance(self.dt):
            self.model.place_zones(self._state)
        self._steps += 1
        stepped = perf_counter()
        for controller in self.scene.controllers:
            if controller.on_end is not None:
                controller.on_end(self)
        ended = perf_counter()
        self._controllers_time = 1e3 * (begun - started + ended - stepped)
        self._step_time = 1e3 * (ended - started)

    def _refuse_step(self) -> None:
        """Go back to the last good state and say where it went wrong."""
        speed = np.nan_to_num(np.abs(self._state.velocities), nan=np.inf).max(axis=1, initial=0.0)
        worst = int(np.argmax(speed)) if len(speed) else 0
        self._state.copy_from(self._last_good)
        self._drive.positions = self._state.joint_positions.copy()
        raise SolverDivergedError(self.step_count + 1, self.time + self.dt, worst)

    # --- commands ---

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        return self.scene.joint_names

    @property
    def joint_positions(self) -> Array:
        """Measured joint positions in [rad] or [m], shape (j,)."""
        return self._state.joint_positions.copy()

    @property
    def joint_velocities(self) -> Array:
        """Joint velocities in [rad/s] or [m/s], shape (j,)."""
        return self._state.border_velocities[6 * len(self.model.frame_names) :].copy()

    @property
    def joint_efforts(self) -> Array:
        """Torque in [N m] or force in [N] that each drive applied in the last step, shape (j,)."""
        return self._state.joint_efforts.copy()

    @property
    def joint_targets(self) -> Array:
        """The last accepted command, after clamping, in [rad] or [m], shape (j,)."""
        return self._drive.targets.copy()

    @property
    def enforce_limits(self) -> bool:
        """Whether joint limits (position and speed) hold; False allows full turns."""
        return self._drive.enforce_limits

    @enforce_limits.setter
    def enforce_limits(self, enforce: bool) -> None:
        self._drive.enforce_limits = enforce

    def command(self, values: Sequence[float] | Array) -> Array:
        """Set where the joints go; a running start animation ends.

        Args:
            values: One position a joint in [rad] or [m], in joint order.

        Returns:
            The accepted command, clamped to the limits where they are enforced.

        Raises:
            CommandError: wrong length, not finite, or out of range in a scene that refuses; nothing is
            changed.
        """
        self._drive.command(list(values))
        return self.joint_targets

    @property
    def base_shift(self) -> float:
        """Shift in [m] of all joint bases along their slide axes."""
        return float(self._state.base_shift[0])

    @base_shift.setter
    def base_shift(self, shift: float) -> None:
        self._drive.shift_bases(shift)

    def move_base(self, joint: str, position: Sequence[float] | Array) -> None:
        """Have the base of a joint go to a position (3,) in [m], as `frames` tells it while its parent rests.

        It goes there at a hand's pace, see bases.SPEED, and what is attached to the joint goes along; `reset`
        takes it back. What `base_shift` changes later comes on top.

        Raises:
            CommandError: no such joint, a cable's, or not finite; nothing is changed.
        """
        self._bases.move(joint, position, self.base_shift)

    def start_animation(self) -> None:
        """Begin the robot's start animation with the next step, from the rest pose, whatever the pose is now.

        Raises:
            SceneError: the scene has none.
        """
        self._drive.start(self.time)

    def press_key(self, key: str) -> None:
        """Hand a key to the scene's own controllers."""
        for controller in self.scene.controllers:
            if controller.on_key is not None:
                controller.on_key(self, key)

    # --- parameters ---

    def set_material(
        self, body: str, young_modulus: float | None = None, poisson_ratio: float | None = None
    ) -> None:
        """Change a body's material from the next step on: Young modulus in [Pa], Poisson ratio in [-].

        Raises:
            SceneError: no such body.
            MaterialError: a value out of range; nothing is changed.
        """
        names = [each.name for each in self.bodies]
        if body not in names:
            raise SceneError(f"unknown body {body!r}; known bodies: {listing(names)}")
        material = self.material(body)
        changed = LinearMaterial(
            material.young_modulus if young_modulus is None else young_modulus,
            material.poisson_ratio if poisson_ratio is None else poisson_ratio,
        )
        self.parameters.lame[names.index(body)] = changed.lame

    def material(self, body: str) -> LinearMaterial:
        """The material a body has now."""
        lam, mu = self.parameters.lame[[each.name for each in self.bodies].index(body)].tolist()
        return LinearMaterial(mu * (3.0 * lam + 2.0 * mu) / (lam + mu), lam / (2.0 * (lam + mu)))

    def set_damping(
        self, rayleigh_stiffness: float | None = None, rayleigh_mass: float | None = None
    ) -> None:
        """Change the damping per stiffness in [s] or per mass in [1/s] from the next step on.

        Raises:
            SceneError: negative or not finite; nothing is changed.
        """
        for name, value in (("rayleigh_stiffness", rayleigh_stiffness), ("rayleigh_mass", rayleigh_mass)):
            if value is not None and not 0.0 <= value < math.inf:
                raise SceneError(f"{name} must be >= 0, not {value}")
        if rayleigh_stiffness is not None:
            self.parameters.rayleigh_stiffness = float(rayleigh_stiffness)
        if rayleigh_mass is not None:
            self.parameters.rayleigh_mass = float(rayleigh_mass)

    # --- state ---

    def snapshot(self) -> bytes:
        """Everything needed to go on from here: state, commands, tuned parameters."""
        return pack(self._header, self._saved())

    def restore(self, data: bytes) -> None:
        """Go back to a snapshot; what follows is the same bytes as it was then.

        Raises:
            SnapshotError: not a snapshot of this scene; nothing is changed.
        """
        shapes: list[tuple[int, ...]] = [array.shape for array in self._saved()]
        *saved, memory = unpack(data, self._header, [*shapes[:-1], (-1, MEMORY)])
        state, forces, lame, numbers, bases, *drive = saved
        self._state.memory = memory
        self._state.buffer[:] = state
        self.forces[:] = forces
        self.parameters.lame = lame
        self.parameters.rayleigh_stiffness, self.parameters.rayleigh_mass = numbers[1:].tolist()
        self._steps = int(numbers[0])
        self._bases.restore(bases)
        self._drive.restore(*drive)
        self._forget_contacts()

    def reset(self) -> None:
        """Back to the start of the scene, with the parameters as they are tuned now."""
        self._bases.reset()
        self._state.copy_from(self.model.rest_state())
        self._drive.reset()
        self._steps = 0
        self.forces[:] = 0.0
        self._forget_contacts()

    def _forget_contacts(self) -> None:
        """What touched before a jump of the state is no news any more."""
        if isinstance(self._stepper, ContactStepper):
            self._stepper.report = NOTHING

    def equilibrium(
        self, joints: Sequence[float] | Array, base_shift: float | None = None, *, tolerance: float = 1e-11
    ) -> StaticSolution:
        """The static equilibrium that is reached from the present state; nothing is changed.

        Args:
            joints: Where the joints are commanded to be, in [rad] or [m], limits or not.
            base_shift: Shift in [m] of all joint bases; None: the present one.
            tolerance: See solve_static, in [m].

        Raises:
            CommandError: wrong length or not finite.
            NotConvergedError: no equilibrium was found.
        """
        targets = np.array(check_command(list(joints), self.joint_names))
        inputs = Inputs(targets, self.forces, self.base_shift if base_shift is None else float(base_shift))
        return solve_static(
            self.model, self._state, inputs, self.parameters, cables=self._cables, tolerance=tolerance
        )

    def settle(
        self, joints: Sequence[float] | Array, base_shift: float | None = None, *, tolerance: float = 1e-11
    ) -> StaticSolution:
        """Go to the static equilibrium that `equilibrium` finds, at rest; time stands still.

        Raises:
            CommandError, NotConvergedError: as `equilibrium`; nothing is changed.
        """
        solution = self.equilibrium(joints, base_shift, tolerance=tolerance)
        self._state.copy_from(solution.state)
        self._drive.place(np.array(joints, dtype=float), self.base_shift)
        return solution

    def _saved(self) -> list[Array]:
        """Everything a snapshot holds, in order."""
        parameters = self.parameters
        numbers = np.array([self._steps, parameters.rayleigh_stiffness, parameters.rayleigh_mass])
        return [
            self._state.buffer,
            self.forces,
            parameters.lame,
            numbers,
            self._bases.state(),
            *self._drive.state(),
            self._state.memory,
        ]

    def _fingerprint(self) -> tuple[object, ...]:
        model = self.model
        arrays = (model.rest, model.elements.nodes, model.zone_of_node, model.gravity)
        return (self.scene.name, self.joint_names, model.dt, model.law, [array.tobytes() for array in arrays])

    # --- what one can look at ---

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
        """Tetrahedra of all bodies, shape (m, 4)."""
        return self.model.elements.nodes

    @property
    def surface_triangles(self) -> IndexArray:
        """Boundary triangles of all bodies, as indices into `positions`, shape (k, 3)."""
        return np.concatenate([np.zeros((0, 3), np.int64)] + [body.boundary for body in self.bodies])

    def visual_points(self) -> Array:
        """Vertices of the visual surfaces of all bodies now, in [m], shape (p, 3)."""
        return self._surface.follow(self._state.positions)

    def visual_values(self, node_values: Array) -> Array:
        """Nodal values (n,) carried over to the vertices of the visual surfaces, shape (p,)."""
        return self._surface.follow(node_values)

    @property
    def visual_triangles(self) -> IndexArray:
        """Triangles of the visual surfaces of all bodies, as indices into `visual_points`, shape (q, 3)."""
        return self._surface.triangles

    @property
    def visual_rest_points(self) -> Array:
        """Vertices of the visual surfaces at rest, in [m], shape (p, 3)."""
        return self._surface.rest_points

    def border_stiffness(self) -> Array:
        """Static stiffness of frames and joints at the present state, shape (b, b).

        Free frames come first (velocity, then spin: six each), then joints; see Stepper.border_stiffness.
        """
        return self._stepper.border_stiffness(self._state, self.parameters, self.forces)

    def von_mises(self) -> Array:
        """Von Mises stress at the nodes in [Pa], the mean over the elements around each, shape (n,)."""
        return np.asarray(self._mean_at_nodes @ self._stepper.von_mises(self._state, self.parameters))

    def frames(self) -> dict[str, Pose]:
        """Poses of the free frames, of each joint's base (its name) and of its horn (`NAME_horn`)."""
        state, poses = self._state, {}
        for f, name in enumerate(self.model.frame_names):
            poses[name] = Pose(state.frame_positions[f].copy(), quaternion_of(state.frame_rotations[f]))
        for j, joint in enumerate(self.model.joints):
            if joint.cable:
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
    def cables(self) -> tuple[CableView, ...]:
        """What one can see of each cable, in joint order."""
        if self._cables is None:
            return ()
        return self._cables.views(self.model, self._state)

    @property
    def contacts(self) -> ContactReport:
        """What touched in the last step."""
        if isinstance(self._stepper, ContactStepper):
            return self._stepper.report
        return NOTHING

    @property
    def collision_surfaces(self) -> tuple[CollisionSurface, ...]:
        """Collision surfaces over `collision_points`."""
        return () if self._contacts is None else self._contacts.surfaces

    @property
    def collision_points(self) -> Array:
        """Where the vertices of the collision surfaces are, in [m], shape (v, 3)."""
        return np.zeros((0, 3)) if self._contacts is None else self._contacts.points(self.model, self._state)

    @property
    def effector_pose(self) -> Pose | None:
        """Pose of the end effector, or None in a scene without one."""
        if self.scene.effector is None:
            return None
        f = self.model.frame_names.index(self.scene.effector)
        return Pose(self._state.frame_positions[f].copy(), quaternion_of(self._state.frame_rotations[f]))


def mean_at_nodes(elements: IndexArray, count: int) -> csr_array:
    """Matrix (n, m) from values of m elements to the mean of those around each of `count` nodes; 0 at others.

    Args:
        elements: Node indices, shape (m, a).
        count: Number of nodes n.
    """
    nodes = elements.ravel()
    around = np.bincount(nodes, minlength=count)
    element = np.repeat(np.arange(len(elements)), elements.shape[1])
    return csr_array((1.0 / around[nodes], (nodes, element)), shape=(count, len(elements)))


def make_stepper(model: Model, backend: Backend, cables: Cables | None = None) -> Stepper:
    """The step implementation: "scipy", "numba", or "auto" (numba; without it scipy, and a warning once)."""
    cables = cables if cables is not None else no_cables()
    if backend != "scipy":
        try:
            from softsim_core.dynamics.fast.stepper import NumbaStepper

            return NumbaStepper(model, cables)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] not in ("numba", "llvmlite"):
                raise
            if backend == "numba":
                raise SceneError(
                    "backend numba needs the package numba: pip install numba, or use scipy"
                ) from error
            _say_that_numba_is_missing()
    return ScipyStepper(model, cables)


@cache  # once a process; Python's own once-a-place filter starts anew whenever a reader catches warnings
def _say_that_numba_is_missing() -> None:
    warnings.warn(
        "numba is not installed: the slower NumPy + SciPy step runs; pip install numba", stacklevel=4
    )
