"""A calibration: which parameters are fitted to which measurements, as a file beside the data set."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
import yaml

from softsim_core.base import (
    Array,
    ConfigError,
    DataError,
    FieldError,
    SceneError,
    known_names,
    listing,
    need_finite,
    need_positive,
    write_file,
)
from softsim_core.lab.identification.description import (
    DESCRIPTION,
    DataSet,
    DataSetDescription,
    find_description,
    known_data_sets,
    load_data_set,
)
from softsim_core.lab.identification.expressions import names_in
from softsim_core.lab.identification.session import Session, load_session
from softsim_core.scene import RobotDescription
from softsim_core.scene.io import comment, given_values, read_extended, structure_description

Loss: TypeAlias = Literal["linear", "soft_l1"]

FILE = "calibration.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterDescription:
    """A parameter of the fit.

    Attributes:
        name: Name in expressions.
        start: Start value of the search.
        lower, upper: Bounds.
        unit: Unit of these values, for display.
        prior: Standard deviation of prior knowledge around `start`; None: there is none.
        per_session: Whether each session has its own value; otherwise all sessions share one.
    """

    name: str
    start: float
    lower: float
    upper: float
    unit: str = ""
    prior: float | None = None
    per_session: bool = False

    def __post_init__(self) -> None:
        owner = f"parameter {self.name}"
        if not self.name.isidentifier():
            raise FieldError(owner, "name", repr(self.name), "a word of letters, digits and _")
        need_finite(owner, "bounds and start", (self.lower, self.start, self.upper))
        if not self.lower < self.upper:
            raise FieldError(owner, "lower", self.lower, f"less than upper, {self.upper:g}")
        if not self.lower <= self.start <= self.upper:
            raise FieldError(owner, "start", self.start, f"between {self.lower:g} and {self.upper:g}")
        if self.prior is not None:
            need_positive(owner, "prior", self.prior, self.unit)

    @property
    def span(self) -> float:
        """Difference between the bounds."""
        return self.upper - self.lower


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationDescription:
    """Description of a calibration: parameters, measurements and search.

    Attributes:
        name: Name in messages.
        data_set: The measurements: a name, or a folder relative to the description.
        parameters: The parameters of the fit.
        overlay: Overrides of the robot's file, with expressions where a parameter acts; see expressions.
        robot: The model: a name or a file; None: the robot of the data set.
        sessions: Names of the sessions to use; empty: all that can be replayed.
        every: Use only each N-th of the training rows of each session.
        loss: "linear" is least squares; "soft_l1" reduces the influence of outliers.
        scale_mm: Error in [mm] beyond which a point counts as an outlier.
        starts: Number of starts of the search: `start`, then points spread evenly between the bounds.
        seed: Seed of these points.
    """

    name: str
    data_set: str
    parameters: tuple[ParameterDescription, ...]
    overlay: dict[str, Any]
    robot: str | None = None
    sessions: tuple[str, ...] = ()
    every: int = 1
    loss: Loss = "linear"
    scale_mm: float = 1.0
    starts: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        owner, names = f"calibration {self.name}", [each.name for each in self.parameters]
        if not names or len(set(names)) != len(names):
            raise SceneError(f"{owner}: give one parameter or more, each with its own name")
        used = names_in(self.overlay)
        for name in used - set(names):
            raise SceneError(
                f"{owner}: the overlay names {name!r}; {known_names(name, names, 'the parameters are')}"
            )
        for name in names:
            if name not in used:
                raise SceneError(f"{owner}: parameter {name} stands nowhere in the overlay; use or remove it")
        if self.loss not in get_args(Loss):
            raise FieldError(owner, "loss", repr(self.loss), f"one of {listing(get_args(Loss))}")
        need_positive(owner, "scale_mm", self.scale_mm, "mm")
        for field in ("every", "starts"):
            if getattr(self, field) < 1:
                raise FieldError(owner, field, getattr(self, field), ">= 1")


def calibration_sessions(description: CalibrationDescription, data: DataSet) -> list[Session]:
    """Return the training rows of the requested sessions.

    Raises:
        DataError: a session does not exist, or its rows cannot be used.
    """
    there = [each for each in data.description.sessions if each.replayed]
    names = tuple(each.name for each in there)
    for name in description.sessions:
        if name not in names:
            raise DataError(
                f"calibration {description.name}",
                "",
                f"no session {name!r} to replay; {known_names(name, names, 'there are')}",
            )
    chosen = [each for each in there if not description.sessions or each.name in description.sessions]
    return [_training_rows(load_session(data, each)) for each in chosen]


def _training_rows(session: Session) -> Session:
    """Return the session without the rows that are not fitted, because no equilibria are needed for them.

    Where the release is unknown, no delay is fitted: the phase of the oscillation is free.
    """
    time = session.description.time
    if time is not None and time.release == "unknown":
        return replace(session, description=replace(session.description, time=replace(time, most_delay=0.0)))
    if session.times is not None:
        return session
    return session.part(np.flatnonzero(session.fitting))


def load_calibration(name_or_path: str | Path) -> tuple[CalibrationDescription, Path]:
    """Load a calibration by the name of its data set or by its path; return it with its file.

    Raises:
        ConfigError: nothing found, or any problem in the description, as one message.
    """
    text, calibrations = str(name_or_path), known_calibrations()
    file = find_description(text, FILE, calibrations)
    if file is None:
        raise ConfigError(
            text, "", f"no such file, and no calibration of that name; {known_names(text, calibrations)}"
        )
    return structure_description(read_extended(file), CalibrationDescription, file, find_files=False), file


def known_calibrations() -> dict[str, Path]:
    """Return the calibration files beside all data sets that are known by name."""
    beside = {name: file.parent / FILE for name, file in known_data_sets().items()}
    return {name: file.absolute() for name, file in beside.items() if file.is_file()}


def data_of(description: CalibrationDescription, file: Path, data: Path | None) -> DataSet:
    """Load the data set of a calibration in `file`; see load_data_set for `data`."""
    beside = file.parent / description.data_set
    return load_data_set(str(beside) if beside.is_dir() else description.data_set, data)


ZERO: Final = 0.15
"""Search range of a servo's zero to both sides in [rad]."""

