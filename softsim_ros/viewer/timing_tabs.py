"""The tabs Plots and Timing: curves of the last half minute, statistics and profiler of the steps."""

from __future__ import annotations

from typing import Any

from softsim_core.scene.robot import RobotDescription
from softsim_ros.viewer.page_node import PageNode
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.plots import Curves
from softsim_ros.viewer.profiler import ProfilerView
from softsim_ros.viewer.stage_tables import stage_table


class PlotsTab:
    """Curves over time.

    Args:
        gui: viser's controls, inside the tab.
        viewer: The node whose state is drawn.
        robot: The scene.
    """

    def __init__(self, gui: Any, viewer: PageNode, robot: RobotDescription) -> None:
        self._viewer, self._robot = viewer, robot
        charts = {
            "positions": ("Joint positions [rad or m]", robot.joint_names),
            "error": ("Effector to goal [mm]", ("error",)),
            "efforts": ("Torque [N·m] or tension [N]", robot.joint_names),
            "stages": ("Time a step [ms]", ("step", "publishing")),
            "factor": ("Real-time factor", ("factor",)),
        }
        self._plots = {
            name: Curves(gui, title, series)
            for name, (title, series) in charts.items()
            if series  # a scene may have no joints
        }

    def add(self, time_s: float) -> None:
        """One more point on every curve."""
        viewer = self._viewer
        state = viewer.state
        if "positions" in self._plots and state.measured is not None:
            self._plots["positions"].add(time_s, state.measured)
        if "efforts" in self._plots and len(viewer.efforts) == len(self._robot.joints):
            self._plots["efforts"].add(time_s, viewer.efforts)
        self._plots["error"].add(time_s, (viewer.goal_error_mm,))
        stages = viewer.diagnostics.stages
        means = [float(stages.get(name, {}).get("mean_ms", "0")) for name in ("step", "publishing")]
        self._plots["stages"].add(time_s, means)
        self._plots["factor"].add(time_s, (state.real_time_factor or 0.0,))


class TimingTab:
    """Table of the stages, and profiler of single steps.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        viewer: The node whose diagnostics are shown.
    """

    def __init__(self, gui: Any, inbox: Inbox, viewer: PageNode) -> None:
        self._viewer = viewer
        self._stages = Shown(gui.add_html(""))
        self._profiler = ProfilerView(gui, inbox)

    def refresh(self) -> None:
        """Show the newest statistics."""
        diagnostics = self._viewer.diagnostics
        self._stages.show(stage_table(diagnostics.stages))
        self._profiler.refresh(diagnostics.profile)
