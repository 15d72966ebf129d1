"""The calibration of a robot's own servos: its file, and a guided measurement of each servo.

    robot: tripod
    servos:
      - {joint: servo_0, zero_byte: 179, sign: 1, trim_deg: 2.0, byte_min: 62, byte_max: 178, rest_byte: 150}

The keys are the same as in the robot's file. Any key but `joint` may be missing, and so may a whole servo;
the values of the robot's file apply then.

The servos move only through the driver, so limits of position, speed and acceleration always apply, and the
board receives poses at its rate while the user thinks.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeVar

from servo_bridge import PortError
from servo_bridge.driver.driver import ServoDriver
from servo_bridge.driver.servo import angle_to_byte, byte_to_angle
from servo_bridge.driver.writer import PeriodicThread
from softsim_core.base import ConfigError, SceneError, SoftSimError, known_names, write_file
from softsim_core.scene import BusServo, RobotDescription, Servo, ServoCalibration
from softsim_core.scene.io import (
    SourcedMapping,
    comment,
    merge,
    read_yaml,
    scalar,
    structure_description,
)

AnyServo = TypeVar("AnyServo", ServoCalibration, BusServo)


def default_file(robot: str) -> Path:
    """Return the calibration file of a robot: softsim/servos/<robot>.yaml in the user's configuration."""
    configuration = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(configuration) / "softsim" / "servos" / f"{robot}.yaml"


def file_for(choice: str, robot: str) -> Path | None:
    """Return the file that the parameter `calibration` names: a path, an existing default file, or None."""
    if choice == "auto":
        return default_file(robot) if default_file(robot).is_file() else None
    return Path(choice).expanduser() if choice else None


def load_calibration(file: Path, robot: str, servos: Sequence[AnyServo]) -> tuple[AnyServo, ...]:
    """Return the servos of a robot's board, in packet order, with the values of a calibration file.

    Raises:
        ConfigError: unreadable file, file of another robot, unknown key or joint, a value not allowed.
    """
    data = read_yaml(file)
    for key in data:
        if key not in ("robot", "servos"):
            raise ConfigError(file, key, "is no key of a calibration; known: robot, servos")
    if data.get("robot") != robot:
        raise ConfigError(file, "robot", f"must be {robot}, not {data.get('robot')!r}; calibrate that robot")
    entries = data.get("servos")
    if not isinstance(entries, list):
        raise ConfigError(file, "servos", "must be a list of servos, each with joint and what differs")
    found = {servo.joint: servo for servo in servos}
    joints: set[str] = set()
    for index, entry in enumerate(entries):
        where = f"servos[{index}]"
        joint = entry.get("joint") if isinstance(entry, dict) else None
        if joint not in found:
            raise ConfigError(
                file, f"{where}.joint", f"{joint!r} drives no servo; {known_names(joint, found)}"
            )
        if joint in joints:
            raise ConfigError(file, f"{where}.joint", f"{joint} occurs twice")
        joints.add(joint)
        found[joint] = _apply_entry(found[joint], entry, file, where)
    return tuple(found[servo.joint] for servo in servos)


def calibrated_robot(robot: RobotDescription, file: Path) -> RobotDescription:
    """Return the robot with the servo calibration of a file.

    Raises:
        ConfigError: see `load_calibration`.
        SceneError: the robot has no board.
    """
    if robot.board is None:
        raise SceneError(f"robot {robot.name} has no servo board to calibrate")
    board = robot.board
    servos: tuple[Servo, ...]
    if board.bus_servos:
        servos = load_calibration(file, robot.name, board.bus_servos)
    else:
        servos = load_calibration(file, robot.name, board.hobby_servos)
    return replace(robot, board=replace(board, servos=servos))


