"""A data set as files: tables as CSV, the description as dataset.yaml, and a calibration to begin with."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from softsim_core.arrays import Array
from softsim_core.file_writing import write_file
from softsim_core.identification.calibration import (
    FILE,
    CalibrationDescription,
    ParameterDescription,
)
from softsim_core.identification.description import DataSetDescription
from softsim_core.identification.files import DESCRIPTION
from softsim_core.scene.generated import comment
from softsim_core.scene.robot import RobotDescription

ZERO: Final = 0.15
"""A servo's zero is sought so far to both sides, in [rad]."""

TIMES: Final = 3.0
"""Young modulus and damping are sought between their values divided and multiplied by this."""


def write_table(file: Path, columns: Mapping[str, Array], notes: Sequence[str] = ()) -> None:
    """A CSV file with a header line below comments.

    Args:
        file: The file, which is replaced.
        columns: Numbers by name, each of shape (k,).
        notes: Comments.
    """
    head = comment(*notes) + ",".join(columns)
    rows = np.column_stack(list(columns.values()))
    text = io.StringIO()
    np.savetxt(text, rows, "%.9g", ",", header=head, comments="")
    write_file(file, text.getvalue())


def write_description(folder: Path, description: DataSetDescription) -> Path:
    """The description of a data set as its dataset.yaml, without what is as by default; returns the file."""
    return write_file(folder / DESCRIPTION, _yaml(plain(description)))


def write_calibration(folder: Path, calibration: CalibrationDescription) -> Path:
    """A calibration beside its data set, as its calibration.yaml; returns the file."""
    return write_file(folder / FILE, _yaml(plain(calibration)))


def first_calibration(
    name: str, robot: RobotDescription, sessions: Sequence[str], in_time: bool
) -> CalibrationDescription | None:
    """What one may begin with: zeros of the servos and the stiffness; in time, the damping, too.

    At imposed angles the stiffness shows by the weight alone: readings that are means of poses tell it better
    than noisy ones in time.

    Args:
        name: Of the calibration.
        robot: The robot as it is described.
        sessions: Names of the sessions that are fitted.
        in_time: Whether they are measured in time.

    Returns:
        None: nothing of this robot is sought so.
    """
    wanted: list[ParameterDescription] = []
    overlay: dict[str, Any] = {}
    for k, joint in enumerate(robot.joints):
        if joint.kind == "revolute" and joint.parent is None:
            zero = ParameterDescription(name=f"zero_{k}", start=0.0, lower=-ZERO, upper=ZERO, unit="rad")
            wanted.append(zero)
            drawn_at = f"{joint.rest!r} " if joint.rest else ""
            rest = {"name": joint.name, "rest": f"= {drawn_at}- {zero.name}"}
            overlay.setdefault("joints", []).append(rest)
    alike = [each for each in robot.scene.bodies if each.material == robot.scene.bodies[0].material]
    values = alike[0].material.values if alike else {}
    stiffer = {}
    if "young_modulus" in values:
        wanted.append(_scaled("young", 1e-3 * values["young_modulus"], "kPa"))
        stiffer = {"young_modulus": "= 1e3 * young"}
    elif "stiffness_factor" in values:
        wanted.append(_scaled("stiffness", values["stiffness_factor"], ""))
        stiffer = {"stiffness_factor": "= stiffness"}
    if stiffer:
        overlay["bodies"] = [{"name": each.name, "material": dict(stiffer)} for each in alike]
    if in_time and robot.scene.solver.rayleigh_stiffness > 0.0:
        wanted.append(_scaled("damping", 1e3 * robot.scene.solver.rayleigh_stiffness, "ms"))
        overlay["solver"] = {"rayleigh_stiffness": "= 1e-3 * damping"}
    if not wanted:
        return None
    return CalibrationDescription(
        name=name, data_set=".", parameters=tuple(wanted), overlay=overlay, sessions=tuple(sessions)
    )


def _scaled(name: str, start: float, unit: str) -> ParameterDescription:
    lower, start, upper = (float(f"{start * part:.5g}") for part in (1.0 / TIMES, 1.0, TIMES))
    return ParameterDescription(name=name, start=start, lower=lower, upper=upper, unit=unit)


def plain(value: Any) -> Any:
    """A description as plain data, in the form of its file: what is as by default is left out."""
    if is_dataclass(value) and not isinstance(value, type):
        data = {}
        for each in fields(value):
            held = getattr(value, each.name)
            usual = each.default_factory() if each.default_factory is not MISSING else each.default
            if usual is MISSING or held != usual:
                data[each.name] = plain(held)
        return data
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def _yaml(data: dict[str, Any]) -> str:
    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100, allow_unicode=True))
