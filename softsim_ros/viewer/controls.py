"""The panel of the page: state and lamps above, tabs below."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from softsim_core.scene.robot import RobotDescription
from softsim_core.values import Placement
from softsim_ros.client.simulator import Simulator
from softsim_ros.client.state import RobotState
from softsim_ros.viewer import readings
from softsim_ros.viewer.drive_tab import DriveTab
from softsim_ros.viewer.edit_tab import EditTab
from softsim_ros.viewer.hotkeys import page_keys
from softsim_ros.viewer.log_tab import LogTab
from softsim_ros.viewer.page_parts import PageParts
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.readings import AMBER, GREEN, GREY, RED
from softsim_ros.viewer.scene_tab import SceneTab
from softsim_ros.viewer.timing_tabs import PlotsTab, TimingTab
from softsim_ros.viewer.tune_tab import TuneTab
from softsim_ros.viewer.tuning import tunables
from softsim_ros.viewer.view_tab import ViewTab

BRIDGE_LAMPS: Final = {"init": AMBER, "no-comm": AMBER, "comm": GREEN, "changing": AMBER}

NARROW: Final = """<style>
@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
  .mantine-Tabs-list { flex-wrap: nowrap; }
  .mantine-Tabs-tab { flex: 1 1 auto; padding: 0.75em 0.15em !important; font-size: 0.85em; }
}
</style>"""
"""In a window as narrow as a phone's, viser's panel gets all of its width, and the tabs one row."""


class Controls:
    """Every control of the panel; made anew for another scene.

    Args:
        gui: viser's controls.
        inbox: Where events of browsers go.
        parts: What carries them out; the scene is that of the picture.
        namespace: Of the robot.
    """

    def __init__(self, gui: Any, inbox: Inbox, parts: PageParts, namespace: str) -> None:
        self._parts, self._namespace = parts, namespace
        gui.add_html(NARROW)
        self._status = Shown(gui.add_html(""))
        self._lamps = Shown(gui.add_html(""))
        self._message = Shown(gui.add_html(""))
        client, picture, robot = parts.client, parts.picture, parts.picture.robot
        _add_run(gui, inbox, client.simulator)
        stop = gui.add_button("E-STOP", color="red", icon="hand-stop", hint="hold the servos still, latched")
        inbox.on_click(stop, client.bridge.e_stop)
        self._release = gui.add_button("Release e-stop", color="yellow", visible=False)
        inbox.on_click(self._release, client.bridge.clear_e_stop)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            self._drive = DriveTab(gui, inbox, robot, client, parts.keyboard, parts.hint)
        with tabs.add_tab("View"):
            self._view = ViewTab(gui, inbox, picture, parts.mouse)
        with tabs.add_tab("Edit"):
            self._edit = EditTab(gui, inbox, parts.edit)
        with tabs.add_tab("Tune"):
            TuneTab(gui, inbox, robot, client.simulator.parameters)
        with tabs.add_tab("Plots"):
            self.plots = PlotsTab(gui, robot, lambda: client.state, parts.statistics)
        with tabs.add_tab("Timing"):
            self._timing = TimingTab(gui, inbox, parts.statistics)
        with tabs.add_tab("Log"):
            self._log = LogTab(gui, parts.log, parts.spoken)
        with tabs.add_tab("Scene"):
            self.scene = SceneTab(
                gui, inbox, picture, client.simulator, parts.spoken.say, is_local=parts.is_local
            )

    def refresh(self) -> None:
        """Show the state; a few times per second."""
        state = self._parts.client.state
        bad = state.simulator not in ("running", "paused")
        words = readings.progress(state.simulator, state.real_time_factor, state.time_s, state.dt)
        self._status.show(readings.sentence(f"{self._namespace}: {state.fault or words}", bad=bad))
        self._message.show(readings.sentence(self._parts.spoken.sentence or "ready"))
        self._lamps.show(readings.lamps(_lamp_states(state)))
        if self._release.visible != state.e_stopped:
            self._release.visible = state.e_stopped
        self._drive.refresh()
        self._view.refresh()
        self._edit.refresh()
        self.scene.refresh()
        self._timing.refresh()
        self._log.refresh()


def _lamp_states(state: RobotState) -> list[tuple[str, str]]:
    simulator = {"running": GREEN, "paused": AMBER}.get(state.simulator, RED if state.simulator else GREY)
    stopped = state.e_stopped
    return [
        ("simulator", simulator),
        (f"bridge {state.bridge}", BRIDGE_LAMPS.get(state.bridge, GREY)),
        ("e-stop" if stopped else "no e-stop", RED if stopped else GREY),
        ("inverse on" if state.inverse else "inverse off", GREEN if state.inverse else GREY),
    ]


def have_same_controls(a: RobotDescription, b: RobotDescription) -> bool:
    """Whether the controls of one scene, but for the tab Scene, fit another one."""
    return _controlled(a) == _controlled(b)


def _controlled(robot: RobotDescription) -> object:
    """What of a scene the controls show."""
    joints = [replace(joint, base=Placement(), actuator=None, kind="revolute") for joint in robot.joints]
    kinds = [(joint.kind, joint.units) for joint in robot.joints]
    return robot.name, kinds, joints, page_keys(robot), tunables(robot)


def _add_run(gui: Any, inbox: Inbox, simulator: Simulator) -> None:
    """The row of buttons that run, pause, step, reset and reload the simulation."""
    actions = {
        "Run / pause": simulator.toggle_pause,
        "Step": simulator.step,
        "Reset": simulator.reset,
        "Reload": simulator.reload,
    }
    inbox.on_press(gui.add_button_group("Simulation", tuple(actions)), actions)
