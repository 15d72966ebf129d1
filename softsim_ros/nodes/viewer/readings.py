"""Numbers for a person as HTML, the units of joints, and what can be shown."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

from softsim_core.base.units import Unit
from softsim_core.scene.io.yaml_loader import write_overrides
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.view import ViewSettings
from softsim_ros.client.joints import format_position
from softsim_ros.client.state import RobotState
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
    "chambers": "Pressure chambers",
    "contacts": "Contacts and forces",
    "rigid": "Rigid bodies",
    "collisions": "Collision surfaces",
    "search_boxes": "Boxes of the contact search",
}


FINEST: Final = 1.0e-6
"""Steps of SI below this cannot be read on the page; the unit for people takes its place."""


def unit_on_page(unit: Unit) -> tuple[float, str]:
    """How many of the unit of sliders and curves are one of SI, and its name: SI, but ml for volumes."""
    return (unit.per_si, unit.shown) if unit.step < FINEST else (1.0, unit.si)


def slider_label(joint: JointDescription) -> str:
    """A joint's name, with the unit of its slider where that is not of SI."""
    factor, name = unit_on_page(joint.units.command)
    return joint.name if factor == 1.0 else f"{joint.name} [{name}]"


def joint_range(joint: JointDescription) -> tuple[float, float, float]:
    """Lower end, upper end and step of a joint's slider, in its unit on the page."""
    unit = joint.units.command
    factor, _ = unit_on_page(unit)
    free = unit.reach
    lower = joint.limits.lower if math.isfinite(joint.limits.lower) else -free
    upper = joint.limits.upper if math.isfinite(joint.limits.upper) else free
    if factor == 1.0:
        return lower, upper, unit.step
    return round(lower * factor, 9), round(upper * factor, 9), round(unit.step * factor, 9)


def slider_value(joint: JointDescription, position: float) -> float:
    """What a joint's slider shows for a command in SI: within its ends, without idle digits."""
    lower, upper, step = joint_range(joint)
    factor, _ = unit_on_page(joint.units.command)
    return min(max(round(position * factor, 1 - round(math.log10(step))), lower), upper)


def command_of(joint: JointDescription, shown: float) -> float:
    """The command in SI for what a joint's slider shows; at its ends the limits, to the last digit."""
    factor, _ = unit_on_page(joint.units.command)
    return joint.limits.clamp(shown / factor)


def view_file(robot: RobotDescription, view: ViewSettings) -> str:
    """YAML text of a scene that shows `scene` with `view`.

    It extends the scene's own file; one in Python cannot be extended, and the text is the section alone.
    """
    own, shown = asdict(robot.view), asdict(view)
    changed = {name: value for name, value in shown.items() if value != own[name]}
    text: dict[str, Any] = {"view": changed}
    if robot.source is not None and robot.source.suffix != ".py":
        text = {"extends": str(robot.source), **text}
    return write_overrides(text)


GREEN, AMBER, RED, GREY = "#2b8a3e", "#e67700", "#c92a2a", "#868e96"


def box(content: str) -> str:
    """Content with the panel's margins and size of type."""
    return f'<div style="padding:2px 10px 6px;font-size:0.8em;line-height:1.35">{content}</div>'


def joint_bars(
    joints: Sequence[JointDescription],
    positions: Sequence[float] | None,
    targets: Sequence[float] | None,
    efforts: Sequence[float],
    enforced: bool = True,
) -> str:
    """A bar for each joint from its lower to its upper limit: measured position, a tick for its command."""
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
            f"<b>{html.escape(joint.name)}</b>"  # in a narrow panel the numbers take a line of their own
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
    """Coloured lamps with their words: (word, colour) each."""
    lamp = (
        '<span style="white-space:nowrap;margin-right:10px"><span style="display:inline-block;width:9px;'
        'height:9px;border-radius:5px;background:{colour};margin-right:4px"></span>{word}</span>'
    )
    return box("".join(lamp.format(colour=colour, word=html.escape(word)) for word, colour in states))


def legend(highest: float, colours: Sequence[tuple[int, int, int]]) -> str:
    """The stress scale from 0 to `highest` in [Pa], a colour for each band."""
    cells = "".join(
        f'<div style="flex:1;height:12px;background:rgb({r},{g},{b})"></div>' for r, g, b in colours
    )
    return box(
        f'<b>von Mises stress</b><div style="display:flex">{cells}</div>'
        '<div style="display:flex;justify-content:space-between"><span>0</span>'
        f"<span>{pressure(highest / 2)}</span><span>{pressure(highest)}</span></div>"
    )


def pressure(value: float) -> str:
    """A stress for a person: Pa, kPa or MPa."""
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
    """State of the simulation in its own word, real-time factor in [-], simulated time and step in [s]."""
    parts = [word or "no simulator heard"]
    if word and factor is not None:
        parts.append(f"{factor:.2f} × real time")
    if word and time_s is not None and dt is not None:
        parts += [f"t = {time_s:.2f} s", f"dt = {1e3 * dt:g} ms"]
    return ", ".join(parts)


def sentence(text: str, *, bad: bool = False) -> str:
    """One sentence, in red where it is bad news."""
    colour = f"color:{RED};font-weight:bold" if bad else ""
    return box(f'<span style="{colour}">{html.escape(text)}</span>')
