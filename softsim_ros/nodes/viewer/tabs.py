"""The panel of the page: state above, and the tabs of `TABS`."""

from __future__ import annotations

import html
import io
import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final
from urllib.parse import quote

from softsim_core.base import Placement
from softsim_core.scene import STRESS_MAPS, JointDescription, KeyBinding, RobotDescription, Section
from softsim_core.scene.io import laid_over, read_overrides, write_overrides
from softsim_ros.client import (
    LogLine,
    Parameters,
    RobotClient,
    RobotLog,
    RobotState,
    Simulator,
    enforces_limits,
)
from softsim_ros.keys import Keyboard, KeyPress, key_table
from softsim_ros.nodes.viewer import readings
from softsim_ros.nodes.viewer.edit_mode import EditMode, EditTab
from softsim_ros.nodes.viewer.panel import Control, HtmlElement, Inbox, LastMessage, Tab
from softsim_ros.nodes.viewer.parameters import KILO, Tunable, tunables
from softsim_ros.nodes.viewer.part_tree import Part, PartPanel, PartTree, parts_of
from softsim_ros.nodes.viewer.picture import Picture
from softsim_ros.nodes.viewer.profiler import Curves, ProfilerView, StepStatistics, TimeAxis, stage_table
from softsim_ros.nodes.viewer.readings import (
    AMBER,
    GREEN,
    GREY,
    LAYERS,
    RED,
    box,
    command_of,
    goal_error_mm,
    joint_range,
    slider_label,
    slider_value,
    unit_on_page,
    view_file,
)
from softsim_ros.nodes.viewer.stage import MousePull
from softsim_ros.nodes.viewer.surface import MM, band_colours

CTRL: Final = "cmd/ctrl"

_NAMED: Final = {name: f"arrow{name}" for name in ("up", "down", "left", "right")} | {
    name: name for name in ("space", "tab", "enter", "escape", "backspace", "delete")
}

_SIGNS: Final = {
    "up": "↑", "down": "↓", "left": "←", "right": "→", "plus": "+", "minus": "\N{MINUS SIGN}",
    "page_up": "PgUp", "page_down": "PgDn",
}  # fmt: skip
"""Symbols of keys on buttons; other keys are written as KeyPress does."""


def page_keys(robot: RobotDescription) -> dict[str, KeyBinding]:
    """Return the key bindings that a page offers: all of the robot's except those that quit a program."""
    return {name: binding for name, binding in key_table(robot).items() if binding.action != "quit"}


def hotkeys(name: str) -> list[tuple[str, str]]:
    """Return key and modifier of every way to press Ctrl and the key `name` in a browser."""
    if name == "plus":  # of the keypad; on a US keyboard with shift, and without
        return [("plus", CTRL), ("plus", f"{CTRL}+shift"), ("=", CTRL)]
    if name == "minus":
        return [("minus", CTRL)]
    return [(_NAMED.get(name, name.upper()), CTRL)]


def key_label(name: str, binding: KeyBinding) -> str:
    """Return the label of a key's button: "Ctrl+Up: servo 0 up"."""
    return f"{KeyPress(name, ctrl=True)}: {binding.help}"


def key_rows(robot: RobotDescription) -> list[tuple[str, dict[str, str]]]:
    """Return the rows of the key table: a title, and key names by button label.

    Keys of the same joints share a row, and so do all poses and all actions. The e-stop has buttons of its
    own above all tabs.
    """
    groups: dict[object, list[str]] = {}
    stops = ("e_stop", "clear_e_stop")
    keys = {name: each for name, each in page_keys(robot).items() if each.action not in stops}
    for name, binding in keys.items():
        groups.setdefault(binding.joints or binding.pose is not None, []).append(name)
    rows = []
    for what, names in groups.items():
        label = "poses" if what else "actions"
        if isinstance(what, tuple):
            label = what[0].replace("_", " ") + (" ..." if len(what) > 1 else "")
        buttons = {}
        for name in names:
            key, words = str(KeyPress(name)), keys[name].help.removeprefix(label).strip()
            sign = _SIGNS.get(name, key.upper() if len(key) == 1 else key)
            buttons[f"{sign} {words}"] = name  # such as "↑ up"
        rows.append((label, buttons))
    return rows


