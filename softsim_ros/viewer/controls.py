"""The panel of the page: tabs with what can be driven, switched, tuned and read."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from softsim_core.scene.description import SceneDescription
from softsim_core.scene.files import known_scenes
from softsim_ros.teleop.commands import enforces_limits
from softsim_ros.viewer import readings
from softsim_ros.viewer.hotkeys import hotkeys, key_label, page_keys
from softsim_ros.viewer.inner_view import SHOWN_AT_START, SWITCHES
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.plots import Curves
from softsim_ros.viewer.properties import parts_of
from softsim_ros.viewer.readings import AMBER, GREEN, GREY, RED
from softsim_ros.viewer.tuning import Tunable, tunables
from softsim_ros.viewer.units import joint_range, slider_value

if TYPE_CHECKING:
    from softsim_ros.viewer.viewer_node import Viewer

BRIDGE_LAMPS: Final = {"init": AMBER, "no-comm": AMBER, "comm": GREEN, "changing": AMBER}

SLIDER_HOLD_S: Final = 1.0
"""A slider that was moved by hand stays there this long, in [s], before it follows the commands of others."""


class Controls:
    """Every control of the panel; made anew for another scene.

    Args:
        server: viser's server.
        inbox: Where events of browsers go.
        viewer: The node that carries them out.
        robot: The scene.
    """

    def __init__(self, server: Any, inbox: Inbox, viewer: Viewer, robot: SceneDescription) -> None:
        self._gui, self._inbox, self._viewer, self._robot = server.gui, inbox, viewer, robot
        self._server = server
        gui = server.gui
        self._status = Shown(gui.add_html(""))
        self._lamps = Shown(gui.add_html(""))
        self._message = Shown(gui.add_html(""))
        self._add_run()
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            self._add_drive()
        with tabs.add_tab("View"):
            self._add_view()
        with tabs.add_tab("Tune"):
            self._add_tuning()
        with tabs.add_tab("Plots"):
            self._add_plots()
        with tabs.add_tab("Timing"):
            self._stages = Shown(gui.add_html(""))
        with tabs.add_tab("Scene"):
            self._add_scene()

    # --- tabs -----------------------------------------------------------------------------------------

    def _add_run(self) -> None:
        viewer = self._viewer
        actions = {
            "Run / pause": viewer.toggle_pause,
            "Step": viewer.step_once,
            "Reset": viewer.reset,
            "Reload": viewer.reload,
        }
        row = self._gui.add_button_group("Simulation", tuple(actions))

        async def clicked(event: Any) -> None:
            self._inbox.put(actions[event.target.value])

        row.on_click(clicked)

    def _add_drive(self) -> None:
        gui, robot, viewer = self._gui, self._robot, self._viewer
        self._bars = Shown(gui.add_html(""))
        self._sliders: dict[str, Any] = {}
        for joint in robot.joints:
            slider = gui.add_slider(joint.name, *joint_range(joint), slider_value(joint, joint.rest))
            self._inbox.on_change(slider, partial(viewer.drive_joint, joint.name))
            self._sliders[joint.name] = slider
        with gui.add_folder("Keys"):
            for name, binding in page_keys(robot).items():
                label = key_label(name, binding)
                self._inbox.on_click(gui.add_button(label), partial(viewer.press_button, name))
                for number, (hotkey, modifier) in enumerate(hotkeys(name)):
                    title = label if number == 0 else f"{label} ({number + 1})"
                    command: Any = gui.add_command(title, hotkey=hotkey, modifier=modifier)
                    self._inbox.on_key(command, partial(viewer.press_hotkey, name))
        with gui.add_folder("Servo board"):
            self._inbox.on_click(gui.add_button("Start / stop sending"), viewer.toggle_sending)
            stop = gui.add_button("E-STOP", color="red", hint="hold the servos still, latched")
            self._inbox.on_click(stop, viewer.e_stop)
            self._inbox.on_click(gui.add_button("Release e-stop"), viewer.clear_e_stop)

    def _add_view(self) -> None:
        gui, viewer = self._gui, self._viewer
        picture = viewer.picture
        stage = picture.stage
        self._stress = gui.add_checkbox("Stress colours", stage.surface.by_stress)
        self._inbox.on_change(self._stress, picture.colour_by_stress)
        self._top = gui.add_number("Top of the scale [kPa], 0: automatic", 0.0, min=0.0, step=1.0)
        self._inbox.on_change(self._top, picture.set_top_stress)
        self._legend = Shown(gui.add_html(""))
        self._inbox.on_change(gui.add_checkbox("Bodies", True), picture.show_bodies)
        self._inbox.on_change(gui.add_checkbox("Wire frame", False), picture.show_wireframe)
        for name, words in SWITCHES.items():
            box = gui.add_checkbox(words, name in SHOWN_AT_START)
            self._inbox.on_change(box, partial(picture.show_inner, name))
        for words, switch in (
            ("Cables", stage.cables.switch),
            ("Contacts and forces", stage.contacts.switch),
            ("Rigid bodies", stage.rigid.switch),
        ):
            self._inbox.on_change(gui.add_checkbox(words, True), switch)
        with gui.add_folder("Mouse"):
            pull = gui.add_checkbox("Drag pulls (as Shift + drag)", False)
            self._inbox.on_change(pull, stage.set_pull_mode)
            stiffness = gui.add_slider("Spring [N/m]", 1.0, 200.0, 1.0, viewer.pull_stiffness)
            self._inbox.on_change(stiffness, viewer.set_pull_stiffness)
        self._inbox.on_click(gui.add_button("Reset view"), picture.reset_view)
        gui.add_button("Save picture").on_click(save_picture)

    def _add_tuning(self) -> None:
        gui, viewer = self._gui, self._viewer
        self._tuning: dict[str, tuple[Tunable, Any]] = {}
        for tunable in tunables(self._robot):
            if tunable.is_switch:
                control = gui.add_checkbox(tunable.label, bool(tunable.start), hint=tunable.help)
            else:
                control = gui.add_slider(
                    tunable.label,
                    tunable.lower,
                    tunable.upper,
                    tunable.step,
                    tunable.start,
                    hint=tunable.help,
                )
            self._inbox.on_change(control, partial(viewer.tune, tunable))
            self._tuning[tunable.name] = (tunable, control)

    def _add_plots(self) -> None:
        gui = self._gui
        joints = self._robot.joint_names
        self._plots = {
            "positions": Curves(gui, "Joint positions [rad or m]", joints),
            "error": Curves(gui, "Effector to goal [mm]", ("error",)),
            "efforts": Curves(gui, "Torque [N·m] or tension [N]", joints),
            "stages": Curves(gui, "Time a step [ms]", ("step", "publishing")),
        }

    def _add_scene(self) -> None:
        gui, viewer = self._gui, self._viewer
        known = tuple(known_scenes())
        if known:
            name = viewer.scene_name
            chooser = gui.add_dropdown(
                "Robot or scene",
                known,
                initial_value=name if name in known else known[0],
                hint="runs in place of this one",
            )
            self._inbox.on_change(chooser, viewer.choose_scene)
        self._parts = parts_of(self._robot)
        tree = "\n".join(
            f"{'&nbsp;' * 4 * path.count('/')}{path.rsplit('/', 1)[-1]}  " for path in self._parts
        )
        paths = tuple(self._parts)
        part = gui.add_dropdown("Part", paths, initial_value=paths[0])
        self._properties = gui.add_markdown(self._part_text(paths[0]))
        self._inbox.on_change(part, self._show_part)
        with gui.add_folder("Tree", expand_by_default=False):
            gui.add_markdown(tree)

    def _show_part(self, path: str) -> None:
        self._properties.content = self._part_text(path)

    def _part_text(self, path: str) -> str:
        part = self._parts[path]
        rows = "\n".join(f"| {name} | {value} | {text} |" for name, value, text in part.properties)
        source = "" if self._robot.source is None else f"\n\nFrom `{self._robot.source}`"
        return f"**{path}**: {part.help}\n\n| | | |\n|---|---|---|\n{rows}{source}"

    @property
    def parameter_names(self) -> list[str]:
        """The simulator's parameters that are shown."""
        return list(self._tuning)

    # --- what changes -----------------------------------------------------------------------------------

    def refresh(self, now: float) -> None:
        """Show the state at `now`, steady clock in [s]; a few times a second."""
        viewer, robot = self._viewer, self._robot
        state = viewer.state
        words = state.simulator or "no simulator heard"
        if state.real_time_factor is not None:
            words += f", {state.real_time_factor:.2f} × real time"
        bad = state.simulator not in ("running", "paused")
        fault = viewer.diagnostics.fault
        self._status.show(readings.sentence(f"{viewer.get_namespace()}: {fault or words}", bad=bad))
        self._message.show(readings.sentence(state.message or "ready"))
        self._lamps.show(readings.lamps(self._lamp_states()))
        targets = state.commanded if state.commanded is not None else state.measured
        enforced = enforces_limits(state, robot)
        self._bars.show(readings.joint_bars(robot.joints, state.measured, targets, viewer.efforts, enforced))
        surface = viewer.picture.stage.surface
        self._legend.show(readings.legend(surface.shown_top) if surface.by_stress else "")
        self._stages.show(readings.stage_table(viewer.diagnostics.stages))
        if targets is not None:
            for joint, target in zip(robot.joints, targets, strict=True):
                value, slider = slider_value(joint, target), self._sliders[joint.name]
                if slider.value != value and now - viewer.slider_at > SLIDER_HOLD_S:
                    slider.value = value

    def _lamp_states(self) -> list[tuple[str, str]]:
        viewer, state = self._viewer, self._viewer.state
        simulator = {"running": GREEN, "paused": AMBER}.get(state.simulator, RED if state.simulator else GREY)
        bridge, stopped = f"bridge {state.bridge}", viewer.diagnostics.e_stopped
        return [
            ("simulator", simulator),
            (bridge, BRIDGE_LAMPS.get(state.bridge, GREY)),
            ("e-stop" if stopped else "no e-stop", RED if stopped else GREY),
            ("inverse on" if state.inverse else "inverse off", GREEN if state.inverse else GREY),
        ]

    def show_tuned(self, values: Mapping[str, Any]) -> None:
        """Show values of the simulator's parameters, in SI."""
        for name, value in values.items():
            if name in self._tuning:
                tunable, control = self._tuning[name]
                shown = tunable.shown(value)
                if control.value != shown:
                    control.value = shown

    def add_to_plots(self, time_s: float) -> None:
        """One more point on every curve."""
        viewer = self._viewer
        state = viewer.state
        if state.measured is not None:
            self._plots["positions"].add(time_s, state.measured)
        if len(viewer.efforts) == len(self._robot.joints):
            self._plots["efforts"].add(time_s, viewer.efforts)
        self._plots["error"].add(time_s, (viewer.goal_error_mm,))
        stages = viewer.diagnostics.stages
        means = [float(stages.get(name, {}).get("mean_ms", "0")) for name in ("step", "publishing")]
        self._plots["stages"].add(time_s, means)


def save_picture(event: Any) -> None:
    """Give the browser that asked a picture of what it shows (in viser's pool: it waits for the browser)."""
    from imageio.v3 import imwrite

    client = event.client
    if client is not None:
        picture = client.get_render(height=900, width=1200, timeout=30.0)
        client.send_file_download("softsim.png", imwrite("<bytes>", picture, extension=".png"))
