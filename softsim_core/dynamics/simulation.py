"""A running scene: step, command, tune, snapshot."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from time import perf_counter

import numpy as np

from softsim_core.actuation.limits import check_command
from softsim_core.arrays import Array
from softsim_core.dynamics.bases import MovableBases
from softsim_core.dynamics.contact_step import NOTHING, ContactStepper
from softsim_core.dynamics.drive import JointDrive
from softsim_core.dynamics.scene_state import SceneState
from softsim_core.dynamics.statics import StaticSolution, solve_static
from softsim_core.dynamics.stepper import Inputs
from softsim_core.errors import SceneError, SolverDivergedError, listing
from softsim_core.fem.material import LinearMaterial
from softsim_core.mechanics.state import MEMORY, pack, unpack
from softsim_core.scene.description import Backend, SceneDescription

RUNAWAY_SPEED = 1.0e4
"""A node faster than this, in [m/s], has run away."""


class Simulation(SceneState):
    """A scene that runs in fixed steps. The same commands at the same steps give the same bytes.

    Args:
        scene: What to simulate.
        backend: "numba", "scipy" or "auto"; None takes the scene's.

    Raises:
        SceneError, MeshError, MaterialError: the scene cannot be built.
    """

    def __init__(self, scene: SceneDescription, backend: Backend | None = None) -> None:
        super().__init__(scene, backend)
        self._last_good = self.model.rest_state()
        self._drive = JointDrive(scene)
        self._bases = MovableBases(self.model.joints)
        self._steps = 0
        self._step_time = self._controllers_time = 0.0
        self._header = hashlib.sha256(repr(self._fingerprint()).encode()).digest()

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