HINT: Final = (
    "In the picture: drag turns, right drag moves, the wheel zooms, <b>Shift + drag pulls</b> the silicone. "
    "Click here first, then keys act with Ctrl. Tab <b>View</b>: stress, what lies inside, pictures."
)


class Hint:
    """Instructions for new users, shown until they are closed."""

    shown = True

    def close(self, handles: Sequence[Any]) -> None:
        """Remove the instructions for as long as the page is served."""
        self.shown = False
        for handle in handles:
            handle.remove()


class DriveTab(Tab):
    """Controls that drive the robot, and a hint how the mouse works."""

    def __init__(
        self,
        gui: Any,
        inbox: Inbox,
        robot: RobotDescription,
        client: RobotClient,
        keyboard: Keyboard,
        hint: Hint,
    ) -> None:
        self._robot, self._client = robot, client
        self._bars = HtmlElement(gui.add_html(""))
        self._sliders: list[Control] = []
        for joint in robot.joints:
            start = slider_value(joint, joint.rest)
            slider = gui.add_slider(slider_label(joint), *joint_range(joint), start)
            self._sliders.append(inbox.on_change(slider, partial(self._move, joint)))
        with gui.add_folder("Keys, here with Ctrl"):
            for words, buttons in key_rows(robot):
                row = gui.add_button_group(words, tuple(buttons))
                inbox.on_press(
                    row, {button: partial(keyboard.click, name) for button, name in buttons.items()}
                )
        for name, binding in page_keys(robot).items():
            label = key_label(name, binding)
            for number, (hotkey, modifier) in enumerate(hotkeys(name)):
                title = label if number == 0 else f"{label} ({number + 1})"
                command: Any = gui.add_command(title, hotkey=hotkey, modifier=modifier)
                inbox.on_key(command, partial(keyboard.press_with_ctrl, name))
        inbox.on_click(gui.add_button("Start / stop sending to the board"), client.bridge.toggle)
        if hint.shown:
            handles = (gui.add_html(box(HINT)), gui.add_button("Close the hint", color="gray"))
            inbox.on_click(handles[1], partial(hint.close, handles))

    def refresh(self) -> None:
        """Show the joints."""
        joints, state = self._robot.joints, self._client.state
        targets = state.commanded if state.commanded is not None else state.measured
        enforced = enforces_limits(state, self._robot)
        self._bars.show(readings.joint_bars(joints, state.measured, targets, state.efforts, enforced))
        if targets is not None:
            for joint, slider, target in zip(joints, self._sliders, targets, strict=True):
                slider.show(slider_value(joint, target))

    def _move(self, joint: JointDescription, shown: float) -> None:
        self._client.joints.move(joint.name, command_of(joint, shown))


INFO, WARNING, ERROR = 20, 30, 40
REFRESH_S: Final = 0.5
SHOWN: Final = 60
"""Number of lines on the page."""


class LogTab(Tab):
    """Lines of the log: messages of the robot's nodes and of the page itself."""

    def __init__(self, gui: Any, log: RobotLog, page_message: LastMessage) -> None:
        self._log, self._page_message = log, page_message
        self._lines = HtmlElement(gui.add_html(""))
        self._said = ""
        self._shown, self._due = -1, 0.0

    def refresh(self) -> None:
        """Show the newest lines, including the page's own messages."""
        log, message = self._log, self._page_message.message
        if message and message != self._said:
            log.add(LogLine(time.time(), INFO, "page", message))
        self._said = message
        now = time.monotonic()
        if log.count != self._shown and now >= self._due:
            self._shown, self._due = log.count, now + REFRESH_S
            self._lines.show(log_table(list(log.lines)[-SHOWN:]))


def log_table(lines: Iterable[LogLine]) -> str:
    """Return lines as HTML, newest first: time of day, source, text; warnings and errors are coloured."""
    rows = ""
    for line in reversed(list(lines)):
        clock = time.strftime("%H:%M:%S", time.localtime(line.time_s))
        colour = RED if line.level >= ERROR else AMBER if line.level >= WARNING else "inherit"
        rows += (
            f'<div style="color:{colour}"><span style="opacity:0.6">{clock}</span> '
            f"<b>{html.escape(line.source)}</b> {html.escape(line.text)}</div>"
        )
    return box(f'<div style="overflow-wrap:anywhere">{rows or "nothing was said yet"}</div>')