TIMES: Final = 3.0
"""The search range of Young modulus and damping is their value divided and multiplied by this."""


def write_table(file: Path, columns: Mapping[str, Array], notes: Sequence[str] = ()) -> None:
    """Write a CSV file with notes as comments, a header line and rows of columns (k,); replaces the file."""
    head = comment(*notes) + ",".join(columns)
    rows = np.column_stack(list(columns.values()))
    text = io.StringIO()
    np.savetxt(text, rows, "%.9g", ",", header=head, comments="")
    write_file(file, text.getvalue())


def write_description(folder: Path, description: DataSetDescription) -> Path:
    """Write a description as the data set's dataset.yaml, without default values, and return the file."""
    return write_file(folder / DESCRIPTION, _yaml(given_values(description)))


def write_calibration(folder: Path, calibration: CalibrationDescription) -> Path:
    """Write a calibration as calibration.yaml beside its data set, and return the file."""
    return write_file(folder / FILE, _yaml(given_values(calibration)))


def first_calibration(
    name: str, robot: RobotDescription, sessions: Sequence[str], in_time: bool
) -> CalibrationDescription | None:
    """Return a calibration to begin with: servo zeros and stiffness; for sessions in time also the damping.

    At prescribed angles, only the weight reveals the stiffness. Means over poses at rest determine it better
    than noisy readings in time. None: this robot has no such parameters.
    """
    parameters: list[ParameterDescription] = []
    overlay: dict[str, Any] = {}
    for k, joint in enumerate(robot.joints):
        if joint.kind == "revolute" and joint.parent is None:
            zero = ParameterDescription(name=f"zero_{k}", start=0.0, lower=-ZERO, upper=ZERO, unit="rad")
            parameters.append(zero)
            drawn_at = f"{joint.rest!r} " if joint.rest else ""
            rest = {"name": joint.name, "rest": f"= {drawn_at}- {zero.name}"}
            overlay.setdefault("joints", []).append(rest)
    alike = [each for each in robot.scene.bodies if each.material == robot.scene.bodies[0].material]
    values = alike[0].material.values if alike else {}
    stiffer = {}
    if "young_modulus" in values:
        parameters.append(_describe_parameter("young", 1e-3 * values["young_modulus"], "kPa"))
        stiffer = {"young_modulus": "= 1e3 * young"}
    elif "stiffness_factor" in values:
        parameters.append(_describe_parameter("stiffness", values["stiffness_factor"], ""))
        stiffer = {"stiffness_factor": "= stiffness"}
    if stiffer:
        overlay["bodies"] = [{"name": each.name, "material": dict(stiffer)} for each in alike]
    if in_time and robot.scene.solver.rayleigh_stiffness > 0.0:
        parameters.append(_describe_parameter("damping", 1e3 * robot.scene.solver.rayleigh_stiffness, "ms"))
        overlay["solver"] = {"rayleigh_stiffness": "= 1e-3 * damping"}
    if not parameters:
        return None
    return CalibrationDescription(
        name=name, data_set=".", parameters=tuple(parameters), overlay=overlay, sessions=tuple(sessions)
    )


def _describe_parameter(name: str, start: float, unit: str) -> ParameterDescription:
    lower, start, upper = (float(f"{start * part:.5g}") for part in (1.0 / TIMES, 1.0, TIMES))
    return ParameterDescription(name=name, start=start, lower=lower, upper=upper, unit=unit)


def _yaml(data: dict[str, Any]) -> str:
    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100, allow_unicode=True))
