"""Format numbers for the user as HTML; units of joints; names of the layers that can be shown."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

from softsim_core.base import Unit
from softsim_core.scene import JointDescription, RobotDescription, ViewSettings
from softsim_core.scene.io import write_overrides
from softsim_ros.client import RobotState, format_position
from softsim_ros.nodes.viewer.marker_view import SLACK_COLOUR, TENSION_COLOURS
from softsim_ros.nodes.viewer.surface import MM

LAYERS: Final[Mapping[str, str]] = {
    "stress": "Stress colours",
    "bodies": "Bodies",
    "ghost": "Bodies at rest",
    "trail": "Way of the effector",
    "wireframe": "Wire frame",
    "normals": "Normals",
    "elements": "Finite elements",
    "nodes": "Nodes",
    "regions": "Rigid regions and fixings",
    "boxes": "Boxes and spheres that select nodes",
    "frames": "Frames",
    "arms": "Servo arms",
    "labels": "Labels",
    "cables": "Cables",
    "tensions": "Tension colours",
    "chambers": "Pressure chambers",
    "contacts": "Contacts and forces",
    "rigid": "Rigid bodies",
    "collisions": "Collision surfaces",
    "search_boxes": "Boxes of the contact search",
}


FINEST: Final = 1.0e-6
"""Smallest step in SI that is readable on the page; below it the display unit is used."""


def unit_on_page(unit: Unit) -> tuple[float, str]:
    """Return how many page units one SI unit is, and the page unit's name: SI, but ml for volumes."""
    return (unit.per_si, unit.shown) if unit.step < FINEST else (1.0, unit.si)


def slider_label(joint: JointDescription) -> str:
    """Return a joint's name, with the unit of its slider if that is not SI."""
    factor, name = unit_on_page(joint.units.command)
    return joint.name if factor == 1.0 else f"{joint.name} [{name}]"


def joint_range(joint: JointDescription) -> tuple[float, float, float]:
    """Return lower end, upper end and step of a joint's slider, in its unit on the page."""
    unit = joint.units.command
    factor, _ = unit_on_page(unit)
    free = unit.reach
    lower = joint.limits.lower if math.isfinite(joint.limits.lower) else -free
    upper = joint.limits.upper if math.isfinite(joint.limits.upper) else free
    if factor == 1.0:
        return lower, upper, unit.step
    return round(lower * factor, 9), round(upper * factor, 9), round(unit.step * factor, 9)


def slider_value(joint: JointDescription, position: float) -> float:
    """Return the slider value of a joint for a command in SI, within the slider's ends and rounded."""
    lower, upper, step = joint_range(joint)
    factor, _ = unit_on_page(joint.units.command)
    return min(max(round(position * factor, 1 - round(math.log10(step))), lower), upper)


def command_of(joint: JointDescription, shown: float) -> float:
    """Return the command in SI for a slider value; at the slider's ends exactly the limits."""
    factor, _ = unit_on_page(joint.units.command)
    return joint.limits.clamp(shown / factor)


def view_file(robot: RobotDescription, view: ViewSettings) -> str:
    """Return YAML text of a scene that shows `robot` with `view`.

    It extends the scene's own file. A scene in Python cannot be extended, so the text is the section alone.
    """
    own, shown = asdict(robot.view), asdict(view)
    changed = {name: value for name, value in shown.items() if value != own[name]}
    text: dict[str, Any] = {"view": changed}
    if robot.source is not None and robot.source.suffix != ".py":
        text = {"extends": str(robot.source), **text}
    return write_overrides(text)


GREEN, AMBER, RED, GREY = "#2b8a3e", "#e67700", "#c92a2a", "#868e96"


def box(content: str) -> str:
    """Return content in a box with the panel's margins and font size."""
    return f'<div style="padding:2px 10px 6px;font-size:0.8em;line-height:1.35">{content}</div>'