class TuneTab(Tab):
    """A control for each tunable parameter of the simulator."""

    def __init__(self, gui: Any, inbox: Inbox, robot: RobotDescription, parameters: Parameters) -> None:
        self._parameters = parameters
        self._controls: dict[str, tuple[Tunable, Control]] = {}
        for tunable in tunables(robot):
            if tunable.is_switch:
                handle = gui.add_checkbox(tunable.label, bool(tunable.start), hint=tunable.help)
            else:
                handle = gui.add_slider(
                    tunable.label,
                    tunable.lower,
                    tunable.upper,
                    tunable.step,
                    tunable.start,
                    hint=tunable.help,
                )
            self._controls[tunable.name] = tunable, inbox.on_change(handle, partial(self._tune, tunable))
        parameters.follow(list(self._controls), self.show)

    def show(self, values: Mapping[str, Any]) -> None:
        """Show values of the simulator's parameters, in SI."""
        for name, value in values.items():
            if name in self._controls:
                tunable, control = self._controls[name]
                control.show(tunable.to_displayed(value))

    def _tune(self, tunable: Tunable, value: Any) -> None:
        self._parameters.set(tunable.name, tunable.si(value))


NODE_SIZES: Final = (0.2, 5.0, 0.1)
"""Range and step of the displayed size of nodes, in [mm]."""

CLIP_S: Final = 4.0
CLIP_SIZE: Final = (480, 640)
"""Height and width of a clip in pixels."""
UNCUT: Final = "nothing"
AXES: Final = ("x", "y", "z")


class ViewTab(Tab):
    """Controls of the picture, and of the spring with which the mouse pulls."""

    def __init__(self, gui: Any, inbox: Inbox, picture: Picture, mouse: MousePull) -> None:
        self._picture = picture
        view = picture.view
        self._legend, self._tensions = HtmlElement(gui.add_html("")), HtmlElement(gui.add_html(""))
        colours = gui.add_dropdown("Colours of stress", STRESS_MAPS, initial_value=view.stress_map)
        self._colours = inbox.on_change(colours, lambda chosen: picture.change(stress_map=chosen))
        top = gui.add_number(
            "Top of the scale [kPa], 0: automatic", (view.stress_top or 0.0) / KILO, min=0.0, step=1.0
        )
        inbox.on_change(top, lambda shown: picture.change(stress_top=KILO * shown or None))
        self._boxes = {}
        for name, words in LAYERS.items():
            switch = gui.add_checkbox(words, getattr(view, name))
            self._boxes[name] = inbox.on_change(switch, partial(self._switch, name))
        self._add_section(gui, inbox)
        size = gui.add_slider("Size of nodes [mm]", *NODE_SIZES, MM * view.node_size)
        inbox.on_change(size, lambda shown: picture.change(node_size=shown / MM))
        with gui.add_folder("Mouse"):
            inbox.on_change(gui.add_checkbox("Drag pulls (as Shift + drag)", False), picture.set_pull_mode)
            stiffness = gui.add_slider("Spring [N/m]", 1.0, 200.0, 1.0, mouse.stiffness)
            inbox.on_change(stiffness, mouse.set_stiffness)
        inbox.on_change(gui.add_checkbox("Dark page", picture.is_dark), picture.set_dark)
        inbox.on_click(gui.add_button("Reset view"), picture.reset_view)
        save = gui.add_button("Save view", hint="a file, and where Reset view goes from now on")
        save.on_click(partial(_save_view, inbox, picture))
        gui.add_button("Save picture").on_click(save_picture)
        clip = gui.add_button("Save clip", hint=f"the next {CLIP_S:g} s of the picture, moving")
        clip.on_click(save_clip)

    def _add_section(self, gui: Any, inbox: Inbox) -> None:
        """Add the controls of the section plane: an axis, and the position along it."""
        cut = self._picture.view.section
        axis = gui.add_dropdown("Cut open along", (UNCUT, *AXES), initial_value=cut.axis if cut else UNCUT)
        at = gui.add_slider("Cut at [%]", 0.0, 100.0, 1.0, 50.0, hint="of the bodies' extent at rest")

        def change(_: Any) -> None:
            section = None
            if axis.value in AXES:
                lower, upper = self._picture.extent(AXES.index(axis.value))
                section = Section(axis=axis.value, at=(lower + 0.01 * at.value * (upper - lower)) / MM)
            self._picture.change(section=section)

        for handle in (axis, at):
            inbox.on_change(handle, change)

    def refresh(self) -> None:
        """Show the scales of stress and tension, and the state of the switches."""
        stage, view = self._picture.stage, self._picture.view
        for name, each in self._boxes.items():
            each.show(getattr(view, name))
        self._colours.show(view.stress_map)
        colours = band_colours(view.stress_map)
        self._legend.show(readings.stress_legend(stage.surface.shown_top, colours) if view.stress else "")
        shown = view.tensions and view.cables and bool(stage.tensions.colours)
        self._tensions.show(readings.tension_legend(stage.tensions.top) if shown else "")

    def _switch(self, layer: str, shown: bool) -> None:
        self._picture.change(**{layer: shown})


