"""`softsim excite ROBOT`: play motions that identify a model's parameters, and record them as a data set."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from softsim_core.base import SoftSimError
from softsim_core.lab.identification import KINDS, AlignmentDescription, ExcitationSettings
from softsim_node import takes_escapes
from softsim_ros.cli import (
    EXIT_INTERRUPTED,
    CommandError,
    ProgressLine,
    UsageError,
    add_number,
    add_out,
    add_words,
)

if TYPE_CHECKING:
    from softsim_core.scene import RobotDescription
    from softsim_ros.client import RobotSession
    from softsim_ros.excitation import Sensor

COMPILED_WITHIN_S = 240.0
"""Time limit in [s] for the answer of a simulator started here, since its kernels may have to be compiled."""

DEFAULTS = ExcitationSettings()
DEFAULT_ROBOT = "tripod"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "robot", nargs="?", help="robot: a name or a file (with --attach the one that runs, else tripod)"
    )
    add_out(parser, "FOLDER", "the new folder of the data set (ROBOT_DATE_TIME here)")
    parser.add_argument(
        "--attach", action="store_true", help="measure the robot that runs already; else one is simulated"
    )
    parser.add_argument("--namespace", metavar="NAME", help="namespace of its nodes (the robot's name)")
    add_words(
        parser,
        "--sensor",
        "TOPIC[=PLACE,...]",
        "topic of PoseStamped, PoseArray or Imu, and what its points sit on: a frame of the robot "
        "(effector) or a point of a body X:Y:Z in m; may be repeated (those that are there)",
    )
    unknown = "of the sensors; it is fitted then (the frame, where it is not the robot's)"
    add_words(parser, "--unknown", None, unknown, ("frame", "point"))
    parser.add_argument(
        "--joints",
        choices=("real", "simulated"),
        help="whose joints the sensors follow (the real ones', where the bridge sends and a sensor is there)",
    )
    add_words(parser, "--motion", None, "may be repeated (all of them)", KINDS)
    add_number(parser, "--poses", DEFAULTS.poses, "N", "most of the grid (30)")
    add_number(parser, "--levels", DEFAULTS.levels, "N", "of each joint in the grid (3)")
    reach = "of the way from the start pose to the joints' limits (0.5)"
    add_number(parser, "--reach", DEFAULTS.reach, "PART", reach)
    speed = "of the limits of speed and acceleration, from pose to pose (0.5)"
    add_number(parser, "--speed", DEFAULTS.speed, "PART", speed)
    add_number(parser, "--settle", 1.0, "S", "wait at a pose (1)")
    add_number(parser, "--hold", 0.5, "S", "average at a pose (0.5)")
    add_number(parser, "--chirp", DEFAULTS.chirp_s, "S", "its length (10)")
    add_number(parser, "--ringing", DEFAULTS.ringing_s, "S", "watch a ringing down (2)")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (0)")
    parser.epilog = (
        "Then: softsim validate FOLDER; softsim calibrate FOLDER. Ctrl-C keeps what is recorded. A real "
        "robot: start it first (softsim up ROBOT --board auto, key B) and its sensor, then --attach."
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure; data recorded before an early end are preserved."""
    from softsim_core.scene import load_scene
    from softsim_node import ros_process
    from softsim_ros.client import CONNECT_WITHIN_S, connect, running_robot

    if not (arguments.settle >= 0.0 and arguments.hold > 0.0):
        raise UsageError("--settle must be >= 0 s and --hold > 0 s")
    settings = ExcitationSettings(
        kinds=tuple(arguments.motion) or KINDS,
        reach=arguments.reach,
        speed=arguments.speed,
        poses=arguments.poses,
        levels=arguments.levels,
        chirp_s=arguments.chirp,
        ringing_s=arguments.ringing,
        seed=arguments.seed,
    )
    name, namespace = arguments.robot or DEFAULT_ROBOT, arguments.namespace
    if arguments.attach and arguments.robot is None:
        found = running_robot(namespace)
        name, namespace = found or (name, namespace)
    arguments.robot = name
    robot = load_scene(name)
    folder = arguments.out or Path(f"{robot.name}_{datetime.now():%Y-%m-%d_%H-%M-%S}")
    if folder.exists():
        raise CommandError(f"{folder} is there already; give another with --out")
    namespace = (namespace or robot.namespace).strip("/")
    with ros_process(), contextlib.ExitStack() as stack:
        if not arguments.attach:
            _simulate(stack, robot, namespace)
        within_s = CONNECT_WITHIN_S if arguments.attach else COMPILED_WITHIN_S
        session = stack.enter_context(connect(robot, namespace=namespace, within_s=within_s))
        return _measure_robot(arguments, settings, session, folder)
    return EXIT_INTERRUPTED  # requested while the robot started


