"""Data sets: where they are, and their descriptions: robot, commands, columns with their units.

Columns are in the units of their files; all arrays made from them are in SI. Lengths in a description are in
[m]. Error limits are in [mm], the unit in which they are usually stated.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from softsim_core.base import (
    SCALES,
    ConfigError,
    DataError,
    FieldError,
    Quantity,
    SceneError,
    Vector,
    known_names,
    listing,
    need_finite,
)
from softsim_core.scene.io import config_roots, read_extended, structure_description

Axis: TypeAlias = Literal["x", "-x", "y", "-y", "z", "-z"]

EFFECTOR: Final = "effector"
DESCRIPTION: Final = "dataset.yaml"
FOLDER: Final = "datasets"
"""Folder below each config root that contains the data sets known by name."""


def _need_unit_of(owner: str, unit: str, quantities: tuple[Quantity, ...]) -> None:
    units = [name for name, scale in SCALES.items() if scale.quantity in quantities]
    if unit not in units:
        raise FieldError(owner, "unit", repr(unit), f"one of {listing(units)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DataFolder:
    """Folder of the measured files.

    Attributes:
        folder: Relative to the description, or absolute.
        variable: Environment variable that names the parent of `folder`, in place of the description's
            folder, for data that are not distributed with their description. None: there is none.
    """

    folder: Path = Path()
    variable: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandColumns:
    """Columns of the joint commands.

    Attributes:
        columns: One per joint.
        unit: Unit of all columns: of an angle, a length, a force, a pressure or a volume; or SI, the unit of
            each joint.
        joints: Names of the commanded joints; empty: all of the robot's, in its order. Other joints stay at
            their rest position.
    """

    columns: tuple[str, ...]
    unit: str = "rad"
    joints: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _need_unit_of("commands", self.unit, ("angle", "length", "force", "pressure", "volume", "own"))
        if self.joints and len(self.joints) != len(self.columns):
            raise SceneError(f"commands: {len(self.columns)} columns for {len(self.joints)} joints")
        if len(set(self.columns)) != len(self.columns):
            raise SceneError("commands: a column stands for two joints; give each its own")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDescription:
    """A point whose position was measured.

    Attributes:
        name: Unique in its session.
        columns: Columns of x, y and z in the frame of the data.
        unit: Unit of the columns: m, cm or mm.
        at: Part that carries the sensor: "effector", or a frame of the robot by its name; not with `place`.
        place: A point in or on a deformable body at rest, in [m] in the robot's frame, that carries the
            sensor.
        patch: Radius in [m]: the nodes within it around `place` determine the rotation of the body there.
        offset: Offset of the sensor from frame or place in [m], along the axes of the frame; at a place,
            along the axes of the robot at rest. It rotates with frame or body.
        displacement: Compare the displacement from the initial position, which is the position up to time 0.
    """

    name: str
    columns: tuple[str, str, str]
    unit: str = "m"
    at: str = EFFECTOR
    place: Vector | None = None
    patch: float = 0.01
    offset: Vector = (0.0, 0.0, 0.0)
    displacement: bool = False

    def __post_init__(self) -> None:
        owner = f"sensor {self.name}"
        _need_unit_of(owner, self.unit, ("length",))
        need_finite(owner, "offset", self.offset)
        if self.place is not None:
            need_finite(owner, "place", self.place)
        if not 0.0 < self.patch < math.inf:
            raise FieldError(owner, "patch", self.patch, "> 0 m")
        if len(set(self.columns)) != 3:
            raise FieldError(owner, "columns", list(self.columns), "three different columns")


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherModel:
    """Predictions of another model for a sensor, reported beside those of this model.

    Attributes:
        name: Name in the report.
        columns: Columns of x, y and z in the frame of the data.
        unit: Unit of the columns: m, cm or mm.
        sensor: Name of the sensor; None: the only one.
    """

    name: str
    columns: tuple[str, str, str]
    unit: str = "m"
    sensor: str | None = None

    def __post_init__(self) -> None:
        _need_unit_of(f"model {self.name}", self.unit, ("length",))


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeColumn:
    """Column with the time of each row.

    Attributes:
        column: The column.
        unit: s, ms or us.
        first, last: Errors are reported for rows from `first` to `last` in [s]; None: for all from 0 on.
        start: "equilibrium": the model starts at rest under the first commands; "rest": it starts in its rest
            shape, as a body that was clamped and is released at time 0.
        release: "known": a body that starts in its rest shape is released instantly at time 0; "unknown": it
            is released by a hand, and a calibration ignores amplitude and phase of its oscillation.
        most_delay: Largest delay of the sensors that is fitted, to both sides, in [s]; 0: no delay is fitted.
    """

    column: str
    unit: str = "s"
    first: float = 0.0
    last: float | None = None
    start: Literal["equilibrium", "rest"] = "equilibrium"
    release: Literal["known", "unknown"] = "known"
    most_delay: float = 0.0

    def __post_init__(self) -> None:
        _need_unit_of("time", self.unit, ("time",))
        if not 0.0 <= self.first < math.inf:
            raise FieldError("time", "first", self.first, ">= 0 s")
        if self.last is not None and not self.first < self.last < math.inf:
            raise FieldError("time", "last", self.last, f"> first = {self.first:g} s")
        if self.release == "unknown" and self.start != "rest":
            raise FieldError("time", "release", repr(self.release), "known, or give start: rest")
        if not 0.0 <= self.most_delay < math.inf:
            raise FieldError("time", "most_delay", self.most_delay, ">= 0 s")


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameDescription:
    """Known pose of the data's frame in the robot's frame.

    Attributes:
        axes: The axes of the data that are x, y and z of the robot: [x, -z, y] for data with y up.
        origin: Origin of the robot in the frame of the data, in [m].
    """

    axes: tuple[Axis, Axis, Axis] = ("x", "y", "z")
    origin: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        need_finite("frame", "origin", self.origin)
        if {axis[-1] for axis in self.axes} != {"x", "y", "z"}:
            raise FieldError(
                "frame", "axes", list(self.axes), "x, y and z, each once, with or without a minus"
            )
        columns = ["xyz".index(axis[-1]) for axis in self.axes]
        turns = (columns[1] - columns[0]) % 3 == 1
        if turns == bool(sum(axis[0] == "-" for axis in self.axes) % 2):
            raise FieldError("frame", "axes", list(self.axes), "right-handed; this mirrors the data")


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentDescription:
    """Unknowns of a session's sensors that are fitted to its training rows.

    Attributes:
        frame: Fit rotation and shift of the data's frame.
        point: Fit the offset of each sensor in the part that carries it.
    """

    frame: bool = False
    point: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitDescription:
    """Division into training rows and held-out rows, by a column, by files, or by a share.

    Attributes:
        column: Rows where it is 0 are for training, the others are held out.
        values: Instead of 0: rows where the column has one of these numbers are held out, the others are for
            training.
        files: Files of the session whose rows are held out.
        held_out_share: Part of the rows that is held out at random, in (0, 1).
        seed: Seed of that choice.
    """

    column: str | None = None
    values: tuple[float, ...] = ()
    files: tuple[Path, ...] = ()
    held_out_share: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.column is not None) + bool(self.files) + (self.held_out_share is not None) != 1:
            raise SceneError("split: give exactly one of column, files and held_out_share")
        if self.values and self.column is None:
            raise SceneError("split: values need the column that has them")
        if self.held_out_share is not None and not 0.0 < self.held_out_share < 1.0:
            raise FieldError("split", "held_out_share", self.held_out_share, "between 0 and 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorLimits:
    """Largest errors in [mm] that pass, of the held-out rows where there are any. None: any error passes."""

    mean_mm: float | None = None
    rms_mm: float | None = None
    p95_mm: float | None = None
    max_mm: float | None = None

    def __post_init__(self) -> None:
        for name in ("mean_mm", "rms_mm", "p95_mm", "max_mm"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise FieldError("limits", name, value, "> 0 mm")


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionDescription:
    """Rows measured in one go, with sensors whose mounting did not change.

    Attributes:
        name: Unique name.
        file: Table in the data folder: CSV, or a recording (MCAP).
        further: Further tables with rows of the same run and the same columns.
        order: Column of numbers by which the rows of all tables are sorted; None: they stay as they are.
        commands: The commands; None: they are unknown, or the robot has no joints.
        sensors: The measured points.
        others: Predictions of other models.
        time: Time of the rows; None: each row is an equilibrium of its own.
        suspect: Column that is not 0 in rows to exclude from fits and errors.
        within: Smallest and largest number by column; other rows are not read, such as those of loads beyond
            the model.
        split: Division of the rows; None: all rows are for training.
        frame, alignment, limits: See these classes.
        overrides: Overrides of the scene, such as an attached load; see load_scene.
        replayed: False: only other models are compared, because the commands are unknown.
        note: Note for the reader of the report.
    """

    name: str
    file: Path
    sensors: tuple[SensorDescription, ...]
    further: tuple[Path, ...] = ()
    order: str | None = None
    commands: CommandColumns | None = None
    others: tuple[OtherModel, ...] = ()
    time: TimeColumn | None = None
    suspect: str | None = None
    within: dict[str, tuple[float, float]] = field(default_factory=dict)
    split: SplitDescription | None = None
    frame: FrameDescription = FrameDescription()
    alignment: AlignmentDescription = AlignmentDescription()
    limits: ErrorLimits = ErrorLimits()
    overrides: dict[str, Any] = field(default_factory=dict)
    replayed: bool = True
    note: str = ""

    def __post_init__(self) -> None:
        owner = f"session {self.name}"
        names = [sensor.name for sensor in self.sensors]
        if not names or len(set(names)) != len(names):
            raise SceneError(f"{owner}: give one sensor or more, each with its own name")
        for other in self.others:
            if other.sensor is None and len(names) > 1:
                raise SceneError(f"{owner}: model {other.name} must name its sensor: {listing(names)}")
            if other.sensor is not None and other.sensor not in names:
                raise SceneError(
                    f"{owner}: unknown sensor {other.sensor!r}; {known_names(other.sensor, names)}"
                )
        for file in self.split.files if self.split is not None else ():
            if file not in self.files:
                raise SceneError(
                    f"{owner}: split names {file}, which is not among its files {listing(self.files)}"
                )
        for column, (low, high) in self.within.items():
            if not low <= high:
                raise FieldError(owner, f"within.{column}", [low, high], "smallest and largest number")
        if self.time is None and any(sensor.displacement for sensor in self.sensors):
            raise SceneError(f"{owner}: displacement needs a time column: the rows up to time 0 are its zero")
        taken: dict[str, str] = {}
        used = [(f"sensor {each.name}", column) for each in self.sensors for column in each.columns]
        used += [("a command", column) for column in (self.commands.columns if self.commands else ())]
        for what, column in used:
            if column in taken:
                raise SceneError(
                    f"{owner}: column {column} is {taken[column]} and {what}; it can be one thing"
                )
            taken[column] = what

    @property
    def files(self) -> tuple[Path, ...]:
        """All tables."""
        return (self.file, *self.further)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors, in order."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def fitted_numbers(self) -> int:
        """Count of fitted numbers: frame, sensor points, delay and release."""
        delay = self.time is not None and self.time.most_delay > 0.0
        release = 2 * (self.time is not None and self.time.release == "unknown")
        return 6 * self.alignment.frame + 3 * self.alignment.point * len(self.sensors) + delay + release


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelDescription:
    """A model of the measured robot.

    Attributes:
        robot: Robot or scene: a name, or a file relative to the description.
        parameters: Number of its parameters that were identified from these measurements.
        note: Rows to which they were fitted.
    """

    robot: str
    parameters: int = 0
    note: str = ""

    def __post_init__(self) -> None:
        if self.parameters < 0:
            raise FieldError(f"model {self.robot}", "parameters", self.parameters, "0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedError:
    """Error of another model as others published it, with the rows as they chose them.

    Attributes:
        model: Name of the model.
        mean_mm, rms_mm: Mean and root mean square of the error lengths in [mm]; None: not published.
        note: Rows, and what was fitted to them.
    """

    model: str
    mean_mm: float | None = None
    rms_mm: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        for name in ("mean_mm", "rms_mm"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise FieldError(f"published {self.model}", name, value, ">= 0 mm")
        if self.mean_mm is None and self.rms_mm is None:
            raise SceneError(f"published {self.model}: give mean_mm, rms_mm or both")


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSetDescription:
    """Measurements of one robot.

    Attributes:
        name: Name in messages.
        robot: The measured robot or scene: a name, or a file relative to the description.
        sessions: The sessions.
        about: Description in one sentence.
        source: Who measured the data, and where they are published.
        licence: Licence of the data.
        data: Folder of the files.
        length: Length of the robot in [m], to which a league relates errors; None: it does not.
        models: Models of the robot, for a league; empty: only `robot`.
        published: Errors of other models, for a league.
        unknown: What the data leave unknown, for a league.
    """

    name: str
    robot: str
    sessions: tuple[SessionDescription, ...]
    about: str = ""
    source: str = ""
    licence: str = ""
    data: DataFolder = DataFolder()
    length: float | None = None
    models: tuple[ModelDescription, ...] = ()
    published: tuple[PublishedError, ...] = ()
    unknown: str = ""

    def __post_init__(self) -> None:
        if self.length is not None and not 0.0 < self.length < math.inf:
            raise FieldError(f"data set {self.name}", "length", self.length, "> 0 m")
        names = [session.name for session in self.sessions]
        if not names or len(set(names)) != len(names):
            raise SceneError(f"data set {self.name}: give one session or more, each with its own name")

    @property
    def session_names(self) -> tuple[str, ...]:
        """Names of the sessions, in order."""
        return tuple(session.name for session in self.sessions)


@dataclass(frozen=True, slots=True)
class DataSet:
    """A data set's description and its location.

    Attributes:
        description: The description.
        file: Its dataset.yaml.
        folder: Folder of its tables.
    """

    description: DataSetDescription
    file: Path
    folder: Path

    def tables_of(self, session: SessionDescription) -> list[Path]:
        """Return the files of a session.

        Raises:
            DataError: a file does not exist.
        """
        files = [self.folder / each for each in session.files]
        file = next((each for each in files if not each.exists()), None)
        if file is None:
            return files
        description, variable = self.description, self.description.data.variable
        how = f", or set {variable} to it" if variable else ""
        where = (
            f". They come from: {description.source} (licence: {description.licence or 'not stated'})"
            if description.source
            else ""
        )
        raise DataError(
            f"session {session.name}",
            "",
            f"no file {file}; name the folder of the data (--data DIR){how}{where}",
        )

    @property
    def robot(self) -> str:
        """Name or file of the measured robot."""
        return self.model_file(self.description.robot)

    def model_file(self, robot: str) -> str:
        """Return the file of a robot beside the description, or its name where there is none."""
        beside = self.file.parent / robot
        return str(beside) if beside.is_file() else robot


def known_data_sets() -> dict[str, Path]:
    """Return names and descriptions of the data sets below the config roots, sorted by name."""
    data_sets: dict[str, Path] = {}
    for root in config_roots():
        for file in (root / FOLDER).glob(f"*/{DESCRIPTION}"):
            data_sets.setdefault(file.parent.name, file)
    return dict(sorted(data_sets.items()))


def load_data_set(name_or_path: str | os.PathLike[str], data: Path | None = None) -> DataSet:
    """Load a data set by the name of its folder, or by the path of the folder or of its dataset.yaml.

    Args:
        name_or_path: Name or path.
        data: Folder of the tables; None: as given by the description and its environment variable.

    Raises:
        ConfigError: nothing found, or any problem in the description, as one message.
    """
    text, data_sets = os.fspath(name_or_path), known_data_sets()
    file = find_description(text, DESCRIPTION, data_sets)
    if file is None and Path(text).expanduser().is_dir():
        raise ConfigError(text, "", f"holds no {DESCRIPTION}, which says what its files are")
    if file is None:
        raise ConfigError(
            text, "", f"no such folder, and no data set of that name; {known_names(text, data_sets)}"
        )
    description = structure_description(read_extended(file), DataSetDescription, file, find_files=False)
    if data is None:
        variable = description.data.variable
        base = os.environ.get(variable, "") if variable else ""
        data = (Path(base).expanduser() if base else file.parent) / description.data.folder
    return DataSet(description, file, data)


def find_description(text: str, file_name: str, named: Mapping[str, Path]) -> Path | None:
    """Return the file of a description by its path, its folder's path or a known name; None: nothing is."""
    path = Path(text).expanduser()
    for file in (path, path / file_name):
        if file.is_file():
            return file.absolute()
    return named[text].absolute() if text in named else None