async def _save_view(inbox: Inbox, picture: Picture, event: Any) -> None:
    """Store the camera of the requesting browser in the view, and send it the view as a file."""
    client = event.client
    if client is None:
        return
    position, target = client.camera.position.tolist(), client.camera.look_at.tolist()

    def save() -> None:
        picture.save_view(position, target)
        text = view_file(picture.robot, picture.view)
        client.send_file_download(f"{picture.robot.name}_view.yaml", text.encode(), save_immediately=True)

    inbox.put(save)


def save_clip(event: Any) -> None:
    """Send the requesting browser a clip of its view; runs in viser's pool, as it waits for the browser."""
    from PIL import Image

    client = event.client
    if client is None:
        return
    height, width = CLIP_SIZE
    frames, times = [], [time.monotonic()]
    while times[-1] - times[0] < CLIP_S:
        render = client.get_render(height=height, width=width, transport_format="jpeg", timeout=30.0)
        frames.append(Image.fromarray(render[..., :3]))
        times.append(time.monotonic())
    content = io.BytesIO()
    lasting = [max(1, round(1e3 * (b - a))) for a, b in itertools.pairwise(times)]
    frames[0].save(
        content, "WEBP", save_all=True, append_images=frames[1:], duration=lasting, loop=0, quality=80
    )
    client.send_file_download("softsim.webp", content.getvalue(), save_immediately=True)


def save_picture(event: Any) -> None:
    """Send the requesting browser a picture of its view; runs in viser's pool, as it waits."""
    from imageio.v3 import imwrite

    client = event.client
    if client is not None:
        picture = client.get_render(height=900, width=1200, timeout=30.0)
        content = imwrite("<bytes>", picture, extension=".png")
        client.send_file_download("softsim.png", content, save_immediately=True)


def joint_at(path: str) -> str | None:
    """Return the joint that a path of the tree leads to or into, or None."""
    steps = path.split("/")
    return steps[2] if len(steps) > 2 and steps[1] == "joints" else None