def _simulate(stack: contextlib.ExitStack[bool | None], robot: RobotDescription, namespace: str) -> None:
    """Run a simulator in this process with simulated time in its stamps."""
    from rclpy.parameter import Parameter

    from softsim_ros import SpinThread
    from softsim_ros.cli.running import only_one
    from softsim_ros.nodes.simulator import Simulator

    stack.enter_context(only_one(namespace))
    overrides = [Parameter("publish_clock", value=True)]
    simulator = Simulator(robot, namespace=namespace, parameter_overrides=overrides)
    stack.callback(simulator.close)
    stack.enter_context(SpinThread([simulator]))


def _measure_robot(
    arguments: argparse.Namespace, settings: ExcitationSettings, session: RobotSession, folder: Path
) -> int:
    """Measure the robot of a session; return the exit code."""
    from softsim_ros.excitation import (
        SIMULATED,
        Looks,
        Measurement,
        MeasurementInterruptedError,
        Player,
        SetFolder,
        sensor_choice,
        subscribe_sensors,
    )

    robot, node = session.client.robot, session.client.node
    sensors = subscribe_sensors(node, [sensor_choice(each) for each in arguments.sensor], _say)
    moved = session.state.bridge == "comm" and any(each.topic != SIMULATED for each in sensors)
    real = moved if arguments.joints is None else arguments.joints == "real"
    player = Player(session, real, settings)
    player.begin(sensors)
    unknown = {*arguments.unknown, *([] if _in_robot(sensors, node.get_namespace()) else ["frame"])}
    if "frame" in unknown and "ring_down" in settings.kinds:
        _say("ring_down is left out: on one line no sensor determines the frame in which it measures")
        settings = replace(settings, kinds=tuple(each for each in settings.kinds if each != "ring_down"))
    looks = Looks(
        settle_s=arguments.settle,
        hold_s=arguments.hold,
        alignment=AlignmentDescription(frame="frame" in unknown, point="point" in unknown),
    )
    measurement = Measurement(robot, player, sensors, settings, looks)
    kind = "real" if real else "simulated"
    _say(
        f"measuring the {kind} {robot.name} with {', '.join(each.topic for each in sensors)}: about "
        f"{measurement.duration_s:.0f} s; Ctrl-C keeps what is recorded"
    )
    if player.is_slow:
        _say(
            "the simulation stamps by the wall clock, and does not keep real time: what is measured in time "
            "is wrong by as much; start it with publish_clock:=true"
        )
    file = Path(arguments.robot).expanduser()  # a file is described by its path relative to the folder
    out = SetFolder(
        folder,
        os.path.relpath(file, folder) if file.is_file() else arguments.robot,
        f"{robot.name}, moved by softsim excite.",
        f"the {kind} robot, {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC, seed {settings.seed}",
    )
    progress, code = _Progress(measurement.duration_s), 0
    try:
        measurement.run(out, progress)
    except MeasurementInterruptedError:
        code = EXIT_INTERRUPTED
    except SoftSimError as error:
        print(f"\nsoftsim excite: {error}", file=sys.stderr)
        code = 1
    finally:
        progress.end()
        if why := player.leave():
            print(f"softsim excite: the robot is not back in its start pose: {why}", file=sys.stderr)
    if not out.sessions:
        folder.rmdir()
        _say("nothing was recorded")
        return code
    for line in out.finish(robot):
        _say(line)
    _say(f"{folder}{'' if not code else ', as far as it came'}: softsim validate {folder}")
    return code


def _in_robot(sensors: Sequence[Sensor], namespace: str) -> bool:
    """Return whether the sensors' frame is the robot's.

    Raises:
        ExcitationError: they have different ones.
    """
    from softsim_node import BASE_LINK, WORLD
    from softsim_ros.excitation import IMU, ExcitationError

    own = {WORLD, BASE_LINK, f"{namespace.strip('/')}/{BASE_LINK}"}
    are_own = {each.readings.frame in own for each in sensors if each.kind != IMU}
    frames = sorted({each.readings.frame for each in sensors if each.kind != IMU})
    if len(are_own) > 1 or (are_own == {False} and len(frames) > 1):
        raise ExcitationError(
            f"the sensors measure in different frames ({', '.join(map(repr, frames))}); record them one "
            "after the other, each with --sensor"
        )
    return are_own == {True}


def _say(message: str) -> None:
    print(message, flush=True)


class _Progress:
    """A line on the terminal: present action and remaining time; in a log, each action once."""

    def __init__(self, total_s: float) -> None:
        self._shown, self._total_s = takes_escapes(sys.stdout), total_s
        self._line, self._begin, self._what = ProgressLine(sys.stdout), time.monotonic(), ""

    def __call__(self, what: str, done_s: float) -> None:
        shown = what if self._shown else what.split(":")[0]
        is_new, self._what = shown != self._what, shown
        if is_new and not self._shown:
            _say(f"{shown} ...")
        pace = (time.monotonic() - self._begin) / done_s if done_s > 5.0 else 1.0
        left_s = max(0.0, pace * (self._total_s - done_s))
        self._line.show(f"{what}, {left_s:.0f} s to go", at_once=is_new)

    def end(self) -> None:
        self._line.end()
