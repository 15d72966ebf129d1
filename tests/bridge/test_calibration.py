"""Calibration: the file, what a person's answers mean, and the walk itself on a virtual board."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from servo_bridge import PortError
from servo_bridge.driver import (
    BOARD_USB_IDS,
    CLONE_USB_IDS,
    CalibrationAbortedError,
    ServoDriver,
    ServoMover,
    ServoObservation,
    angle_to_byte,
    apply_observation,
    byte_to_angle,
    calibrate,
    calibrated_robot,
    calibration,
    default_file,
    file_for,
    load_calibration,
    save_calibration,
)
from servo_bridge.emulator import VirtualBoard
from softsim_core.base import ConfigError, SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    BoardDescription,
    JointDescription,
    RobotDescription,
    SceneDescription,
    ServoCalibration,
)

SERVOS = tuple(ServoCalibration(joint=name) for name in "ab")
LIMITS = JointLimits(-2.0225, -0.0255, 20.0, 1000.0)
ROBOT = RobotDescription(
    scene=SceneDescription(
        name="two", joints=tuple(JointDescription(name=name, limits=LIMITS) for name in "ab")
    ),
    board=BoardDescription(servos=SERVOS, rate=200.0),
    poses={"start": (-1.4965, -1.0)},
)


def write(file: Path, text: str) -> Path:
    file.write_text(text)
    return file


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    changed = (
        replace(SERVOS[0], sign=-1, zero_byte=61, rest_byte=90, trim_deg=-2.375),
        replace(SERVOS[1], byte_min=70, byte_max=170),
    )
    file = tmp_path / "new" / "two.yaml"
    save_calibration(file, "two", changed)
    assert load_calibration(file, "two", SERVOS) == changed
    assert list(file.parent.iterdir()) == [file]
    board = calibrated_robot(ROBOT, file).board
    assert board is not None
    assert board.servos == changed


def test_keys_and_servos_left_out_stay_the_robots_own(tmp_path: Path) -> None:
    file = write(tmp_path / "c.yaml", "robot: two\nservos:\n  - {joint: b, trim_deg: 3}\n")
    assert load_calibration(file, "two", SERVOS) == (SERVOS[0], replace(SERVOS[1], trim_deg=3))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("robot: other\nservos: []\n", "robot: must be two, not 'other'"),
        ("robot: two\n", "servos: must be a list"),
        ("robot: two\nservos: []\nspeed: 3\n", "speed: is no key of a calibration"),
        ("robot: two\nservos: [{joint: c}]\n", r"servos\[0\].joint: 'c' drives no servo; known: a, b"),
        ("robot: two\nservos: [{joint: a}, {joint: a}]\n", r"servos\[1\].joint: a occurs twice"),
        ("robot: two\nservos: [7]\n", r"servos\[0\].joint: None drives no servo"),
        (
            "robot: two\nservos: [{joint: a, trimm: 1}]\n",
            r"servos\[0\].trimm: unknown key; did you mean trim_deg",
        ),
        ("robot: two\nservos: [{joint: a, sign: 2}]\n", r"sign: must be one of 1, -1, not 2"),
        ("robot: two\nservos: [{joint: a, trim_deg: .nan}]\n", "trim_deg: must be a number, not nan"),
        ("robot: two\nservos: [{joint: a, zero_byte: 1.5}]\n", "zero_byte: must be a whole number"),
        ("robot: two\nservos: [{joint: a, byte_min: true}]\n", "byte_min: must be a whole number"),
        ("robot: two\nservos: [{joint: a, byte_min: 170}]\n", "byte_min <= rest_byte <= byte_max"),
    ],
)
def test_a_wrong_file_is_a_sentence_with_file_and_key(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence) as caught:
        load_calibration(write(tmp_path / "c.yaml", text), "two", SERVOS)
    assert str(tmp_path / "c.yaml") in str(caught.value)


def test_a_file_that_cannot_be_written_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "two.yaml"
    save_calibration(file, "two", SERVOS)
    before = file.read_bytes()

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(calibration.os, "fsync", full)
    with pytest.raises(ConfigError, match=r"cannot be written \(No space left on device\)"):
        save_calibration(file, "two", SERVOS)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_the_default_file_is_used_where_it_exists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert file_for("auto", "two") is None
    save_calibration(default_file("two"), "two", SERVOS)
    assert file_for("auto", "two") == tmp_path / "softsim" / "servos" / "two.yaml"
    assert file_for("", "two") is None
    assert file_for("/x/y.yaml", "two") == Path("/x/y.yaml")


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("offset", [-7.0, 0.0, 3.0])
def test_at_the_reference_the_servo_is_sent_what_proved_right(mirrored: bool, offset: float) -> None:
    servo = ServoCalibration(joint="a", trim_deg=1.5)
    reference = byte_to_angle(100, servo)
    after = apply_observation(servo, ServoObservation(mirrored, reference, offset))
    assert abs(angle_to_byte(reference, after) - (100 + offset)) <= 1
    assert (after.sign == -1) == mirrored
    if not mirrored:  # the rest angle stays where it was
        assert byte_to_angle(after.rest_byte, after) == pytest.approx(
            byte_to_angle(150, servo), abs=math.radians(1.0)
        )


def test_nothing_seen_changes_nothing_and_an_empty_range_is_refused() -> None:
    servo = ServoCalibration(joint="a")
    assert apply_observation(servo, ServoObservation(False, -1.4965, 0.0)) == servo
    with pytest.raises(SceneError, match="byte_min <= rest_byte"):
        apply_observation(servo, ServoObservation(False, -1.4965, 0.0, 150, 140))


@pytest.fixture
def mover(tmp_path: Path) -> Iterator[ServoMover]:
    with VirtualBoard(servos=2, link=tmp_path / "board") as board:
        driver = ServoDriver(ROBOT)
        driver.connect(board.port)
        made = ServoMover(driver)
        made.board = board  # type: ignore[attr-defined]
        made.wait_for_board(60.0)
        yield made
        made.close()
        driver.disconnect()


@pytest.mark.slow
def test_the_walk_asks_moves_and_returns_what_was_seen(mover: ServoMover) -> None:
    questions: list[str] = []
    answers = iter(  # servo a: 3.5 degrees more, its upper end 5 degrees back; servo b: mirrored
        ["again", "y", "+", "++", "rubbish", "-2.5", "", "", "--", "", "n", "", "", ""]
    )

    def ask(question: str) -> str:
        questions.append(question)
        return next(answers)

    first, second = calibrate(ROBOT, mover, ask, lambda line: None)
    assert first.trim_deg == pytest.approx(3.5)
    assert (first.byte_min, first.byte_max) == (60, 172)
    assert second.sign == -1
    assert next(answers, None) is None
    assert any("[+6 deg, byte 99]" in question for question in questions)
    board: VirtualBoard = mover.board  # type: ignore[attr-defined]
    for before, after in pairwise(board.packets):  # two periods of 5 ms at 20 rad/s, and the floor of a byte
        for one, other in zip(before.servo_bytes, after.servo_bytes, strict=True):
            assert abs(one - other) <= math.degrees(20.0) * 0.01 + 2.0
    seen = [packet.servo_bytes for packet in board.packets]
    assert {min(pose[0] for pose in seen), max(pose[0] for pose in seen)} == {63, 177}


def test_q_ends_without_a_result(mover: ServoMover) -> None:
    with pytest.raises(CalibrationAbortedError, match="nothing was written"):
        calibrate(ROBOT, mover, lambda question: " Q ", lambda line: None)


def test_a_board_that_vanishes_on_the_way_is_a_sentence(mover: ServoMover) -> None:
    board: VirtualBoard = mover.board  # type: ignore[attr-defined]

    def ask(question: str) -> str:
        board.unplug()
        return "again"

    with pytest.raises(PortError, match="vanished"):
        calibrate(ROBOT, mover, ask, lambda line: None)


def test_the_udev_rules_name_every_board_that_is_searched_for() -> None:
    rules = (Path(__file__).resolve().parents[2] / "configs" / "udev" / "99-tripod.rules").read_text()
    pairs = re.findall(r'idVendor}=="(\w{4})", ATTRS\{idProduct}=="(\w{4})"', rules)
    assert {(int(v, 16), int(p, 16)) for v, p in pairs} == BOARD_USB_IDS | CLONE_USB_IDS