class SceneTab(Tab):
    """Parts of the scene, and a choice of other scenes; `is_local`: only this machine can open the page."""

    def __init__(
        self,
        gui: Any,
        inbox: Inbox,
        picture: Picture,
        simulator: Simulator,
        say: Callable[[str], None],
        *,
        is_local: bool,
    ) -> None:
        self._gui, self._inbox, self._picture, self._simulator = gui, inbox, picture, simulator
        self._say, self._is_local = say, is_local
        self._folder = gui.add_folder(None)
        self._content: list[Any] = []
        self._selected = picture.robot.name
        self.show_scene(picture.robot)

    def show_scene(self, robot: RobotDescription) -> None:
        """Show another scene, or the same one with changes; the selected part stays if it still exists."""
        for handle in self._content:
            handle.remove()
        gui, picture = self._gui, self._picture
        self._parts = parts_of(robot)
        with self._folder:
            self._content = self._add_chooser()
            self._panel = PartPanel(gui, self._inbox, self._apply_changes, self._say)
            self._tree = PartTree(
                gui, self._inbox, self._parts, robot.shown_parts, self._select, picture.hide
            )
            self._content += [self._panel.folder, self._tree.folder, *self._changes(picture.overrides)]
        self._select(self._selected if self._selected in self._parts else robot.name)

    def refresh(self) -> None:
        """Show which parts are hidden."""
        self._tree.show_hidden(self._picture.view.hidden)

    def _add_chooser(self) -> list[Any]:
        """Add a list of all robots and scenes."""
        names, current = self._picture.scenes, self._picture.robot.name
        if not names:
            return []
        chooser = self._gui.add_dropdown(
            "Robot or scene",
            names,
            initial_value=current if current in names else names[0],
            hint="runs instead of this one",
        )
        self._inbox.on_change(chooser, self._simulator.choose_scene)
        return [chooser]

    def _changes(self, changes: str) -> list[Any]:
        """Add the overrides of the scene's file, with how to save and how to discard them."""
        if not changes:
            return []
        gui, folder = self._gui, self._gui.add_folder("Changes")
        with folder:
            words = (
                f"Override of the file; to store it, write it into the file:<pre>{html.escape(changes)}</pre>"
            )
            gui.add_html(f'<div style="font-size:0.85em;padding:0 0.7em">{words}</div>')
            forget = gui.add_button("Forget changes")
            self._inbox.on_click(forget, partial(self._simulator.parameters.set, "overrides", ""))
        return [folder]

    def _apply_changes(self, changes: Mapping[str, Any]) -> None:
        """Restart the scene with additional overrides."""
        overrides = laid_over(read_overrides(self._picture.overrides), changes)
        self._simulator.parameters.set("overrides", write_overrides(overrides))

    def _select(self, path: str) -> None:
        self._selected = path
        self._picture.base.choose(joint_at(path))
        self._panel.show(self._parts[path], self._source_text(self._parts[path]))

    def _source_text(self, part: Part) -> str:
        """Return file and line of a part as HTML; on this machine with a link that opens an editor there."""
        found = self._picture.place(part.steps or ())
        if found is None:
            return ""
        file, line = found
        place = f"From <code style='word-break:break-all'>{html.escape(f'{file}:{line}')}</code>"
        if not self._is_local:
            return place
        link = html.escape(f"vscode://file{quote(file)}:{line}")
        return f'{place} <a href="{link}">open in VS Code</a>'


class PlotsTab(Tab):
    """Curves over simulated time; `state` returns the present state of the robot."""

    def __init__(
        self,
        gui: Any,
        robot: RobotDescription,
        state: Callable[[], RobotState],
        statistics: StepStatistics,
    ) -> None:
        self._robot, self._state, self._statistics = robot, state, statistics
        self._units = [unit_on_page(joint.units.position) for joint in robot.joints]
        of_positions = _join_units(unit for _, unit in self._units)
        of_efforts = _join_units(joint.units.effort for joint in robot.joints)
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
        self._added_at: float | None = None

    def sample(self, now: float) -> None:
        """Add a point to each curve at `now`, steady clock, in [s]; none while simulated time is paused."""
        state, stages = self._state(), self._statistics.stages
        if self._axis.follow(state):
            self._added_at = None
            for curves in self._plots.values():
                curves.blank(now)
        if self._added_at is not None:
            before, time_s = self._axis.times([self._added_at, now])
            if time_s <= before:
                return
        self._added_at = now
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


class TimingTab(Tab):
    """Table of the stages, and profiler of single steps."""

    def __init__(self, gui: Any, inbox: Inbox, statistics: StepStatistics) -> None:
        self._statistics = statistics
        self._stages = HtmlElement(gui.add_html(""))
        self._profiler = ProfilerView(gui, inbox)

    def refresh(self) -> None:
        """Show the newest statistics."""
        self._stages.show(stage_table(self._statistics.stages))
        self._profiler.refresh(self._statistics.profile)


def _join_units(units: Iterable[str]) -> str:
    """Return each unit once: "rad or m"."""
    return " or ".join(dict.fromkeys(units))


@dataclass(frozen=True)
class PageParts:
    """Objects behind the page; `is_local`: only browsers of this machine can open it."""

    client: RobotClient
    keyboard: Keyboard
    page_message: LastMessage
    picture: Picture
    mouse: MousePull
    statistics: StepStatistics
    log: RobotLog
    edit: EditMode
    hint: Hint
    is_local: bool


