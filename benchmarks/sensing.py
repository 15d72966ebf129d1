"""Measure the cost of sensors: the stage `sensors` of a step, each alone and all together.

Every sensor is read once per step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.records import align_columns
from softsim_core import Simulation
from softsim_core.base import Array, no_garbage_collection
from softsim_core.physics.sensing import SimulatedSensorDescription
from softsim_core.scene import RobotDescription, load_scene

SCENE = "sensed_finger"
LIMIT_MS = 0.5
"""Largest cost of all sensors of the scene per step, on an otherwise idle machine."""
PULLED = 0.006
"""Pull of the cable in [m], at which the fingertip presses on the knob."""
STEPS_A_TURN, LEAD_IN_STEPS = 10, 100
ALL = "all of them"


@dataclass(frozen=True)
class SensorTime:
    """Times of the stage `sensors` in [ms] per step.

    Attributes:
        sensor: Name and kind, or ALL.
        min_ms, median_ms: Shortest and median.
        limit: Target of ALL in [ms]; None: no target.
    """

    sensor: str
    min_ms: float
    median_ms: float
    limit: float | None = None

    @property
    def missed(self) -> bool:
        """Whether the shortest time exceeds the limit."""
        return self.limit is not None and not self.min_ms <= self.limit

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        return {
            "sensor": self.sensor,
            "min_ms": self.min_ms,
            "median_ms": self.median_ms,
            "limit": self.limit,
        }


class _PressedScene:
    """A scene that presses on its sensors, and the times that these took."""

    def __init__(self, description: RobotDescription) -> None:
        self.simulation = Simulation(description, backend="numba")
        self.simulation.command([PULLED])
        for _ in range(LEAD_IN_STEPS):
            self.simulation.step()
        self.times: list[float] = []

    def turn(self) -> None:
        """Run some steps."""
        for _ in range(STEPS_A_TURN):
            self.simulation.step()
            self.times.append(self.simulation.stage_times["sensors"])


def measure_sensors(rounds: int) -> list[SensorTime]:
    """Measure each sensor of the scene alone, and all together, in turns."""
    robot = load_scene(SCENE)
    every = tuple(replace(each, rate=None) for each in robot.scene.sensors)
    alone = {f"{each.name} ({each.kind})": (each,) for each in every}
    groups: dict[str, tuple[SimulatedSensorDescription, ...]] = {**alone, ALL: every}
    scenes = {
        name: _PressedScene(replace(robot, scene=replace(robot.scene, sensors=sensors)))
        for name, sensors in groups.items()
    }
    with no_garbage_collection():
        for _ in range(rounds):
            for scene in scenes.values():
                scene.turn()
    return [_to_sensor_time(name, np.array(scene.times)) for name, scene in scenes.items()]


def _to_sensor_time(name: str, times: Array) -> SensorTime:
    return SensorTime(name, float(times.min()), float(np.median(times)), LIMIT_MS if name == ALL else None)


def sensor_table(times: Sequence[SensorTime]) -> list[str]:
    """Return the times as lines of aligned columns, head first."""
    rows: list[tuple[str, ...]] = [("sensor", "min ms", "median ms", "target", "verdict")]
    for each in times:
        asked = (
            ("", "") if each.limit is None else (f"<= {each.limit:g} ms", "MISSED" if each.missed else "ok")
        )
        rows.append((each.sensor, f"{each.min_ms:.3f}", f"{each.median_ms:.3f}", *asked))
    return align_columns(rows)
