"""Write docs/tutorials/reference.md from the docstrings of the parts and of the sections of a scene.

From the checkout: `.softsim/venv/bin/python docs/tutorials/reference.py`.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parents[1]))

import softsim_core as core  # noqa: E402
from softsim_core.robots import gripper_parts, parts  # noqa: E402

PARTS: tuple[Callable[..., Any], ...] = (
    parts.servo,
    parts.WheelSpring,
    parts.actuated_arm,
    parts.elastic_body,
    parts.fixing_box,
    parts.tripod_silicone,
    parts.tripod,
    parts.ServoCircle,
    parts.move_all,
    gripper_parts.cable_finger,
    gripper_parts.cable_gripper,
    gripper_parts.rigid_thing,
)
SECTIONS: tuple[tuple[str, type], ...] = (
    ("bodies", core.BodyDescription),
    ("material", core.MaterialDescription),
    ("joints", core.JointDescription),
    ("limits", core.JointLimits),
    ("cable", core.CableDescription),
    ("chamber", core.ChamberDescription),
    ("layers", core.LayerDescription),
    ("regions", core.MaterialRegionDescription),
    ("fibres", core.FibresDescription),
    ("attachments", core.AttachmentDescription),
    ("rigid_bodies", core.RigidBodyDescription),
    ("shape", core.Shape),
    ("collisions", core.CollisionDescription),
    ("contact", core.ContactSettings),
    ("placement, base, frame, pose", core.Placement),
    ("solver", core.SolverSettings),
    ("sensors", core.SimulatedSensorDescription),
    ("sensors, kind: wrench", core.WrenchSensorDescription),
    ("sensors, kind: force_torque", core.ForceTorqueDescription),
    ("sensors, kind: tactile", core.TactileArrayDescription),
    ("sensors, kind: strain", core.StrainSensorDescription),
    ("sensors, kind: imu", core.ImuDescription),
    ("sensors, kind: markers", core.MarkersDescription),
    ("sensors, kind: cable", core.CableSensorDescription),
    ("sensors, kind: chamber", core.ChamberSensorDescription),
    ("arm", core.ArmDescription),
    ("arm.tools", core.ToolDescription),
    ("commands", core.CommandSettings),
    ("start", core.StartAnimation),
    ("keys", core.KeyBinding),
    ("inverse", core.InverseSettings),
    ("board", core.BoardDescription),
    ("servos", core.ServoCalibration),
    ("servos on a bus", core.BusServo),
    ("view", core.ViewSettings),
    ("camera", core.Camera),
)
HEAD = """# Parts and sections

Made from the program's own descriptions by [reference.py](reference.py).

**Parts** are functions for Python scenes: `scene.add(PART(...))`, as often as wanted. **Sections**
are the keys of a scene in YAML and, under the names in brackets, classes for Python scenes. SI
units; angles of placements in degrees. Scenes that show a part alone:
[configs/scenes/parts](../../configs/scenes/parts/servo.py), for example `./softsim up parts/servo`.
"""


def entry(title: str, thing: Callable[..., Any]) -> str:
    """A heading, a summary and one row a parameter, with its default."""
    text = inspect.cleandoc(thing.__doc__ or "")
    summary = re.split(r"\n\n(?=Args|Attributes|Raises|Source|Returns)", text)[0]
    summary = " ".join(summary.split())
    rows = []
    defaults = inspect.signature(thing).parameters
    for described, words in _described(text):
        names = [name for name in described if name in defaults or name == "kind"]
        if not names:  # an attribute of the class, which no scene sets
            continue
        shown = ", ".join(f"`{name}`" for name in names)
        values = [_default(defaults[name]) for name in names if name in defaults]
        value = ", ".join(dict.fromkeys(filter(None, values)))
        rows.append(f"| {shown} | {value} | {words} |")
    table = "\n".join(["| name | default | |", "|---|---|---|", *rows]) if rows else ""
    return "\n\n".join(filter(None, (f"### {title}", summary, table)))


def _default(parameter: inspect.Parameter) -> str:
    text = repr(parameter.default)
    told = parameter.default is not inspect.Parameter.empty and len(text) <= 40 and "<" not in text
    return f"`{text}`" if told else ""


def _described(text: str) -> list[tuple[list[str], str]]:
    """Names and words of each item under Args or Attributes."""
    match = re.search(r"^(?:Args|Attributes):\n((?:    .*\n?|\n)*)", text, re.MULTILINE)
    if match is None:
        return []
    items = re.split(r"\n    (?=\S)", "\n" + match[1].rstrip())[1:]
    pairs = [item.split(":", 1) for item in items if ":" in item]
    return [(names.split(", "), " ".join(words.split()).replace("|", "\\|")) for names, words in pairs]


def page() -> str:
    """The whole page."""
    blocks = [HEAD, "## Parts"]
    blocks += [entry(f"`{part.__name__}`", part) for part in PARTS]
    blocks.append("## Sections")
    blocks += [entry(f"`{key}` ({section.__name__})", section) for key, section in SECTIONS]
    return "\n\n".join(block.strip() for block in blocks) + "\n"


if __name__ == "__main__":
    (FOLDER / "reference.md").write_text(page(), encoding="utf-8")
