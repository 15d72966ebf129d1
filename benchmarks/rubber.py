"""Measure steps with rubber and air: quadratic cells against one factorisation, chambers against none."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.records import align_columns
from benchmarks.steps import COMMAND_SPREAD, Factorisation
from softsim_core import Simulation
from softsim_core.base import Contender, take_turns
from softsim_core.scene import RobotDescription, load_scene

QUADRATIC = {"cantilever_quadratic": 0.9, "tripod_quadratic": 2.0, "cable_finger_quadratic": 1.0}
"""Scenes with quadratic cells, and the longest step in [ms] on an otherwise idle machine."""
CHAMBERS = ("pneu_finger", "pneu_arm", "inflated_cube")
CHAMBER_LIMIT = 0.15
"""Largest cost of a chamber as a fraction of the step without it."""
STEPS_A_TURN, LEAD_IN_STEPS = 10, 20


@dataclass(frozen=True)
class RubberTime:
    """Times of one scene in [ms], shortest and median.

    Attributes:
        scene: Its name.
        nodes: Number of nodes of its bodies.
        step: Times of a step.
        beside: Times of the comparison.
        against: "splu", one factorisation of the step's matrix; "none", a step without chambers.
        limit: Target: for "splu" the shortest time, for "none" the cost as a fraction.
    """

    scene: str
    nodes: int
    step: tuple[float, float]
    beside: tuple[float, float]
    against: str
    limit: float

    @property
    def measured(self) -> float:
        """Value to compare with `limit`."""
        return self.step[0] if self.against == "splu" else self.step[0] / self.beside[0] - 1.0

    @property
    def missed(self) -> bool:
        """Whether the value exceeds the limit."""
        return not self.measured <= self.limit

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        return {
            "scene": self.scene,
            "nodes": self.nodes,
            "min_ms": self.step[0],
            "median_ms": self.step[1],
            f"{self.against}_min_ms": self.beside[0],
            f"{self.against}_median_ms": self.beside[1],
            "measured": self.measured,
            "limit": self.limit,
        }


class _Moving:
    """A scene in which joints move: around the start pose, or in a part of their range."""

    def __init__(self, description: RobotDescription) -> None:
        with warnings.catch_warnings():  # the warnings about slivers are known
            warnings.simplefilter("ignore", UserWarning)
            self.simulation = Simulation(description, backend="numba")
        start, upper = description.start, [joint.limits.upper for joint in description.joints]
        self._middle, self._spread = 0.2 * np.array(upper), 0.1 * np.array(upper)
        if start is not None:
            self.simulation.start_animation()
            self._middle, self._spread = np.array(description.poses[start.pose]), np.array(COMMAND_SPREAD)
        self._random = np.random.default_rng(1)
        for _ in range(LEAD_IN_STEPS):
            self.simulation.step()

    def stir(self) -> None:
        """Send another command; a body without joints falls again."""
        if len(self._middle):
            sideways = self._random.uniform(-1.0, 1.0, len(self._middle))
            self.simulation.command(self._middle + self._spread * sideways)
        else:
            self.simulation.reset()


def measure_rubber(rounds: int, scenes: Sequence[str] = (*QUADRATIC, *CHAMBERS)) -> list[RubberTime]:
    """Measure scenes, each in turns with its comparison."""
    return [
        _beside_factor(name, QUADRATIC[name], rounds) if name in QUADRATIC else _beside_none(name, rounds)
        for name in scenes
    ]


def _beside_factor(name: str, limit: float, rounds: int) -> RubberTime:
    moving = _Moving(load_scene(name))
    factorisation = Factorisation(moving.simulation)
    contenders = [
        Contender("step", moving.simulation.step, STEPS_A_TURN, moving.stir),
        Contender("splu", factorisation.run, 1, factorisation.prepare),
    ]
    return _time_contenders(name, moving, contenders, rounds, limit)


def _beside_none(name: str, rounds: int) -> RubberTime:
    robot = load_scene(name)
    bare = RobotDescription(scene=replace(robot.scene, joints=()))
    moving, none = _Moving(robot), _Moving(bare)
    contenders = [
        Contender("step", moving.simulation.step, STEPS_A_TURN, moving.stir),
        Contender("none", none.simulation.step, STEPS_A_TURN),
    ]
    return _time_contenders(name, moving, contenders, rounds, CHAMBER_LIMIT)


def _time_contenders(
    name: str, moving: _Moving, contenders: Sequence[Contender], rounds: int, limit: float
) -> RubberTime:
    times = take_turns(contenders, rounds)
    step, beside = ((float(each.min()), float(np.median(each))) for each in times.values())
    nodes = len(moving.simulation.positions)
    return RubberTime(name, nodes, step, beside, contenders[1].name, limit)


def rubber_table(times: Sequence[RubberTime]) -> list[str]:
    """Return the times as lines of aligned columns, head first."""
    head = ("scene", "nodes", "min ms", "median ms", "beside", "min ms", "measured", "target", "verdict")
    rows: list[tuple[str, ...]] = [head]
    for each in times:
        share = each.against == "none"
        rows.append(
            (
                each.scene,
                str(each.nodes),
                f"{each.step[0]:.3f}",
                f"{each.step[1]:.3f}",
                "no chamber" if share else "splu",
                f"{each.beside[0]:.3f}",
                f"{100.0 * each.measured:+.1f} %" if share else f"1/{each.beside[0] / each.step[0]:.1f} splu",
                f"<= {100.0 * each.limit:.0f} %" if share else f"<= {each.limit:g} ms",
                "MISSED" if each.missed else "ok",
            )
        )
    return align_columns(rows)
