"""Measure a robot: play motions, collect its sensor messages, write a data set after every session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, SoftSimError
from softsim_core.lab.identification import (
    AlignmentDescription,
    CommandColumns,
    DataSetDescription,
    ExcitationSettings,
    Motion,
    SessionDescription,
    SplitDescription,
    TimeColumn,
    first_calibration,
    grid,
    load_data_set,
    load_session,
    motion_limits_of,
    motions,
    way,
    write_calibration,
    write_description,
    write_table,
)
from softsim_core.scene import RobotDescription
from softsim_ros.excitation.player import Player
from softsim_ros.excitation.readings import (
    Readings,
    commands_at,
    drifts,
    not_before,
    rings_from,
    times_of,
    whole,
)
from softsim_ros.excitation.sensors import IMU, SIMULATED, ExcitationError, Sensor


class SetFolder:
    """A new folder with a data set, complete after every change.

    Args:
        folder: Path of the folder; it must not exist.
        robot: Name of the robot, or its file.
        about: Description in one sentence.
        source: Who measured it, and how.

    Raises:
        ExcitationError: it exists.
    """

    def __init__(self, folder: Path, robot: str, about: str, source: str) -> None:
        try:
            folder.mkdir(parents=True)
        except FileExistsError as error:
            raise ExcitationError(f"{folder} is there already; give another folder with --out") from error
        except OSError as error:
            raise ExcitationError(f"{folder} cannot be made ({error.strerror})") from error
        self.folder = folder
        self._described = partial(
            DataSetDescription, name=folder.name, robot=robot, about=about, source=source
        )
        self._sessions: dict[str, SessionDescription] = {}

    @property
    def sessions(self) -> tuple[SessionDescription, ...]:
        """Sessions written so far."""
        return tuple(self._sessions.values())

    def put(self, session: SessionDescription, columns: dict[str, Array]) -> None:
        """Write a session, or overwrite it.

        Raises:
            ExcitationError: it cannot be written (disk full).
        """
        try:
            write_table(self.folder / session.file, columns, [session.note])
            self._sessions[session.name] = session
            write_description(self.folder, self._described(sessions=self.sessions))
        except OSError as error:
            raise ExcitationError(f"{self.folder} cannot be written ({error.strerror})") from error

    def finish(self, robot: RobotDescription) -> list[str]:
        """Write an initial calibration, read everything back as other programs will, and return messages.

        Raises:
            DataError: the sensors gave unusable data.
        """
        at_rest = [each.name for each in self.sessions if each.time is None]
        names = at_rest or [each.name for each in self.sessions]
        data, lines = load_data_set(self.folder), []
        for each in data.description.sessions:
            rows = load_session(data, each)
            lines.append(f"{each.name}: {len(rows.table)} rows, {int(rows.used.sum())} of them count")
        calibration = first_calibration(self.folder.name, robot, names, not at_rest)
        if calibration is not None:
            write_calibration(self.folder, calibration)
        return lines


TRIES: Final = 5
"""Number of attempts to observe a robot at rest; after them the row is marked as moving."""

FEWEST: Final = 6
"""Smallest number of readings of an observation."""

HELD_OUT: Final = 0.25
"""Fraction of the poses that is held out, if there are at least FEW_POSES."""

FEW_POSES: Final = 8
MOST_DELAY_S: Final = 0.1
"""Largest delay of a sensor in [s]."""

MOVING: Final = "moving"
UNALIGNED: Final = AlignmentDescription()

NOTES: Final = {
    "steps": "Each joint in turn, as quickly as its limits allow.",
    "chirp": "All joints swing, quicker and quicker.",
    "ring_down": "A quick move away and back, and the free motion after it.",
}
RINGS: Final = " What counts is the free motion."

Progress = Callable[[str, float], None]
"""Called with the present action, and with the elapsed part of `duration_s` in [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Looks:
    """How to observe a robot at rest, and what is unknown about its sensors.

    Attributes:
        settle_s: Waiting time after a move, in [s].
        hold_s: Time over which readings are averaged, in [s].
        alignment: Unknown alignment of the sensors.
    """

    settle_s: float = 1.0
    hold_s: float = 0.5
    alignment: AlignmentDescription = UNALIGNED


class Measurement:
    """The measurement of a robot.

    Args:
        player: Moves it.
        looks: How it is observed at rest.
    """

    def __init__(
        self,
        robot: RobotDescription,
        player: Player,
        sensors: Sequence[Sensor],
        settings: ExcitationSettings,
        looks: Looks,
    ) -> None:
        self._player, self._settings, self._looks = player, settings, looks
        self._sensors = sorted(sensors, key=lambda each: each.kind == IMU)
        self._motion_limits = motion_limits_of(robot, settings.reach)
        units = {joint.units.command.si for joint in robot.joints}
        unit = robot.joints[0].units.command.si
        names = [f"{name}_{unit}" if len(units) == 1 else name for name in robot.joint_names]
        self._commands = CommandColumns(columns=tuple(names), unit=unit, joints=robot.joint_names)
        self._own = all(each.topic == SIMULATED for each in sensors)
        with_grid = "grid" in settings.kinds
        self._poses = grid(self._motion_limits, settings) if with_grid else np.empty((0, len(names)))
        self._motions = motions(self._motion_limits, settings)

    @property
    def pose_s(self) -> float:
        """Mean time per pose, including the motion to it, in [s]."""
        at, ways = self._motion_limits.home, 0
        for pose in self._poses:
            ways += len(way(at, pose, self._motion_limits, self._settings.speed, self._settings.period_s))
            at = pose
        moving = ways * self._settings.period_s / max(len(self._poses), 1)
        return moving + self._looks.settle_s + self._looks.hold_s

    @property
    def duration_s(self) -> float:
        """Approximate total time in [s]."""
        return self.pose_s * len(self._poses) + sum(map(self._motion_s, self._motions))

    def _motion_s(self, motion: Motion) -> float:
        return motion.duration_s + self._looks.settle_s + self._looks.hold_s

    def run(self, out: SetFolder, progress: Progress) -> None:
        """Play everything, and write measurements as they arrive.

        Raises:
            ExcitationError: it ended early; the measurements so far are written.
            ClientError: the robot refused.
        """
        self._player.go(self._motion_limits.home)
        done, rows = 0.0, []
        for k, pose in enumerate(self._poses):
            progress(f"grid: pose {k + 1}/{len(self._poses)}", done)
            self._player.go(pose)
            rows.append(self._at_rest())
            out.put(*self._static(np.array(rows)))
            done += self.pose_s
        for motion in self._motions:
            progress(motion.name, done)
            self._player.go(self._motion_limits.home)
            self._at_rest()
            counts = [len(each) for each in self._all_readings]
            try:
                self._player.play(motion.commands, self._ticking(progress, motion, done))
            except SoftSimError:
                with suppress(ExcitationError):  # a motion with too few readings
                    out.put(*self._in_time(motion, counts))
                raise
            out.put(*self._in_time(motion, counts))
            done += self._motion_s(motion)

    @property
    def _all_readings(self) -> list[Readings]:
        return [self._player.joints, *(each.readings for each in self._sensors)]

    @staticmethod
    def _ticking(progress: Progress, motion: Motion, done: float) -> Callable[[float], None]:
        return lambda spent: progress(motion.name, done + spent)

    # --- poses ----------------------------------------------------------------------------------------

    def _at_rest(self) -> Array:
        """Return an observation at rest: command, mean readings, their spread, and 1 if they still moved."""
        self._player.wait(self._looks.settle_s)
        for _ in range(TRIES):
            row = self._look()
            if not row[-1]:
                break
        return row

    def _look(self) -> Array:
        counts = [len(each.readings) for each in self._sensors]
        start_count, begin = len(self._player.joints), self._player.joints.newest
        for _ in range(TRIES):
            self._player.wait(self._looks.hold_s)
            series = [each.readings.since(count) for each, count in zip(self._sensors, counts, strict=True)]
            commands, *numbers = not_before(begin, [self._player.joints.since(start_count), *series])
            if min(map(len, [commands, *numbers])) >= FEWEST:
                break
        means_of = [whole(each.in_units(said)) for each, said in zip(self._sensors, numbers, strict=True)]
        if not len(commands) or any(len(each) < FEWEST for each in means_of):
            few = min(map(len, [commands, *means_of]))
            raise ExcitationError(
                f"only {few} messages of a topic came within {self._looks.hold_s:g} s, and {FEWEST} are "
                "needed; look longer (--hold)"
            )
        moves = drifts(means_of[0])
        command = commands[-1] if self._player.real else self._player.command
        moves = moves or (self._player.real and bool(np.ptp(commands, axis=0).any()))
        means = [each.mean(axis=0) for each in means_of]
        return np.concatenate([command, *means, [float(means_of[0].std(axis=0).max()), float(moves)]])

    def _static(self, rows: Array) -> tuple[SessionDescription, dict[str, Array]]:
        names = [*self._commands.columns, *self._columns, "spread_mm", MOVING]
        columns = dict(zip(names, rows.T, strict=True))
        many = len(rows) >= FEW_POSES
        session = SessionDescription(
            name="grid",
            file=Path("grid.csv"),
            note=f"Poses at rest: means over {self._looks.hold_s:g} s; spread_mm is their noise.",
            suspect=MOVING,
            split=SplitDescription(held_out_share=HELD_OUT, seed=self._settings.seed) if many else None,
            **self._shared,
        )
        return session, columns

    # --- motions --------------------------------------------------------------------------------------

    def _in_time(self, motion: Motion, counts: Sequence[int]) -> tuple[SessionDescription, dict[str, Array]]:
        """Return session and columns of a motion: the messages since each topic had the given count."""
        series = [each.since(count) for each, count in zip(self._all_readings, counts, strict=True)]
        if any(len(stamps) < FEWEST for stamps, _, _ in series):
            raise ExcitationError(f"{motion.name}: a topic said nothing while the robot moved")
        clocks = times_of([(stamps, arrivals) for stamps, arrivals, _ in series])
        when = clocks[1]
        rising = when > np.maximum.accumulate(np.concatenate([[-np.inf], when[:-1]]))
        when = when[rising]
        commands = commands_at(clocks[0], series[0][2], when, after=not self._player.real)
        columns = {"time_s": when - when[0]} | dict(zip(self._commands.columns, commands.T, strict=True))
        for sensor, times, (_, _, numbers) in zip(self._sensors, clocks[1:], series[1:], strict=True):
            for name, values in zip(sensor.columns, sensor.in_units(numbers).T, strict=True):
                columns[name] = np.interp(when, times, values)
        all_finite = np.all([np.isfinite(each) for each in columns.values()], axis=0)
        columns = {name: values[all_finite] for name, values in columns.items()}
        first = 0.0
        if motion.free:
            places = np.array([columns[name] for name in self._columns[:3]]).T
            first = rings_from(columns["time_s"], commands[all_finite], places)
        time = TimeColumn(column="time_s", first=first, most_delay=0.0 if self._own else MOST_DELAY_S)
        note = NOTES[motion.name] + (RINGS if first else "")
        file = Path(f"{motion.name}.csv")
        return SessionDescription(name=motion.name, file=file, note=note, time=time, **self._shared), columns

    @property
    def _columns(self) -> list[str]:
        return [column for each in self._sensors for column in each.columns]

    @property
    def _shared(self) -> dict[str, Any]:
        return {
            "commands": self._commands,
            "sensors": tuple(point for each in self._sensors for point in each.described),
            "alignment": self._looks.alignment,
        }
