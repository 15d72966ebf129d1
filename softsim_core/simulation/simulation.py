"""A running scene: step, command, tune, snapshot."""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import (
    Array,
    Backend,
    BoolArray,
    DetectionOverflowError,
    FactorisationError,
    MaterialError,
    SceneError,
    SnapshotError,
    SoftSimError,
    SolverDivergedError,
    known_names,
)
from softsim_core.physics.dynamics import (
    Leading,
    StaticSolution,
    let_relax,
    nothing,
    runaway_speed,
    solve_static,
    taut_commands,
)
from softsim_core.physics.fem import locking_warning
from softsim_core.physics.linalg import choose_linear_solver
from softsim_core.physics.mechanics import (
    WARM_START_COLUMNS,
    Control,
    State,
    check_command,
    need_rotations,
    no_warm_start,
    pack,
    unpack,
)
from softsim_core.scene import MaterialDescription, RobotDescription, SceneDescription, as_robot
from softsim_core.scene.building import need_apart
from softsim_core.simulation.drive import (
    JointDrive,
    MovableBases,
    check_values,
    number_of,
    rotation_from,
    set_body_motion,
    set_node_velocities,
)
from softsim_core.simulation.scene_state import SceneState


class Simulation(SceneState):
    """A scene that runs in fixed steps. The same commands at the same steps give the same bytes.

    Args:
        scene: The scene to simulate: a robot with its scene, or a scene alone.
        backend: "numba", "scipy" or "auto"; None takes the scene's.
        like: Another simulation to share with, see SceneState; `copies` of a batch do.

    Attributes:
        scene: The physics.
        robot: Poses, commands, start move and the users' own code.

    Raises:
        SceneError, MeshError, MaterialError: the scene cannot be built.
    """

    def __init__(
        self,
        scene: SceneDescription | RobotDescription,
        backend: Backend | None = None,
        like: Simulation | None = None,
    ) -> None:
        self.robot = as_robot(scene)
        try:
            super().__init__(self.robot.scene, backend, like)
        except SoftSimError:
            raise
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            what = f"scene {self.robot.name!r} cannot be built: {type(error).__name__}: {error}"
            raise SceneError(f"{what}; look for a value that is far too large, or far too small") from error
        self._last_good = self.model.rest_state()
        self._drive = JointDrive(self.robot)
        self._bases = MovableBases(self.model)
        self._steps = 0
        self._step_time = self._controllers_time = self._sensors_time = 0.0
        self._runaway_speed = runaway_speed(self._size(), self.model.dt)
        self._fingerprint = hashlib.sha256(repr(self._identity()).encode()).digest()
        self._sense(0)

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
    def stage_times(self) -> dict[str, float]:
        """Time of each stage of the last step in [ms], and of the whole step; see dynamics.stages."""
        times = {**self._report.times, "step": self._step_time}
        if len(self.sensors):
            times = {"sensors": self._sensors_time, **times}
        return {"controllers": self._controllers_time, **times} if self.robot.controllers else times

    def step(self) -> None:
        """Advance by one dt.

        Raises:
            SolverDivergedError: the step gave a non-finite or runaway state; the state stays the last good
                one.
        """
        started = perf_counter()
        for controller in self.robot.controllers:
            if controller.on_begin is not None:
                controller.on_begin(self)
        begun = perf_counter()
        positions = self._drive.positions
        self._drive.advance(self.time, self.dt)
        self._last_good.copy_from(self._state)
        control = Control(self._drive.positions, self.forces, self._drive.base_shift, self._rigid_forces)
        try:
            report = self._time_step.step(self._state, control, self.parameters)
        except (FactorisationError, DetectionOverflowError) as error:
            raise self._reject_step(positions) from error
        except Exception:  # an error of the scene's code, not of the physics: the state stays as it is
            self._go_back(positions)
            raise
        if not report.top_speed < self._runaway_speed:  # also catches NaN
            raise self._reject_step(positions)
        self._report = report
        if self._bases.advance(self._state, self.dt):
            self._actuators.measure(self.model, self._state)
        self._steps += 1
        moved = perf_counter()
        self._sense(self._steps, self._last_good)
        stepped = perf_counter()
        for controller in self.robot.controllers:
            if controller.on_end is not None:
                controller.on_end(self)
        ended = perf_counter()
        self._controllers_time = 1e3 * (begun - started + ended - stepped)
        self._sensors_time = 1e3 * (stepped - moved)
        self._step_time = 1e3 * (ended - started)

    def _size(self) -> float:
        """Return the present diagonal in [m] of the box around all nodes and collision surfaces."""
        points = np.concatenate([self.model.rest, self.collision_points])
        return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else math.inf

    def _reject_step(self, positions: Array) -> SolverDivergedError:
        """Restore the last good state and setpoints (j,); return an error that locates the failure."""
        speed = np.nan_to_num(np.abs(self._state.velocities), nan=np.inf).max(axis=1, initial=0.0)
        worst = int(np.argmax(speed)) if len(speed) else 0
        self._go_back(positions)
        return SolverDivergedError(self.step_count + 1, self.time + self.dt, worst)

    def _go_back(self, positions: Array) -> None:
        """Return to the last good state; the drive continues from its previous setpoints (j,)."""
        self._state.copy_from(self._last_good)
        self._drive.positions = positions

    # --- commands ---

    @property
    def joint_targets(self) -> Array:
        """The last accepted command, after clamping, in [rad] or [m], shape (j,)."""
        return self._drive.targets.copy()

    def taut_commands(self) -> tuple[Array, BoolArray]:
        """Return commands (j,) for the present state without slack, and which joints can slacken (j,)."""
        return taut_commands(self._stepper, self._state, self.joint_targets)

    @property
    def enforce_limits(self) -> bool:
        """Whether joint limits (position and speed) are enforced; False allows full turns."""
        return self._drive.enforce_limits

    @enforce_limits.setter
    def enforce_limits(self, enforce: bool) -> None:
        self._drive.enforce_limits = enforce

    def command(self, values: Sequence[float] | Array) -> Array:
        """Set the joint targets; a running start animation ends.

        Args:
            values: One position per joint in [rad] or [m], in joint order.

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
        """Move the base of a joint to a position (3,) in [m], as in `frames` with the parent at rest.

        The base moves at `drive.SPEED`, with everything attached to the joint; `reset` moves it back. Later
        changes of `base_shift` are added.

        Raises:
            CommandError: no such joint, one without a frame, or not finite; nothing is changed.
        """
        self._bases.move(joint, position, self.base_shift)

    def start_animation(self) -> None:
        """Start the robot's start animation with the next step, always from the rest pose.

        Raises:
            SceneError: the scene has none.
        """
        self._drive.start(self.time)

    def press_key(self, key: str) -> None:
        """Pass a key to the scene's own controllers."""
        for controller in self.robot.controllers:
            if controller.on_key is not None:
                controller.on_key(self, key)

    def set_velocities(self, velocities: ArrayLike) -> None:
        """Set the velocities of the nodes from now on, such as for a throw.

        Args:
            velocities: In [m/s], shape (n, 3). Those of nodes that are fixed, or follow a free frame or a
                joint, are ignored; `set_body_velocity` also moves free frames.

        Raises:
            CommandError: another shape, or not finite; nothing is changed.
        """
        values = check_values("velocities", velocities, self.model.rest.shape, "m/s")
        set_node_velocities(self.model, self._state, values)

    def set_body_velocity(
        self, body: str, velocity: ArrayLike = (0.0, 0.0, 0.0), angular_velocity: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Set the velocities of a rigid motion on a body.

        Args:
            body: Name of a deformable body, or of a rigid one with mass.
            velocity: Velocity of its centre of mass in [m/s], world axes, shape (3,).
            angular_velocity: In [rad/s], world axes, shape (3,). In a deformable body, nodes that are fixed
                or follow a joint keep their velocities.

        Raises:
            CommandError: no such body, another shape, or not finite; nothing is changed.
        """
        soft = [each.name for each in self.bodies]
        number = number_of("body that moves by itself", body, (*soft, *self.rigid_names))
        linear = check_values("velocity", velocity, (3,), "m/s")
        angular = check_values("angular_velocity", angular_velocity, (3,), "rad/s")
        if number < len(soft):
            set_body_motion(self.model, self._state, self.bodies[number], linear, angular)
        else:
            self._state.rigid_velocities[number - len(soft)] = np.concatenate([linear, angular])

    def place_rigid_body(self, body: str, position: ArrayLike, quaternion_xyzw: ArrayLike) -> None:
        """Move a rigid body with mass to another pose; its velocity is not changed.

        Args:
            body: Its name, one of `rigid_names`.
            position: Position of its centre of mass in [m], in the world, shape (3,).
            quaternion_xyzw: Its orientation, a unit quaternion, shape (4,).

        Raises:
            CommandError: no such body, another shape, not finite, or no unit quaternion; nothing is changed.
        """
        number = number_of("rigid body with mass", body, self.rigid_names)
        place, turn = check_values("position", position, (3,), "m"), rotation_from(quaternion_xyzw)
        self._state.rigid_positions[number], self._state.rigid_rotations[number] = place, turn
        self._forget_contacts()

    def displace(self, nodes: ArrayLike, reduced: ArrayLike) -> None:
        """Displace nodes, frames and joints slightly, such as to a measured position.

        Velocities, commands and forces are not changed.

        Args:
            nodes: Shift of the free nodes in [m], in the order of Model.free_nodes, shape (k, 3).
            reduced: Shift in [m] and rotation vector in [rad] of each free frame, then of each joint, (b,).

        Raises:
            CommandError: another shape, or not finite; nothing is changed.
        """
        model = self.model
        shift = check_values("displacement of the free nodes", nodes, (len(model.free_nodes), 3), "m")
        turned = check_values("displacement of frames and joints", reduced, (model.reduced_size,), "m or rad")
        model.displace(self._state, shift, turned)
        self._actuators.measure(model, self._state)

    # --- parameters ---

    def set_material(self, body: str, **values: float) -> None:
        """Change parameters of a body's material law by name from the next step on; see fem.materials.

        Most laws have `young_modulus` in [Pa] and `poisson_ratio` in [-]. For a layer or fibres, `body` is
        "BODY.LAYER" or "BODY.FIBRES".

        Raises:
            SceneError: no such body, layer or fibres.
            MaterialError: the law has no such parameter, or a value is out of range; nothing is changed.
        """
        b = self._number(body, [name for name, _ in self.scene.materials])
        changed = self.model.law(b).values({**self.parameters.materials[b], **values})
        if warning := locking_warning(self.model.element(b), values):
            warnings.warn(f"body {body}: {warning}", stacklevel=2)
        self.parameters.materials[b] = changed

    def material(self, body: str) -> MaterialDescription:
        """Return the law of a body and the present values of its parameters."""
        b = self._number(body, [each.name for each in self.bodies])
        return self.scene.bodies[b].material.with_values(**self.parameters.materials[b])

    def _number(self, body: str, names: list[str]) -> int:
        """Return the index of a body among names."""
        if body not in names:
            raise SceneError(f"unknown body {body!r}; {known_names(body, names, 'known bodies:')}")
        return names.index(body)

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
        """Return everything needed to continue as named arrays: state, commands, tuned parameters."""
        return pack(self._fingerprint, self._collect_snapshot())

    def restore(self, data: bytes) -> None:
        """Restore a snapshot; the following steps give the same bytes as they did then.

        Raises:
            SnapshotError: not a snapshot of this scene, of another version, or damaged; nothing is changed.
        """
        shapes = {name: array.shape for name, array in self._collect_snapshot().items()}
        shapes["state.warm_start"] = (-1, WARM_START_COLUMNS)
        saved = unpack(data, self._fingerprint, shapes)
        materials, damping, steps = self._check_snapshot(saved)  # before anything is changed
        self._state.take(_part(saved, "state."))
        self._drive.take(_part(saved, "drive."))
        self._bases.restore(saved["bases.targets"])
        self._forces[:] = saved["forces"]
        self._rigid_forces[:] = saved["rigid_forces"]
        self.parameters.materials = materials
        self.parameters.rayleigh_stiffness, self.parameters.rayleigh_mass = damping
        self._steps = steps
        self._forget_contacts()

    def go_on_from(self, other: Simulation) -> None:
        """Continue from the state of another simulation whose scene differs only in rigid bodies with mass.

        Rigid bodies that only this scene has stay at their start.

        Raises:
            SnapshotError: the scenes differ in more.
            SceneError: a body that only this scene has overlaps another one there. Nothing is changed.
        """
        own, saved = self._collect_snapshot(), other._collect_snapshot()
        shared = [name for name in self.rigid_names if name in other.rigid_names]
        here, there = ([each.rigid_names.index(name) for name in shared] for each in (self, other))
        for name in _OF_RIGID_BODIES:
            rows = own[name].copy()
            rows[here] = saved[name][there]
            saved[name] = rows
        saved["state.warm_start"] = no_warm_start()  # its rows use the other's surface numbers
        data = pack(other._fingerprint, saved)
        before = self.snapshot()
        self.restore(data)
        added = [self.scene.body_names.index(name) for name in self.rigid_names if name not in shared]
        try:
            if self._contacts is not None:
                need_apart(self._contacts, self._state, self.scene, "now", added)
        except SceneError:
            self.restore(before)
            raise

    def _check_snapshot(
        self, saved: Mapping[str, Array]
    ) -> tuple[list[dict[str, float]], tuple[float, float], int]:
        """Return materials, damping per stiffness and per mass, and steps of a snapshot.

        Raises:
            SnapshotError: one of them, or a rotation, is invalid.
        """
        for name in ("state.frame_rotations", "state.rigid_rotations"):
            need_rotations(name, saved[name])
        tuned = iter(saved["parameters.materials"].tolist())
        materials = [{name: next(tuned) for name in values} for values in self.parameters.materials]
        stiffness, mass, steps = (
            float(saved[name][0])
            for name in ("parameters.rayleigh_stiffness", "parameters.rayleigh_mass", "steps")
        )
        try:
            materials = [self.model.law(b).values(values) for b, values in enumerate(materials)]
        except MaterialError as error:
            raise SnapshotError(f"the snapshot's {error}; save a new one") from error
        if min(stiffness, mass, steps) < 0.0 or steps != int(steps):
            raise SnapshotError("the snapshot's damping or number of steps cannot be; save a new one")
        return materials, (stiffness, mass), int(steps)

    def reset(self) -> None:
        """Return to the start of the scene, with the present tuned parameters."""
        self._bases.reset()
        self._state.copy_from(self._rest_state())
        self._drive.reset()
        self._steps = 0
        self._forces[:] = 0.0
        self._rigid_forces[:] = 0.0
        self._forget_contacts()

    def _forget_contacts(self) -> None:
        """Clear the contact report after a jump of the state, and let the sensors measure the new state."""
        self._report = replace(self._report, measure=nothing)
        self._sense(self._steps)

    def equilibrium(
        self,
        joints: Sequence[float] | Array = (),
        base_shift: float | None = None,
        *,
        tolerance: float = 1e-11,
        start: State | None = None,
        checked: bool = True,
    ) -> StaticSolution:
        """Return the static equilibrium reached from the present state; nothing is changed.

        Args:
            joints: Joint commands in [rad] or [m]; limits are ignored.
            base_shift: Shift in [m] of all joint bases; None: the present one.
            tolerance: See solve_static, in [m].
            start: Start in place of the present state, such as another solution's state.
            checked: Whether a stable equilibrium is certain. False saves a third of the time where `start` is
                stable and so close that the result must be, too.

        Raises:
            CommandError: wrong length or not finite.
            NotConvergedError: no equilibrium was found.
        """
        targets = np.array(check_command(list(joints), self.joint_names))
        control = Control(targets, self.forces, self.base_shift if base_shift is None else float(base_shift))
        massless = self._time_step.massless
        return solve_static(
            self.model,
            self._state if start is None else start,
            control,
            self.parameters,
            actuators=self._actuators,
            tolerance=tolerance,
            solver=choose_linear_solver(self.scene.solver.linear_solver),
            leading=Leading(massless, checked) if massless is not None else None,
        )

    def settle(
        self,
        joints: Sequence[float] | Array,
        base_shift: float | None = None,
        *,
        tolerance: float = 1e-11,
        start: State | None = None,
        checked: bool = True,
    ) -> StaticSolution:
        """Move to the static equilibrium that `equilibrium` finds, at rest; time does not advance.

        Raises:
            CommandError, NotConvergedError: as `equilibrium`; nothing is changed.
        """
        solution = self.equilibrium(joints, base_shift, tolerance=tolerance, start=start, checked=checked)
        self._state.copy_from(solution.state)
        let_relax(self.model, self._state, self.parameters)
        self._drive.place(np.array(joints, dtype=float), self.base_shift)
        self._sense(self._steps)
        return solution

    def _collect_snapshot(self) -> dict[str, Array]:
        """Return everything that a snapshot contains, by name."""
        parameters = self.parameters
        return {
            "steps": np.array([float(self._steps)]),
            **{f"state.{name}": array for name, array in self._state.arrays().items()},
            **{f"drive.{name}": array for name, array in self._drive.arrays().items()},
            "bases.targets": self._bases.targets,
            "forces": self._forces,
            "rigid_forces": self._rigid_forces,
            "parameters.materials": np.array(
                [value for values in parameters.materials for value in values.values()], dtype=float
            ),
            "parameters.rayleigh_stiffness": np.array([parameters.rayleigh_stiffness]),
            "parameters.rayleigh_mass": np.array([parameters.rayleigh_mass]),
        }

    def _identity(self) -> tuple[object, ...]:
        model = self.model
        arrays = [model.rest, model.region_of_node, model.gravity, *(group.cells for group in model.groups)]
        arrays += [group.gradients for group in model.groups if not group.fills]
        kinds = [(group.element.name, group.material.name) for group in model.groups]
        return (self.scene.name, self.joint_names, model.dt, kinds, [array.tobytes() for array in arrays])


_OF_RIGID_BODIES = (
    "state.rigid_positions",
    "state.rigid_rotations",
    "state.rigid_velocities",
    "rigid_forces",
)
"""Arrays of a snapshot with a row for each rigid body with mass."""


def _part(saved: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """Return the arrays whose names start with a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in saved.items() if name.startswith(prefix)}
