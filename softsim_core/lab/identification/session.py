"""Rows of a session as checked arrays in SI units, in the robot's frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from softsim_core.base import (
    Array,
    BoolArray,
    DataError,
    FormerAttribute,
    IndexArray,
    degrees,
    known_names,
    listing,
)
from softsim_core.lab.identification.description import (
    DataSet,
    FrameDescription,
    SessionDescription,
)
from softsim_core.lab.identification.tables import Table, join_tables, read_table
from softsim_core.scene import JointDescription, RobotDescription

FAR = 1.5
"""Commands beyond this multiple of a joint's limits are assumed to be in another unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """Measured rows of a session: k rows, s sensors.

    Attributes:
        description: Description of the session.
        table: Table from which the rows were read.
        measured: Positions of the sensors in [m], in the robot's frame as far as it is known, (k, s, 3).
        others: Predictions of other models by name: index of the sensor and positions (k, 3) in [m].
        used: Rows that are not suspect, and within the evaluated time, shape (k,).
        training: Training rows, shape (k,).
        times: Times of the rows in [s], shape (k,); None: each row is an equilibrium of its own.
    """

    description: SessionDescription
    table: Table
    measured: Array
    others: dict[str, tuple[int, Array]]
    used: BoolArray
    training: BoolArray
    times: Array | None

    @property
    def name(self) -> str:
        """Name of the session."""
        return self.description.name

    @property
    def fitting(self) -> BoolArray:
        """Fitted rows: training rows that are used, shape (k,)."""
        return self.used & self.training

    judged = FormerAttribute("evaluated")

    @property
    def evaluated(self) -> BoolArray:
        """Evaluated rows: the held-out ones, or all where none are held out, shape (k,)."""
        held_out = self.used & ~self.training
        return held_out if held_out.any() else self.used

    @property
    def load_cases(self) -> IndexArray:
        """Index of each row's load case; rows at rest under the same commands share it, shape (k,)."""
        return _load_cases(self.table, self.description)

    def part(self, rows: IndexArray) -> Session:
        """Return a session with only the rows of the indices; its rows must be equilibria."""
        assert self.times is None
        return replace(
            self,
            table=self.table.part(rows),
            measured=self.measured[rows],
            others={name: (sensor, places[rows]) for name, (sensor, places) in self.others.items()},
            used=self.used[rows],
            training=self.training[rows],
        )

    def commands(self, robot: RobotDescription) -> Array:
        """Return the joint commands of each row in [rad], [m] or the joint's own unit, shape (k, j).

        Raises:
            DataError: joints other than the robot's, another unit, or far beyond the limits.
        """
        commands = np.tile(np.array([joint.rest for joint in robot.joints]), (len(self.table), 1))
        columns = self.description.commands
        if columns is None:
            return commands
        names = columns.joints or robot.joint_names
        if len(names) != len(columns.columns):
            raise DataError(
                f"session {self.name}",
                "commands",
                f"{len(columns.columns)} columns for the {len(names)} joints of {robot.name} "
                f"({listing(names)}); name the joints",
            )
        for column, name in zip(columns.columns, names, strict=True):
            if name not in robot.joint_names:
                raise DataError(
                    f"session {self.name}",
                    f"column {column}",
                    f"{robot.name} has no joint {name!r}; {known_names(name, robot.joint_names, 'it has')}",
                )
            index = robot.joint_names.index(name)
            commands[:, index] = self.table.numbers(column, columns.unit)
            self._need_reachable(column, commands[:, index], robot.joints[index])
        return commands

    def _need_reachable(self, column: str, values: Array, joint: JointDescription) -> None:
        """Reject commands far beyond a joint's limits, because they are in another unit."""
        reach = max(abs(joint.limits.lower), abs(joint.limits.upper))
        worst = int(np.argmax(np.abs(values)))
        if np.isfinite(reach) and abs(values[worst]) > FAR * reach:
            shown = degrees(reach) if joint.kind == "revolute" else reach
            unit = "deg" if joint.kind == "revolute" else joint.units.command.si
            raise DataError(
                self.table.file,
                f"column {column}, line {self.table.lines[worst]}",
                f"commands {joint.name} {values[worst]:.4g} {joint.units.command.si}, far beyond its limit "
                f"of {shown:.4g} {unit}; is its unit right?",
            )


