"""What a data set is: whose motion was measured, what was commanded, which column holds what, in which unit.

Columns are in the units that their files have; everything made from them is in SI. Lengths in a description
are in [m], limits of errors in the millimetres in which people write them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from softsim_core.base import (
    SCALES,
    FieldError,
    Quantity,
    SceneError,
    Vector,
    known_names,
    listing,
    need_finite,
)

Axis: TypeAlias = Literal["x", "-x", "y", "-y", "z", "-z"]

EFFECTOR: Final = "effector"


def _need_unit_of(owner: str, unit: str, quantities: tuple[Quantity, ...]) -> None:
    known = [name for name, scale in SCALES.items() if scale.quantity in quantities]
    if unit not in known:
        raise FieldError(owner, "unit", repr(unit), f"one of {listing(known)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DataFolder:
    """Where the measured files lie.

    Attributes:
        folder: Relative to the description, or absolute.
        variable: Environment variable that names another folder, in whose place `folder` is looked for
            below it; for data that are not passed on with their description. None: there is none.
    """

    folder: Path = Path()
    variable: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandColumns:
    """What the joints were told.

    Attributes:
        columns: One per joint.
        unit: Of all of them: of an angle, a length, a force, a pressure or a volume.
        joints: Names of the joints; none: all of the robot's, in its order. Others stay where they rest.
    """

    columns: tuple[str, ...]
    unit: str = "rad"
    joints: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _need_unit_of("commands", self.unit, ("angle", "length", "force", "pressure", "volume"))
        if self.joints and len(self.joints) != len(self.columns):
            raise SceneError(f"commands: {len(self.columns)} columns for {len(self.joints)} joints")
        if len(set(self.columns)) != len(self.columns):
            raise SceneError("commands: a column stands for two joints; give each its own")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDescription:
    """A point whose position was measured.

    Attributes:
        name: Unique in its session.
        columns: Its x, y and z in the frame of the data.
        unit: Of the columns: m, cm or mm.
        at: What it sits on: "effector", or a frame of the robot by its name; not with `place`.
        place: A point in or on a deformable body at rest, in [m] of the robot, that it sits on.
        patch: Radius in [m]: the nodes so near to `place` say how the body turns there.
        offset: From frame or place to the sensor in [m], along the axes of the frame; at a place, those of
            the robot at rest. It turns with frame or body.
        displacement: Compare how far it has moved from where it was at the beginning, up to time 0.
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
    """What another model says of a sensor, to stand beside this one's.

    Attributes:
        name: What the report calls it.
        columns: Its x, y and z in the frame of the data.
        unit: Of the columns: m, cm or mm.
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
    """When a row was measured.

    Attributes:
        column: The column.
        unit: s, ms or us.
        first, last: Errors are told of the rows from `first` to `last` in [s]; None: of all from 0 on.
        start: "equilibrium": the model begins at rest under the first commands; "rest": in its rest shape,
            as a body that was held and is let go at time 0.
        release: "known": a body that begins in its rest shape is let go at once, at time 0; "unknown": by a
            hand, so a calibration takes no notice of the amplitude and the phase of its swing.
        most_delay: Sensors are late: a delay up to so much, to both sides, is fitted, in [s]; 0: none is.
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
    """How the frame of the data lies in that of the robot, as known without a fit.

    Attributes:
        axes: Which axis of the data is x, y and z of the robot: [x, -z, y] for data with y up.
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
    """What of a session's sensor is not known and fitted to its training rows.

    Attributes:
        frame: Where the frame of the data lies: a rotation and a shift.
        point: Where each sensor sits, on what it sits on: its offset.
    """

    frame: bool = False
    point: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitDescription:
    """Which rows fit, and which are held out to judge; give a column, or a share.

    Attributes:
        column: Rows where it is 0 are for training, others are held out.
        held_out_share: Part of the rows that is held out at random, in (0, 1).
        seed: Of that choice.
    """

    column: str | None = None
    held_out_share: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.column is None) == (self.held_out_share is None):
            raise SceneError("split: give exactly one of column and held_out_share")
        if self.held_out_share is not None and not 0.0 < self.held_out_share < 1.0:
            raise FieldError("split", "held_out_share", self.held_out_share, "between 0 and 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorLimits:
    """Largest errors in [mm] that pass; of what is held out, where something is. None: any passes."""

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
    """Rows measured in one go, with sensors that stayed where they were.

    Attributes:
        name: Unique name.
        file: Table in the data folder: CSV, or a recording (MCAP).
        commands: What was commanded; None: nothing is known, or the robot has no joints.
        sensors: What was measured.
        others: What other models say.
        time: When; None: each row is an equilibrium of its own.
        suspect: Column that is not 0 in rows that are left out of fits and errors.
        split: None: all rows are for training.
        frame, alignment, limits: See there.
        overrides: Laid over the scene, such as a load that hung on it; see load_scene.
        replayed: False: only other models are compared, since the commands are not known.
        note: For the reader of the report.
    """

    name: str
    file: Path
    sensors: tuple[SensorDescription, ...]
    commands: CommandColumns | None = None
    others: tuple[OtherModel, ...] = ()
    time: TimeColumn | None = None
    suspect: str | None = None
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
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors, in order."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def fitted_numbers(self) -> int:
        """How many numbers of frame, sensor points, delay and release are fitted to the rows."""
        delay = self.time is not None and self.time.most_delay > 0.0
        release = 2 * (self.time is not None and self.time.release == "unknown")
        return 6 * self.alignment.frame + 3 * self.alignment.point * len(self.sensors) + delay + release


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSetDescription:
    """Measurements of one robot.

    Attributes:
        name: What messages call it.
        robot: Robot or scene that was measured: a name, or a file relative to the description.
        sessions: The sessions.
        about: What it is, in a sentence.
        source: Who measured it, and where it is published.
        licence: Of the data.
        data: Where the files lie.
    """

    name: str
    robot: str
    sessions: tuple[SessionDescription, ...]
    about: str = ""
    source: str = ""
    licence: str = ""
    data: DataFolder = DataFolder()

    def __post_init__(self) -> None:
        names = [session.name for session in self.sessions]
        if not names or len(set(names)) != len(names):
            raise SceneError(f"data set {self.name}: give one session or more, each with its own name")

    @property
    def session_names(self) -> tuple[str, ...]:
        """Names of the sessions, in order."""
        return tuple(session.name for session in self.sessions)