def joint_bars(
    joints: Sequence[JointDescription],
    positions: Sequence[float] | None,
    targets: Sequence[float] | None,
    efforts: Sequence[float],
    enforced: bool = True,
) -> str:
    """Return a bar per joint from lower to upper limit: measured position, and a tick at the command."""
    if positions is None:
        return box("no joint states yet; is the simulator running?")
    rows = []
    for index, joint in enumerate(joints):
        lower, upper = joint.limits.lower, joint.limits.upper
        position = positions[index]
        effort = f"{efforts[index]:+.4f} {joint.units.effort}" if index < len(efforts) else ""
        within = efforts[index] if joint.by_effort and index < len(efforts) else position
        outside = not lower - 1e-6 <= within <= upper + 1e-6
        colour = AMBER if outside and enforced else "#1971c2"
        bar = ""
        if math.isfinite(lower) and math.isfinite(upper):
            share = _share(within, lower, upper)
            tick = "" if targets is None else _tick(_share(targets[index], lower, upper))
            bar = (
                '<div style="position:relative;height:8px;background:#dee2e6;border-radius:4px">'
                f'<div style="width:{share:.1f}%;height:8px;background:{colour};border-radius:4px"></div>'
                f"{tick}</div>"
                f'<div style="display:flex;justify-content:space-between;opacity:0.65;font-size:0.85em">'
                f"<span>{_short(joint, lower)}</span><span>{_short(joint, upper)}</span></div>"
            )
        rows.append(
            '<div style="display:flex;flex-wrap:wrap;justify-content:space-between;gap:0 10px">'
            f"<b>{html.escape(joint.name)}</b>"  # in a narrow panel the numbers wrap to their own line
            f"<span>{html.escape(format_position(joint, position))} &nbsp; {effort}</span></div>{bar}"
        )
    return box("".join(rows))


def _share(value: float, lower: float, upper: float) -> float:
    return 100.0 * min(1.0, max(0.0, (value - lower) / (upper - lower))) if upper > lower else 0.0


def _tick(share: float) -> str:
    place = f"position:absolute;top:-2px;left:calc({share:.1f}% - 1px)"
    return f'<div style="{place};width:2px;height:12px;background:#000"></div>'


def _short(joint: JointDescription, value: float) -> str:
    unit = joint.units.command
    return (
        f"{math.degrees(value):.0f}°"
        if joint.kind == "revolute"
        else f"{value * unit.per_si:.1f} {unit.shown}"
    )


def lamps(states: Sequence[tuple[str, str]]) -> str:
    """Return coloured lamps with their words; each state is (word, colour)."""
    lamp = (
        '<span style="white-space:nowrap;margin-right:10px"><span style="display:inline-block;width:9px;'
        'height:9px;border-radius:5px;background:{colour};margin-right:4px"></span>{word}</span>'
    )
    return box("".join(lamp.format(colour=colour, word=html.escape(word)) for word, colour in states))


def legend(title: str, marks: tuple[str, ...], colours: Sequence[tuple[int, int, int]]) -> str:
    """Return a scale as HTML: one colour for each band, and evenly spaced texts below it."""
    cells = "".join(
        f'<div style="flex:1;height:12px;background:rgb({r},{g},{b})"></div>' for r, g, b in colours
    )
    texts = "".join(f"<span>{text}</span>" for text in marks)
    return box(
        f'<b>{title}</b><div style="display:flex">{cells}</div>'
        f'<div style="display:flex;justify-content:space-between">{texts}</div>'
    )


def stress_legend(top: float, colours: Sequence[tuple[int, int, int]]) -> str:
    """Return the stress scale from 0 to `top` in [Pa]."""
    return legend("von Mises stress", ("0", pressure(top / 2), pressure(top)), colours)


def tension_legend(top: float) -> str:
    """Return the scale of the tension of cables from 0 to `top` in [N], and the colour of slack ones."""
    r, g, b = SLACK_COLOUR
    slack = f'<span style="float:right"><span style="color:rgb({r},{g},{b})">■</span> slack</span>'
    return legend(f"cable tension{slack}", ("0", f"{top / 2:g} N", f"{top:g} N"), TENSION_COLOURS)


def pressure(value: float) -> str:
    """Return a stress as text in Pa, kPa or MPa."""
    for factor, unit in ((1e6, "MPa"), (1e3, "kPa")):
        if abs(value) >= factor:
            return f"{value / factor:.3g} {unit}"
    return f"{value:.3g} Pa"


def goal_error_mm(state: RobotState) -> float | None:
    """Return the distance of the effector from its newest goal in [mm]; None without a goal."""
    if state.heard_goal is None or state.effector is None:
        return None
    return MM * math.dist(state.heard_goal.position, state.effector.position)


def progress(word: str, factor: float | None, time_s: float | None, dt: float | None) -> str:
    """Return state of the simulation, real-time factor in [-], simulated time and step in [s] as text."""
    parts = [word or "no simulator found"]
    if word and factor is not None:
        parts.append(f"{factor:.2f} × real time")
    if word and time_s is not None and dt is not None:
        parts += [f"t = {time_s:.2f} s", f"dt = {1e3 * dt:g} ms"]
    return ", ".join(parts)


def message_box(text: str, *, bad: bool = False) -> str:
    """Return a message as HTML, in red for a problem."""
    colour = f"color:{RED};font-weight:bold" if bad else ""
    return box(f'<span style="{colour}">{html.escape(text)}</span>')
