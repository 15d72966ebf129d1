"""The status display: pure functions that turn the robot's state into lines of text that fit the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from softsim_core.base import ANGLE, LENGTH, MILLIMETRE, SHORTENING, Unit
from softsim_core.scene import JointDescription, KeyBinding, RobotDescription
from softsim_ros.client import (
    STALE_AFTER_S,
    BridgeState,
    RobotState,
    commandable,
    enforces_limits,
    format_point,
    known_effector,
)
from softsim_ros.keys import (
    GOAL_KEYS,
    HELP_KEY,
    TILT_KEYS,
    KeyState,
    goal_help,
    key_of,
    key_table,
    tilt_line,
)

BAR_WIDTHS: Final = (24, 16, 10)
"""Widths in [columns] tried for the bars, widest first; narrower terminals have no bars."""

WARNING_S: Final = 20.0
"""Time in [s] for which a warning is shown, beside the answers to keys."""

BRIDGE_TEXT: Final[dict[BridgeState, str]] = {
    "not running": "not running",
    "init": "init (port closed)",
    "no-comm": "no-comm (ready, not sending)",
    "comm": "comm (sending)",
    "finalized": "finalized (start it again)",
    "changing": "changing ...",
}

_NAME_WIDTH = 12
_SIGNS = {"plus": "+", "minus": "-"}


@dataclass(frozen=True, slots=True)
class View:
    """Content of the display.

    Attributes:
        robot: Joints with limits, and keys.
        state: State of the robot.
        keys: State of the keys.
        message: Newest message for the user.
        now: Steady clock in [s].
        namespace: Namespace of the robot's topics.
        notice: Permanent text, such as the page's address; empty: nothing.
        warning: Newest warning of the robot's nodes, or line of the scene's own code; empty: nothing.
        warned_at: When it came, in [s]; it is shown for WARNING_S.
    """

    robot: RobotDescription
    state: RobotState
    keys: KeyState
    message: str
    now: float
    namespace: str
    notice: str = ""
    warning: str = ""
    warned_at: float = -math.inf


def render(view: View, width: int, height: int) -> list[str]:
    """Return the display as at most `height` lines of at most `width` printable ASCII characters.

    If rows are few, the least important parts are left out first: blank lines, the keys, the table's head,
    the title.
    """
    message = _wrap(f"> {view.message}" if view.message else ">", width)[:3]
    warns = bool(view.warning) and view.now - view.warned_at <= WARNING_S
    joints = joint_rows(view, width)
    sections = [  # importance (0 stays longest), lines; in the order they are shown
        (4, [f"{view.robot.name} teleop, topics in {view.namespace}"]),
        (5, _wrap(view.notice, width) if view.notice else []),
        (1, status_lines(view, width)),
        (1, _wrap(goal_line(view), width) if view.state.inverse else []),
        (7, _pulse_lines(view)),
        (8, [""]),
        (5, joints[:1]),
        (0, joints[1:]),
        (8, [""]),
        (3, [f"key: {view.keys.last_key or '-'}"]),
        (2, message),
        (3, _wrap(f"! {view.warning}", width)[:3] if warns else []),
        (8, [""]),
        (6, _help_lines(view, width)),
    ]
    shown = list(sections)
    for _ in sections:
        if sum(len(lines) for _, lines in shown) <= height:
            break
        shown.remove(max(shown, key=lambda section: section[0]))
    lines = [line for _, section in shown for line in section]
    if not lines:  # even the joints do not fit
        lines = joints[1:]
    return [_fit(line, width) for line in lines[:height]]


def frame(lines: Sequence[str], height: int) -> str:
    """Return the text that draws the lines over the previous ones and clears the rest of the screen."""
    body = "\x1b[K\r\n".join(lines)
    below = "\x1b[K\x1b[J" if len(lines) < height else "\x1b[K"
    return f"\x1b[?2026h\x1b[H{body}{below}\x1b[?2026l"  # mode 2026: drawn at once if supported


def status_lines(view: View, width: int) -> list[str]:
    """Return the state of the simulator, the bridge and inverse control, in one line or one line each."""
    state = view.state
    if state.is_fresh(view.now):
        simulator = state.simulator or "running"
        if simulator == "running" and state.real_time_factor is not None:
            simulator += f" at {state.real_time_factor:.2f} x real time"
    elif state.measured is None:
        simulator = "no data yet"
    else:
        simulator = "paused" if state.paused else f"no data for {view.now - state.measured_at:.0f} s"
    if not enforces_limits(state, view.robot):
        simulator += ", limits off"
    parts = [f"simulator: {simulator}", f"servo bridge: {_bridge_text(view)}"]
    if state.inverse:
        note = f" ({state.inverse_note})" if state.inverse_note else ""
        parts.append(f"inverse control: on{note}")
    line = "   ".join(parts)
    return [line] if len(line) <= width else parts


def _bridge_text(view: View) -> str:
    """Return the state of the bridge, preceded by a latched e-stop and the key that releases it."""
    text = BRIDGE_TEXT[view.state.bridge]
    if not view.state.e_stopped:
        return text
    key = key_of(view.robot, "clear_e_stop")
    return f"E-STOP latched{f', {key_label(key)} releases it' if key else ''}; {text}"


def _pulse_lines(view: View) -> list[str]:
    """Return the pulses that an emulated board measures on its pins; no line without such a board."""
    state = view.state
    if view.now - state.pulses_at > STALE_AFTER_S:
        return []
    return [f"emulated board: pulses {' '.join(f'{w:.0f}' for w in state.pulses_us) or 'none yet'} (us)"]


def goal_line(view: View) -> str:
    """Return what the goal keys move: the tilt, or goal, effector and the distance between them in mm."""
    state = view.state
    if state.tilt is not None:
        return tilt_line(state.tilt, view.keys.axis)
    effector = known_effector(state, view.now)
    goal = "at the effector" if state.goal is None else format_point(state.goal)
    line = f"goal mm: {goal}   effector: {'no data' if effector is None else format_point(effector)}"
    if effector is not None and state.goal is not None:
        line += f"   off by {math.dist(effector.position, state.goal.position) / MILLIMETRE:.2f}"
    return line


def joint_rows(view: View, width: int) -> list[str]:
    """Return a head and one line per joint, as wide as fits.

    A line has name, limits, bar, commanded and measured position.
    """
    joints, state = view.robot.joints, view.state
    commanded = state.commanded or (None,) * len(joints)
    measured = state.measured or (None,) * len(joints)
    within = commandable(state, view.robot).measured or measured
    name_width = min(max((len(joint.name) for joint in joints), default=5), _NAME_WIDTH)
    name = ["joint", *(_fit(joint.name, name_width) for joint in joints)]
    command, small_command = _value_columns("command", [each.units.command for each in joints], commanded)
    position, small_position = _value_columns("measured", [each.units.position for each in joints], measured)
    lower = ["lower", *(_si(joint.units.command, joint.limits.lower) for joint in joints)]
    upper = ["upper", *(_si(joint.units.command, joint.limits.upper) for joint in joints)]

    def bars(bar_width: int) -> list[str]:
        legend = "o now, | command"
        head = legend if len(legend) <= bar_width else ""
        return [head, *map(lambda j, m, c: bar(j, m, c, bar_width), joints, within, commanded)]

    values = [command, small_command, position, small_position]
    layouts = [[name, lower, bars(bar_width), upper, *values] for bar_width in BAR_WIDTHS]
    layouts += [[name, *values], [name, command, position], [name, position]]
    tables = [_columns(layout) for layout in layouts]
    return next((table for table in tables if all(len(row) <= width for row in table)), tables[-1])


def _value_columns(
    title: str, units: Sequence[Unit], values: Sequence[float | None]
) -> tuple[list[str], list[str]]:
    """Return the columns of some values, in SI and in their small units, each with its head."""
    si = "|".join(unit.si for unit in dict.fromkeys(units))
    small = "|".join(unit.shown for unit in dict.fromkeys(units))
    rows = list(zip(units, values, strict=True))
    return (
        [f"{title} {si}", *(_si(unit, value) for unit, value in rows)],
        [f"{small:>6}", *("-" if value is None else f"{value * unit.per_si:.1f}" for unit, value in rows)],
    )


def bar(joint: JointDescription, measured: float | None, commanded: float | None, width: int) -> str:
    """Return a joint's position between its limits as "[---o-|--]": o measured, | commanded, # both.

    Without limits a revolute joint's bar spans a whole turn (-pi to pi), and a slide's is empty.
    """
    lower, upper = joint.limits.lower, joint.limits.upper
    if not (math.isfinite(lower) and math.isfinite(upper)) and joint.kind == "revolute":
        lower, upper = -math.pi, math.pi
    inner = width - 2
    cells = ["-"] * inner
    if math.isfinite(lower) and math.isfinite(upper) and upper > lower:
        for value, mark in ((commanded, "|"), (measured, "o")):
            if value is not None:
                cell = round((min(max(value, lower), upper) - lower) / (upper - lower) * (inner - 1))
                cells[cell] = "#" if cells[cell] == "|" else mark
    return f"[{''.join(cells)}]"


def key_label(name: str) -> str:
    """Return a short name of a key."""
    return _SIGNS.get(name, name.replace("_", " "))


def _help_lines(view: View, width: int) -> list[str]:
    if not view.keys.show_help:
        return [f"{HELP_KEY} shows the keys"]
    table: dict[str, KeyBinding] = key_table(view.robot)
    if view.state.inverse:  # keys of the goal, then other keys that are active
        helps = {key: goal_help(key) for key in GOAL_KEYS} if view.state.tilt is None else TILT_KEYS
        entries = [(key_label(key), text) for key, text in helps.items()]
        table = {
            key: binding
            for key, binding in table.items()
            if key not in GOAL_KEYS and binding.action not in (None, "start")
        }
    else:
        entries = []
    again = {"send": " (again: stop)", "inverse": " (again: off)"}
    entries += [(key_label(key), each.help + again.get(each.action or "", "")) for key, each in table.items()]
    if HELP_KEY not in table:
        entries.append((HELP_KEY, "hide the keys"))
    tables = [_help_table(entries, columns) for columns in (3, 2, 1)]
    fitting = (table for table in tables if all(len(line) <= width for line in table))
    return ["keys, plain or with Ctrl (Ctrl+C quits):", *next(fitting, tables[-1])]


def _help_table(entries: Sequence[tuple[str, str]], columns: int) -> list[str]:
    """Return keys and their actions in columns, read downwards."""
    rows = -(-len(entries) // columns)
    blocks = []
    for first in range(0, len(entries), rows):
        block = entries[first : first + rows]
        label_width = max(len(label) for label, _ in block)
        cells = [f"{label:>{label_width}}  {text}" for label, text in block]
        cell_width = max(map(len, cells))
        blocks.append([cell.ljust(cell_width) for cell in cells] + [""] * (rows - len(cells)))
    return ["   ".join(cells).rstrip() for cells in zip(*blocks, strict=True)]


def _si(unit: Unit, value: float | None) -> str:
    if value is None:
        return "-"
    if not math.isfinite(value):
        return f"{value}"
    return f"{value:.4f}" if unit in (ANGLE, LENGTH, SHORTENING) else f"{value:.4g}"


def _columns(columns: Sequence[Sequence[str]]) -> list[str]:
    """Return the rows of a table: the first column and bars aligned left, numbers right."""
    widths = [max(map(len, column)) for column in columns]
    rows = zip(*columns, strict=True)
    return [
        " ".join(
            cell.ljust(width) if index == 0 or column[-1].startswith("[") else cell.rjust(width)
            for index, (cell, width, column) in enumerate(zip(row, widths, columns, strict=True))
        ).rstrip()
        for row in rows
    ]


def _wrap(text: str, width: int) -> list[str]:
    """Return lines of at most `width` characters, broken at blanks where possible."""
    return textwrap.wrap(
        text, max(width, 1), subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )


def _fit(text: str, width: int) -> str:
    """Return printable ASCII of at most `width` characters; a tilde marks a cut."""
    clean = "".join(character if " " <= character <= "~" else "?" for character in text)
    return clean if len(clean) <= width else clean[: max(width - 1, 0)] + "~"[:width]
