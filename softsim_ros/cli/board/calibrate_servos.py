"""`softsim calibrate-servos`: walk through a robot's servos in the terminal and write their calibration."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from servo_bridge.driver import (
    START_TIMEOUT_S,
    CalibrationAbortedError,
    ServoDriver,
    ServoMover,
    byte_to_angle,
    calibrate,
    calibrated_robot,
    default_file,
    find_port,
    save_calibration,
)
from servo_bridge.protocols import AUTO, names
from softsim_core.base import SceneError, listing
from softsim_core.scene import ServoCalibration, load_scene
from softsim_ros.cli import add_number


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("robot", help="robot: a name from configs/robots, or a file")
    parser.add_argument("--port", default="", help="serial port (default: the one board that is plugged in)")
    parser.add_argument(
        "-o",
        "--out",
        "--output",
        dest="output",
        type=Path,
        metavar="FILE",
        help="calibration to begin with and to write",
    )
    protocol_names = (
        f"{AUTO} (the default), {listing(names())}, or one that the robot's Python file registers"
    )
    parser.add_argument("--protocol", default=AUTO, metavar="NAME", help=protocol_names)
    add_number(parser, "--open-wait", 2.5, "S", "quiet time of a board that starts (2.5 s)")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate; the file is written only at the end, after confirmation."""
    robot = load_scene(arguments.robot)
    if robot.board is None:
        raise SceneError(f"robot {robot.name} has no servo board to calibrate")
    if robot.board.bus_servos:
        raise SceneError(
            f"the servos of {robot.name} are on a bus, where nothing has to be found out by moving; write id,"
            " zero_pulse, sign and range into the robot's file"
        )
    file: Path = arguments.output or default_file(robot.name)
    if file.exists():
        robot = calibrated_robot(robot, file)
        print(f"begins with {file}")
    driver = ServoDriver(robot, protocol=arguments.protocol)
    port = find_port(arguments.port)
    print(
        f"The servos on {port} jump to their rest pose and then move: hands off, horns free, switch in reach."
    )
    if _ask("Enter begins, q ends:").strip():
        raise CalibrationAbortedError
    driver.connect(port, arguments.open_wait)
    try:
        print(f"waiting for the board on {driver.port} ...")
        mover = ServoMover(driver)
        try:
            mover.wait_for_board(arguments.open_wait + START_TIMEOUT_S)
            servos = calibrate(robot, mover, _ask, print)
        finally:
            mover.close()
    finally:
        driver.disconnect(relax=True)
    print()
    for servo in servos:
        print(_summary(servo))
    if _ask(f"write {file}? [Y/n]").strip().lower() not in ("", "y", "yes"):
        raise CalibrationAbortedError
    save_calibration(file, robot.name, servos)
    value = "auto (its default)" if file == default_file(robot.name) else str(file.resolve())
    print(f"written; the bridge uses it with the parameter calibration:={value}")
    return 0


def _ask(question: str) -> str:
    try:
        return input(f"{question} ")
    except EOFError:
        raise CalibrationAbortedError from None


def _summary(servo: ServoCalibration) -> str:
    ends = sorted(math.degrees(byte_to_angle(end, servo)) for end in (servo.byte_min, servo.byte_max))
    return (
        f"{servo.joint}: sign {servo.sign:+d}, zero {servo.zero_byte}, trim {servo.trim_deg:+g} deg,"
        f" bytes {servo.byte_min}..{servo.byte_max}, rest {servo.rest_byte},"
        f" joint {ends[0]:.0f}..{ends[1]:.0f} deg"
    )