def save_calibration(file: Path, robot: str, servos: Sequence[Servo]) -> None:
    """Write a calibration file atomically: a reader, or a power cut, sees the old file or the new one.

    Raises:
        ConfigError: it cannot be written.
    """
    head = comment(f"How the servos of {robot} are mounted; made by `softsim calibrate-servos {robot}`.")
    lines = [f"robot: {scalar(robot)}", "servos:"]
    for servo in servos:
        values = {**asdict(servo), "joint": scalar(servo.joint)}
        lines.append("  - {" + ", ".join(f"{key}: {value}" for key, value in values.items()) + "}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, head + "\n".join(lines) + "\n")
    except OSError as error:
        raise ConfigError(file, "", f"cannot be written ({error.strerror or error})") from error


def _apply_entry(servo: AnyServo, entry: SourcedMapping, file: Path, where: str) -> AnyServo:
    own = merge(SourcedMapping(asdict(servo), file), entry)
    calibrated = structure_description(own, type(servo), file, at=where)
    if isinstance(calibrated, ServoCalibration) and not -180.0 <= calibrated.trim_deg <= 180.0:
        raise ConfigError(file, f"{where}.trim_deg", f"must be within -180..180, not {calibrated.trim_deg:g}")
    return calibrated


Ask = Callable[[str], str]  # shows a question and returns the line that the user typed
Say = Callable[[str], None]
SMALL_MOVE_DEG, MOVE_TIMEOUT_S, START_TIMEOUT_S = 10.0, 15.0, 10.0
ALLOWED_NUDGES = "+ or - (1 deg), ++ or -- (5 deg), or degrees such as -2.5"
NUDGES = {"+": 1.0, "++": 5.0, "-": -1.0, "--": -5.0}


class CalibrationAbortedError(SoftSimError):
    """The user ended the calibration; nothing is written."""

    def __init__(self) -> None:
        super().__init__("calibration ended; nothing was written")


@dataclass(frozen=True, slots=True)
class ServoObservation:
    """What the user observed of one servo."""

    mirrored: bool  # the servo turns the other way
    reference_rad: float  # joint angle at which the mounting was compared, in [rad]
    offset_deg: float  # to add to the commanded degrees of the servo until the joint is at the reference
    byte_min: int | None = None  # end of the range without obstruction; None leaves it unchanged
    byte_max: int | None = None


def apply_observation(servo: ServoCalibration, observation: ServoObservation) -> ServoCalibration:
    """Return the calibration of a servo after an observation.

    At the reference angle the servo is sent the byte at which the user saw the joint in place. A mirrored
    servo counts backwards from the middle of its range. The rest angle is unchanged as far as the range
    allows.

    Raises:
        SceneError: the range is empty.
    """
    degrees = observation.reference_rad * 180.0 / math.pi
    right = servo.sign * degrees + servo.trim_deg + servo.zero_byte + observation.offset_deg
    rest = byte_to_angle(servo.rest_byte, servo)
    sign, zero = servo.sign, servo.zero_byte
    if observation.mirrored:
        sign, zero = (-1 if sign == 1 else 1), servo.byte_min + servo.byte_max - zero
    low = servo.byte_min if observation.byte_min is None else observation.byte_min
    high = servo.byte_max if observation.byte_max is None else observation.byte_max
    fresh = replace(
        servo,
        sign=sign,
        zero_byte=zero,
        trim_deg=round(right - zero - sign * degrees, 3),
        byte_min=low,
        byte_max=high,
        rest_byte=min(max(servo.rest_byte, low), high),
    )
    return replace(fresh, rest_byte=angle_to_byte(rest, fresh))


class ServoMover:
    """Sends the newest pose at the board's rate from a thread; `move` waits until it is reached.

    The driver is connected; the caller disconnects it after `close`.
    """

    def __init__(self, driver: ServoDriver) -> None:
        self._driver = driver
        self._changed = threading.Condition()
        self._fault: PortError | None = None
        self._target = dict(zip(driver.servo_joints, driver.motion.rest, strict=True))
        driver.start()
        self._thread = PeriodicThread(self._tick, driver.period)

    def wait_for_board(self, deadline_s: float) -> None:
        """Wait until the first pose was sent.

        Raises:
            PortError: the board is lost, or did not start in time.
        """
        self._wait(lambda: self._driver.sent_bytes is not None, deadline_s)

    def move(self, joint: str, angle_rad: float) -> float:
        """Turn one joint while the others stay, and return the angle reached in [rad], within the limits.

        Raises:
            PortError: the board is lost.
        """
        with self._changed:
            self._target[joint] = angle_rad
        index = self._driver.servo_joints.index(joint)
        goal = self._driver.motion.limits[index].clamp(angle_rad)
        self._wait(lambda: self._driver.motion.positions[index] == goal, MOVE_TIMEOUT_S)
        return goal

    def sent_byte(self, joint: str) -> int:
        """Return the servo byte that was sent last to a joint."""
        with self._changed:
            assert self._driver.sent_bytes is not None
            return self._driver.sent_bytes[self._driver.servo_joints.index(joint)]

    def close(self) -> None:
        """Stop sending and settle at rest at the limits' speed."""
        self._thread.stop()
        self._thread.join()
        self._driver.settle(MOVE_TIMEOUT_S)

    def _tick(self) -> None:
        with self._changed:
            if self._fault is None:
                try:
                    self._driver.command_named(self._target)
                    self._driver.tick()
                except PortError as error:
                    self._fault = error
            self._changed.notify_all()

    def _wait(self, condition: Callable[[], bool], deadline_s: float) -> None:
        with self._changed:
            done = self._changed.wait_for(lambda: self._fault is not None or condition(), deadline_s)
            if self._fault is not None:
                raise self._fault
            if not done:
                raise PortError(
                    self._driver.port,
                    f"the board on {self._driver.port} did not get there in time; start again",
                )


def calibrate(robot: RobotDescription, mover: ServoMover, ask: Ask, say: Say) -> tuple[ServoCalibration, ...]:
    """Guide the user through every servo of the board; the last answer to each question counts.

    The robot has the calibration that the driver of `mover` uses, as the first guess.

    Returns:
        The new calibrations, in packet order.

    Raises:
        CalibrationAbortedError: the user typed q.
        PortError: the board is lost.
    """
    assert robot.board is not None
    say("Enter takes what is shown, q ends without a change.")
    results = []
    for number, servo in enumerate(robot.board.hobby_servos, start=1):
        say(f"\n{servo.joint}, servo {number} of {len(robot.board.hobby_servos)}")
        results.append(apply_observation(servo, _observe(robot, servo, mover, ask, say)))
    return tuple(results)


def _observe(
    robot: RobotDescription, servo: ServoCalibration, mover: ServoMover, ask: Ask, say: Say
) -> ServoObservation:
    rest = byte_to_angle(servo.rest_byte, servo)
    mirrored = _turns_the_other_way(servo, rest, mover, ask)
    index = robot.joint_names.index(servo.joint)  # in the robot's first joint pose
    reference = next((float(pose[index]) for pose in robot.poses.values()), rest)
    reached = mover.move(servo.joint, reference)
    say(f"It should be at {math.degrees(reached):.1f} deg of joint angle now (pose of the robot's file).")
    say(f"Correct it until it does: {ALLOWED_NUDGES}.")
    offset = _nudge(servo, reached, mover, ask, say, "Correction")
    limits = next(joint.limits for joint in robot.joints if joint.name == servo.joint)
    ends: list[int | None] = []
    for word, towards in (("smallest", -1), ("largest", 1)):
        end = limits.lower if servo.sign * towards < 0 else limits.upper
        fallback = byte_to_angle(servo.byte_min if towards < 0 else servo.byte_max, servo)
        reached = mover.move(servo.joint, end if math.isfinite(end) else fallback)
        back = _nudge(
            servo, reached, mover, ask, say, f"The {word} servo byte; step back where it strains or touches"
        )
        ends.append(mover.sent_byte(servo.joint) if back else None)
        mover.move(servo.joint, rest)
    return ServoObservation(mirrored, reference, offset, *ends)


def _turns_the_other_way(servo: ServoCalibration, rest: float, mover: ServoMover, ask: Ask) -> bool:
    while True:
        mover.move(servo.joint, rest - math.radians(SMALL_MOVE_DEG))
        mover.move(servo.joint, rest)
        answer = _answer(
            ask,
            f"{servo.joint} turned by {SMALL_MOVE_DEG:g} deg and back: to a smaller joint angle? [Y/n/again]",
        )
        if answer in ("", "y", "yes"):
            return False
        if answer in ("n", "no"):
            return True


def _nudge(servo: ServoCalibration, start: float, mover: ServoMover, ask: Ask, say: Say, what: str) -> float:
    """Return the degrees of the servo that the user added, as far as the limits allow."""
    offset = 0.0
    while True:
        answer = _answer(ask, f"{what} [{offset:+.3g} deg, byte {mover.sent_byte(servo.joint)}]")
        if not answer:
            return offset
        try:
            step = NUDGES[answer] if answer in NUDGES else float(answer)
        except ValueError:
            step = math.nan
        if not math.isfinite(step):
            say(f"{answer!r} moves nothing; type {ALLOWED_NUDGES}, or Enter when it is right.")
            continue
        reached = mover.move(servo.joint, start + servo.sign * math.radians(offset + step))
        requested_deg, offset = offset + step, round(servo.sign * math.degrees(reached - start), 6)
        if abs(offset - requested_deg) > 1e-3:
            say("The joint's limits or the servo's range end here.")


def _answer(ask: Ask, question: str) -> str:
    answer = ask(question).strip().lower()
    if answer == "q":
        raise CalibrationAbortedError
    return answer
