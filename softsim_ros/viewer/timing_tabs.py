"""The tabs Plots and Timing: curves of the last half minute, statistics and profiler of the steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from softsim_core.scene.robot import RobotDescription
from softsim_ros.client.state import RobotState
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.plots import Curves, TimeAxis
from softsim_ros.viewer.profiler import ProfilerView
from softsim_ros.viewer.readings import goal_error_mm
from softsim_ros.viewer.stage_tables import stage_table
from softsim_ros.viewer.step_statistics import StepStatistics
from softsim_ros.viewer.units import unit_on_page


class PlotsTab:
    """Curves over simulated time.

    Args:
        gui: viser's controls, inside the tab.
        robot: The scene.
        state: Gives what is known of the robot.
        statistics: Times of the steps.
    """

    def __init__(
        self,
        gui: Any,
        robot: RobotDescription,
        state: Callable[[], RobotState],
        statistics: StepStatistics,
    ) -> None:
        self._robot, self._state, self._statistics = robot, state, statistics
        self._units = [unit_on_page(joint.units.position) for joint in robot.joints]
        of_positions = _listed(unit for _, unit in self._units)
        of_efforts = _listed(joint.units.effort for joint in robot.joints)
        charts = {
            "positions": (f"Joint positions [{of_positions}]", robot.joint_names),
            "error": ("Effector to goal [mm]", ("error",)),
            "efforts": (f"Efforts [{of_efforts}]", robot.joint_names),
            "stages": ("Time a step [ms]", ("step", "publishing")),
            "factor": ("Real-time factor", ("factor",)),
        }
        self._axis = TimeAxis(time.monotonic())
        self._plots = {
            name: Curves(gui, title, series, self._axis)
            for name, (title, series) in charts.items()
            if series  # a scene may have no joints
        }
        self._seen_at: float | None = None

    def add(self, now: float) -> None:
        """Add a point to each curve at `now`, steady clock, in [s]; none while simulated time stands."""
        state, stages = self._state(), self._statistics.stages
        if self._axis.follow(state):
            self._seen_at = None
            for curves in self._plots.values():
                curves.blank(now)
        if self._seen_at is not None:
            before, time_s = self._axis.times([self._seen_at, now])
            if time_s <= before:
                return
        self._seen_at = now
        if "positions" in self._plots and state.measured is not None:
            shown = [at * factor for at, (factor, _) in zip(state.measured, self._units, strict=False)]
            self._plots["positions"].add(now, shown)
        if "efforts" in self._plots and len(state.efforts) == len(self._robot.joints):
            self._plots["efforts"].add(now, state.efforts)
        error = goal_error_mm(state)
        if error is None:
            self._plots["error"].blank(now)
        else:
            self._plots["error"].add(now, (error,))
        if stages:
            means = [float(stages.get(name, {}).get("mean_ms", "0")) for name in ("step", "publishing")]
            self._plots["stages"].add(now, means)
        if state.real_time_factor is not None:
            self._plots["factor"].add(now, (state.real_time_factor,))


class TimingTab:
    """Table of the stages, and profiler of single steps.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        statistics: What is shown.
    """

    def __init__(self, gui: Any, inbox: Inbox, statistics: StepStatistics) -> None:
        self._statistics = statistics
        self._stages = Shown(gui.add_html(""))
        self._profiler = ProfilerView(gui, inbox)

    def refresh(self) -> None:
        """Show the newest statistics."""
        self._stages.show(stage_table(self._statistics.stages))
        self._profiler.refresh(self._statistics.profile)


def _listed(units: Iterable[str]) -> str:
    """Each unit once: "rad or m"."""
    return " or ".join(dict.fromkeys(units))