def load_session(data: DataSet, description: SessionDescription, every: int = 1) -> Session:
    """Read and check a session of a data set, each N-th row only with `every`; sessions in time use all.

    Raises:
        DataError: names the problem with file, column and line.
    """
    columns = _columns(description)
    tables = [read_table(file, columns) for file in data.tables_of(description)]
    for each in tables if len(tables) > 1 else ():
        for column in columns:
            each.numbers(column)  # an error names its own file
    table = join_tables(tables)
    if description.order is not None:
        table = table.part(np.argsort(table.numbers(description.order), kind="stable"))
    for column, (low, high) in description.within.items():
        values = table.numbers(column)
        table = table.part(np.flatnonzero((low <= values) & (values <= high)))
        if not len(table):
            raise DataError(table.file, f"column {column}", f"no row is within {low:g} to {high:g}")
    if every > 1 and description.time is None:
        table = table.part(np.arange(0, len(table), every))

    def positions_of(columns: tuple[str, ...], unit: str) -> Array:
        positions = np.stack([table.numbers(column, unit) for column in columns], axis=1)
        return in_robot(positions, description.frame)

    measured = np.stack([positions_of(each.columns, each.unit) for each in description.sensors], axis=1)
    if description.commands is not None:
        for column in description.commands.columns:
            table.numbers(column, description.commands.unit)  # report errors before any replay
    if len(table) > 2 and len(np.unique(_load_cases(table, description))) > 1:
        for k, sensor in enumerate(description.sensors):
            if not np.ptp(measured[:, k], axis=0).any():
                problem = "reads the same in every row; was it connected?"
                raise DataError(table.file, f"sensor {sensor.name}", problem)
    others = {
        each.name: (
            description.sensor_names.index(each.sensor) if each.sensor else 0,
            positions_of(each.columns, each.unit),
        )
        for each in description.others
    }
    used = np.ones(len(table), bool)
    if description.suspect is not None:
        used &= table.numbers(description.suspect) == 0.0
    times = None
    if description.time is not None:
        times = _times(table, description)
        last = description.time.last
        used &= (times >= description.time.first) & (times <= (np.inf if last is None else last))
    if not used.any():
        raise DataError(table.file, "", "no row is left that is not suspect and lies in the time that counts")
    training = _training(table, description)
    session = Session(description, table, measured, others, used, training, times)
    if not session.fitting.any():
        raise DataError(table.file, "", "no row is left for training; change the split")
    return session


def in_robot(positions: Array, frame: FrameDescription) -> Array:
    """Transform positions (..., 3) in [m] from the data's frame to the robot's frame."""
    columns = ["xyz".index(axis[-1]) for axis in frame.axes]
    signs = np.array([-1.0 if axis[0] == "-" else 1.0 for axis in frame.axes])
    return np.asarray((positions - np.array(frame.origin))[..., columns] * signs)


def _columns(description: SessionDescription) -> list[str]:
    """Return the names of all columns of a session, those of the sensors first."""
    columns = [column for each in description.sensors for column in each.columns]
    columns += [column for each in description.others for column in each.columns]
    columns += description.commands.columns if description.commands else ()
    columns += [description.time.column] if description.time else []
    columns += [description.suspect] if description.suspect else []
    columns += [description.order] if description.order else []
    columns += description.within
    columns += [description.split.column] if description.split and description.split.column else []
    return list(dict.fromkeys(columns))


def _load_cases(table: Table, description: SessionDescription) -> IndexArray:
    if description.time is not None:
        return np.arange(len(table))
    if description.commands is None:
        return np.zeros(len(table), dtype=np.int64)
    commands = np.column_stack([table.numbers(name) for name in description.commands.columns])
    return np.unique(commands, axis=0, return_inverse=True)[1].ravel()


def _times(table: Table, description: SessionDescription) -> Array:
    assert description.time is not None
    times = table.numbers(description.time.column, description.time.unit)
    back: IndexArray = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        k = int(back[0])
        raise DataError(
            table.file,
            f"column {description.time.column}, line {table.lines[k + 1]}",
            f"goes from {times[k]:g} s to {times[k + 1]:g} s; time must increase from row to row",
        )
    for sensor in description.sensors:
        if sensor.displacement and not (times <= 0.0).any():
            raise DataError(
                table.file,
                f"column {description.time.column}",
                f"begins at {times[0]:g} s; sensor {sensor.name} needs rows up to time 0 as its zero",
            )
    return times


def _training(table: Table, description: SessionDescription) -> BoolArray:
    split = description.split
    if split is None:
        return np.ones(len(table), bool)
    if split.column is not None:
        numbers = table.numbers(split.column)
        return ~np.isin(numbers, split.values) if split.values else np.asarray(numbers == 0.0)
    if split.files:
        held_out = [file in split.files for file in description.files]
        return np.array([not held_out[k] for k in table.origins or [0] * len(table)])
    assert split.held_out_share is not None
    chosen = np.random.default_rng(split.seed).permutation(len(table))
    training = np.ones(len(table), bool)
    training[chosen[: round(split.held_out_share * len(table))]] = False
    return training
