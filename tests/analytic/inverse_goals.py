"""Goals made by forward equilibria, and the robots to reach them with: the Tripod, and a matrix of robots."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from tendon_bar import LENGTH, tendon_bar

from softsim_core import InverseController, Pose, Simulation, load_scene
from softsim_core.base import Array
from softsim_core.control.inverse import effector, place, walk
from softsim_core.scene import RobotDescription, as_robot

LOWER, UPPER = -2.0225, -0.0255
"""Joint limits of the Tripod in [rad]."""

MARGIN = 0.1 * (UPPER - LOWER)
"""Goals come from joints at least this far inside the limits."""

START, SHIFT = np.full(3, -1.4965), 0.035
"""Joints in [rad] and base shift in [m] at the end of the start move."""

COUNTS = [12, pytest.param(200, marks=pytest.mark.exhaustive)]
"""How many goals a test goes to: in the suite, and where there is time."""


def tripod_at_start() -> Simulation:
    """The Tripod on the low mesh, at rest where its start move ends, without a start move of its own."""
    simulation = Simulation(replace(load_scene("tripod", kind="robots"), start=None))
    place(simulation, START, SHIFT)
    return simulation


@cache
def goals(count: int, seed: int, reach: float = np.inf) -> list[tuple[Array, Pose]]:
    """Random joints inside the limits, at most `reach` [rad] from the start pose, and the effector there."""
    rng, simulation = np.random.default_rng(seed), tripod_at_start()
    home, found = simulation.snapshot(), []
    lower = np.maximum(LOWER + MARGIN, START - reach)
    upper = np.minimum(UPPER - MARGIN, START + reach)
    for _ in range(count):
        joints = rng.uniform(lower, upper)
        simulation.restore(home)
        if simulation.backend == "numba":
            walk(simulation, joints, SHIFT)
        simulation.settle(joints)
        found.append((joints, effector(simulation)))
    return found


UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])

DTS = (0.002, 0.005, 0.01, 0.02)
"""Steps of the matrix in [s]; a seed picks one."""

KINDS = {"bar": 92, "arm": 36, "emio": 36, "tripod": 36}
"""Robots of the matrix, and how many goals each is given: 200."""

SIZE = {"bar": LENGTH, "arm": 0.15, "emio": 0.25, "tripod": 0.15}
"""Further from its rest than this in [m] no effector gets."""


@dataclass(frozen=True, slots=True, eq=False)
class SeededGoal:
    """A goal of the matrix.

    Attributes:
        robot: With the step of the matrix.
        joints: Whose equilibrium made the goal, in [rad], [m] or [m^3].
        position: Of the effector there in [m].
        start: Joints and base shift to start at; None: the robot's own.
    """

    robot: RobotDescription
    joints: Array
    position: Array
    start: tuple[Array, float] | None = None

    def controller(self) -> InverseController:
        """Inverse control on its way to the goal."""
        controller = InverseController(self.robot)
        controller.start(*(self.start or ()))
        controller.set_goal(Pose(self.position, UPRIGHT))
        return controller


def seeded_goal(kind: str, seed: int) -> SeededGoal:
    """A goal that a robot has a pose for: a bar of 2 to 20 tendons, a pneumatic arm, Emio or the Tripod."""
    dt, rng = DTS[seed % len(DTS)], np.random.default_rng([seed, *kind.encode()])
    if kind == "bar":
        tendons, young_modulus = 2 + seed % 19, float(10.0 ** rng.uniform(5.2, 6.0))
        joints = np.zeros(tendons)
        pulled = rng.permutation(tendons)[:3]
        joints[pulled] = rng.uniform(0.0, 0.02, len(pulled))
        robot = as_robot(tendon_bar(tendons, dt, young_modulus=young_modulus))
        return SeededGoal(robot, joints, _resting(Simulation(robot), joints))
    if kind == "tripod":
        joints = rng.uniform(LOWER + MARGIN, UPPER - MARGIN, 3)
        robot = load_scene("tripod", kind="robots").with_scene(dt=dt)
        return SeededGoal(robot, joints, _resting(tripod_at_start(), joints, SHIFT), (START, SHIFT))
    robot = load_scene({"arm": "pneu_arm"}.get(kind, kind), kind="robots")
    joints = rng.uniform(0.0, 1e-5, 3)
    if kind == "emio":
        joints = rng.uniform(-0.4, 1.3, 4) * np.array([1.0, -1.0, 1.0, -1.0])
    return SeededGoal(robot.with_scene(dt=dt), joints, _resting(Simulation(robot.robot_alone()), joints))


def seeded_goal_outside(kind: str, seed: int) -> SeededGoal:
    """A goal that no pose has: far away, or a bar's tip further down than it hangs, as no tendon pushes."""
    case, rng = seeded_goal(kind, seed), np.random.default_rng([seed, 1, *kind.encode()])
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    if kind != "bar":
        home = effector(case.controller().model).position
        return replace(case, position=home + rng.uniform(0.8, 1.3) * SIZE[kind] * direction)
    if seed % 2:
        return replace(case, position=rng.uniform(1.1, 1.6) * LENGTH * direction)
    rest = _resting(Simulation(case.robot), 0.0 * case.joints)
    return replace(case, position=rest + np.array([0.0, 0.0, rng.uniform(3e-4, 5e-3)]))


def _resting(simulation: Simulation, joints: Array, shift: float = 0.0) -> Array:
    """Where the effector rests with given joints, reached from where the simulation is, in [m]."""
    if simulation.compiled:
        walk(simulation, joints, shift)
    simulation.settle(joints)
    return effector(simulation).position.copy()
