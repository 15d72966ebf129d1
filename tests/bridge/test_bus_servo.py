"""Servos on a bus in a robot's file: joint angle to pulse, limits, calibration, what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from servo_bridge.driver import (
    PULSES_PER_RAD,
    ServoDriver,
    angle_to_pulse,
    calibrated_robot,
    pulse_to_angle,
    save_calibration,
    within,
)
from softsim_core import load_scene
from softsim_core.base import CommandError, ConfigError, FieldError, SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import BusServo
from softsim_core.scene.io import structure_scene, unstructure_scene
from softsim_ros.cli import main as softsim

ROBOT = """\
name: two
joints:
  - {{name: a, limits: {{lower: -1.0, upper: 0.5}}}}
  - {{name: b}}
board:
  baud_rate: 1000000
  servos: [{a}, {b}]
"""
A, B = "{joint: a, id: 0, sign: -1}", "{joint: b, id: 7}"

servos = st.builds(
    BusServo,
    joint=st.just("a"),
    id=st.integers(0, 252),
    zero_pulse=st.integers(0, 4095),
    sign=st.sampled_from([1, -1]),
    pulse_min=st.integers(0, 1000),
    pulse_max=st.integers(3000, 4095),
    rest_pulse=st.integers(1000, 3000),
)


def write(folder: Path, a: str = A, b: str = B) -> Path:
    file = folder / "two.yaml"
    file.write_text(ROBOT.format(a=a, b=b))
    return file


def test_the_formula_of_a_robot_of_this_kind() -> None:
    """pulse = 2048 - 651.9 theta, but rounded and with 4096 / 2 pi: never further than half a pulse."""
    servo = BusServo(joint="a", id=0, sign=-1)
    for step in range(-300, 301):
        angle = 0.01 * step
        assert abs(angle_to_pulse(angle, servo) - (2048 - 4096 / math.tau * angle)) <= 0.5
        assert abs(angle_to_pulse(angle, servo) - (2048 - 651.9 * angle)) <= 0.51


def test_a_servo_with_a_drum_winds_a_cable() -> None:
    robot = load_scene("tendon_arm", kind="robots")
    assert robot.board is not None
    driver = ServoDriver(robot)
    limits = driver.motion.limits[0]  # of the motors, on drums of 10 mm
    assert (limits.upper, limits.speed) == pytest.approx((3.0, 4.0), abs=1.0 / PULSES_PER_RAD)
    driver.command_some(["s0t1"], [0.005])
    assert driver.motion.goal(driver.clock()) == pytest.approx((0.0, 0.5, *[0.0] * 7))
    driver.command_named(dict.fromkeys(robot.joint_names, -0.002))
    assert driver.motion.goal(driver.clock()) == pytest.approx((-0.2,) * 9)
    servos = robot.board.bus_servos
    with pytest.raises(FieldError, match="travel"):
        replace(servos[0], travel=0.0)
    board = replace(robot.board, servos=(replace(servos[0], travel=1.0), *servos[1:]))
    with pytest.raises(SceneError, match="joint s0t0 of a servo must be revolute, or a cable"):
        ServoDriver(replace(robot, board=board))


@given(servos)
def test_every_pulse_in_range_comes_back(servo: BusServo) -> None:
    for pulse in (servo.pulse_min, servo.rest_pulse, servo.pulse_max):
        assert angle_to_pulse(pulse_to_angle(pulse, servo), servo) == pulse


@given(servos, st.floats(allow_nan=False, allow_infinity=False))
def test_no_angle_leaves_the_range(servo: BusServo, angle: float) -> None:
    assert servo.pulse_min <= angle_to_pulse(angle, servo) <= servo.pulse_max


@given(servos, st.floats(-9.0, 9.0), st.floats(0.0, 3.0), st.floats(allow_nan=False, allow_infinity=False))
def test_no_pulse_lies_outside_the_joint_not_even_by_rounding(
    servo: BusServo, lower: float, width: float, angle: float
) -> None:
    limits = JointLimits(lower, lower + width)
    ends = sorted(servo.sign * PULSES_PER_RAD * end + servo.zero_pulse for end in (lower, lower + width))
    if not ends[0] <= servo.rest_pulse <= ends[1]:
        return
    narrow = within(servo, limits)
    told = pulse_to_angle(angle_to_pulse(angle, narrow), narrow)
    assert lower - 1e-11 <= told <= lower + width + 1e-11


def test_an_angle_that_is_none_is_refused() -> None:
    with pytest.raises(CommandError, match="angle nan for joint a refused"):
        angle_to_pulse(math.nan, BusServo(joint="a", id=0))


def test_a_file_with_servos_on_a_bus_is_read_and_written(tmp_path: Path) -> None:
    robot = load_scene(write(tmp_path))
    assert robot.board is not None
    assert robot.board.bus_servos == (BusServo(joint="a", id=0, sign=-1), BusServo(joint="b", id=7))
    assert robot.board.hobby_servos == ()
    assert structure_scene(unstructure_scene(robot), "again").board == robot.board
    limits = ServoDriver(robot).motion.limits
    assert (limits[0].lower, limits[0].upper) == pytest.approx((-1.0, 0.5), abs=1.0 / PULSES_PER_RAD)
    assert limits[0].lower >= -1.0
    assert limits[0].upper <= 0.5


@pytest.mark.parametrize(
    ("a", "b", "sentence"),
    [
        (A, "{joint: b, id: 0}", "servos a and b both have id 0"),
        (A, "{joint: b}", "some servos have an id and some have none"),
        (A, "{joint: b, id: 253}", "id"),
        (A, "{joint: b, id: 1, pulse_max: 4096}", "0 <= pulse_min <= rest_pulse <= pulse_max <= 4095"),
        (A, "{joint: b, id: 1, zero_byte: 3}", "unknown key; did you mean zero_pulse"),
        (A, "{joint: b, id: 1, speed: 0.0}", "speed"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(tmp_path: Path, a: str, b: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence) as caught:
        load_scene(write(tmp_path, a, b))
    assert "board" in str(caught.value)


def test_a_rest_outside_the_limits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"rest_pulse 1000 is outside .* 1723\.\.2699; change"):
        ServoDriver(load_scene(write(tmp_path, "{joint: a, id: 0, sign: -1, rest_pulse: 1000}")))


def test_a_calibration_of_a_bus_is_written_and_read(tmp_path: Path) -> None:
    robot = load_scene(write(tmp_path))
    assert robot.board is not None
    changed = (replace(robot.board.bus_servos[0], zero_pulse=2060, speed=2.5), robot.board.bus_servos[1])
    file = tmp_path / "mine.yaml"
    save_calibration(file, "two", changed)
    board = calibrated_robot(robot, file).board
    assert board is not None
    assert board.servos == changed
    file.write_text("robot: two\nservos: [{joint: a, trim_deg: 1.0}]")
    with pytest.raises(ConfigError, match="trim_deg: unknown key; known keys: joint, id, zero_pulse"):
        calibrated_robot(robot, file)
    file.write_text("robot: two\nservos: [{joint: a, zero_pulse: 1.5}]")
    with pytest.raises(ConfigError, match="must be a whole number"):
        calibrated_robot(robot, file)


def test_the_walk_through_hobby_servos_says_that_these_are_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert softsim(["calibrate-servos", str(write(tmp_path)), "--port", "/dev/null"]) != 0
    assert "the servos of two are on a bus" in capsys.readouterr().err