TABS: Final[Mapping[str, Callable[[Any, Inbox, PageParts], Tab]]] = {
    "Drive": lambda gui, inbox, page: DriveTab(
        gui, inbox, page.picture.robot, page.client, page.keyboard, page.hint
    ),
    "View": lambda gui, inbox, page: ViewTab(gui, inbox, page.picture, page.mouse),
    "Edit": lambda gui, inbox, page: EditTab(gui, inbox, page.edit),
    "Tune": lambda gui, inbox, page: TuneTab(
        gui, inbox, page.picture.robot, page.client.simulator.parameters
    ),
    "Plots": lambda gui, _, page: PlotsTab(
        gui, page.picture.robot, lambda: page.client.state, page.statistics
    ),
    "Timing": lambda gui, inbox, page: TimingTab(gui, inbox, page.statistics),
    "Log": lambda gui, _, page: LogTab(gui, page.log, page.page_message),
    "Scene": lambda gui, inbox, page: SceneTab(
        gui, inbox, page.picture, page.client.simulator, page.page_message.say, is_local=page.is_local
    ),
}
"""The tabs in their order, each built inside itself from viser's controls and the objects behind the page."""

BRIDGE_LAMPS: Final = {"init": AMBER, "no-comm": AMBER, "comm": GREEN, "changing": AMBER}

NARROW: Final = """<style>
@media (max-width: 36em) {
  [style*="width: 20em"] { width: 100% !important; }
  .mantine-Tabs-list { flex-wrap: nowrap; }
  .mantine-Tabs-tab { flex: 1 1 auto; padding: 0.75em 0.15em !important; font-size: 0.85em; }
}
</style>"""
"""Style for a window as narrow as a phone's: viser's panel gets its full width, and the tabs one row."""


class Controls:
    """All controls of the panel, for the scene of the picture; rebuilt for another scene."""

    def __init__(self, gui: Any, inbox: Inbox, parts: PageParts, namespace: str) -> None:
        self._parts, self._namespace = parts, namespace
        gui.add_html(NARROW)
        self._status = HtmlElement(gui.add_html(""))
        self._lamps = HtmlElement(gui.add_html(""))
        self._message = HtmlElement(gui.add_html(""))
        client = parts.client
        actions = {
            "Run / pause": client.simulator.toggle_pause,
            "Step": client.simulator.step,
            "Reset": client.simulator.reset,
            "Reload": client.simulator.reload,
        }
        inbox.on_press(gui.add_button_group("Simulation", tuple(actions)), actions)
        stop = gui.add_button("E-STOP", color="red", icon="hand-stop", hint="hold the servos still, latched")
        inbox.on_click(stop, client.bridge.e_stop)
        self._release = gui.add_button("Release e-stop", color="yellow", visible=False)
        inbox.on_click(self._release, client.bridge.clear_e_stop)
        group = gui.add_tab_group()
        self._tabs: list[Tab] = []
        for name, build in TABS.items():
            with group.add_tab(name):
                self._tabs.append(build(gui, inbox, parts))

    def refresh(self) -> None:
        """Show the state; to be called a few times per second."""
        state = self._parts.client.state
        bad = state.simulator not in ("running", "paused")
        words = readings.progress(state.simulator, state.real_time_factor, state.time_s, state.dt)
        self._status.show(readings.message_box(f"{self._namespace}: {state.fault or words}", bad=bad))
        self._message.show(readings.message_box(self._parts.page_message.message or "ready"))
        self._lamps.show(readings.lamps(_lamp_states(state)))
        if self._release.visible != state.e_stopped:
            self._release.visible = state.e_stopped
        for tab in self._tabs:
            tab.refresh()

    def sample(self, now: float) -> None:
        """Add a point to each curve of the tabs at `now`, steady clock, in [s]."""
        for tab in self._tabs:
            tab.sample(now)

    def show_scene(self, robot: RobotDescription) -> None:
        """Show another scene that has the same controls, see `have_same_controls`."""
        for tab in self._tabs:
            tab.show_scene(robot)


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
    """Return whether the controls of one scene, except the tab Scene, fit another one."""
    return _controls_of(a) == _controls_of(b)


def _controls_of(robot: RobotDescription) -> object:
    """Return the part of a scene that determines the controls."""
    joints = [replace(joint, base=Placement(), actuator=None, kind="revolute") for joint in robot.joints]
    kinds = [(joint.kind, joint.units) for joint in robot.joints]
    return robot.name, kinds, joints, page_keys(robot), tunables(robot)
