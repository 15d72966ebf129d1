"""The build with an IMU: the text protocol of the closed loop, a sensor's registers on the emulated bus."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from firmware_build import build
from firmware_line import TOLERANCE_US, ideal

from servo_bridge.emulator import EmulatedBoard, I2cRegisters
from servo_bridge.protocols import ASCII_BAUD_RATE, LineParser, encode_line

IMU_ADDRESS = 0x28
CHIP_ID = 0xA0
MODE, FUSION = 0x3D, 0x0C
SECOND_ANGLE, THIRD_ANGLE = 0x1C, 0x1E


@pytest.fixture(scope="module")
def imu_firmware() -> Path:
    return build("-DIMU")


@pytest.fixture
def sensor() -> I2cRegisters:
    device = I2cRegisters(IMU_ADDRESS)
    device.registers[0] = CHIP_ID
    return device


@pytest.fixture
def imu_board(imu_firmware: Path, sensor: I2cRegisters, emulator: None) -> Callable[[], EmulatedBoard]:
    """Makes a board with the sensor, and lets it find the sensor."""

    def make() -> EmulatedBoard:
        board = EmulatedBoard(imu_firmware, baud_rate=ASCII_BAUD_RATE)
        board.processor.attach(sensor)
        board.run(1.5)
        board.take_transmitted()
        return board

    return make


def measure(sensor: I2cRegisters, second_deg: float, third_deg: float) -> None:
    """Let the sensor show Euler angles."""
    for register, angle in ((SECOND_ANGLE, second_deg), (THIRD_ANGLE, third_deg)):
        sensor.registers[register : register + 2] = round(16 * angle).to_bytes(2, "little", signed=True)


def said(board: EmulatedBoard, line: bytes) -> bytes:
    """The answer to a line."""
    board.take_transmitted()
    board.feed(line)
    board.run(0.02)
    return board.take_transmitted()


def test_the_sensor_is_found_and_set_to_fusion(
    imu_board: Callable[[], EmulatedBoard], sensor: I2cRegisters
) -> None:
    imu_board()
    assert sensor.registers[MODE] == FUSION


@pytest.mark.parametrize(
    ("second", "third", "line"),
    [
        (0.0, 180.0, b"0.0000,0.0000,\r\n"),
        (0.0, -180.0, b"0.0000,0.0000,\r\n"),
        (12.5, 170.0, b"-10.0000,-12.5000,\r\n"),
        (-0.0625, -179.9375, b"0.0625,0.0625,\r\n"),
        (-89.0, -90.0, b"90.0000,89.0000,\r\n"),
        (0.0, 0.0, b"-180.0000,0.0000,\r\n"),
    ],
)
def test_angles_are_turned_for_a_sensor_mounted_upside_down(
    imu_board: Callable[[], EmulatedBoard], sensor: I2cRegisters, second: float, third: float, line: bytes
) -> None:
    measure(sensor, second, third)
    assert said(imu_board(), encode_line([90, 120, 150])) == line


def test_the_bridge_reads_the_answers(imu_board: Callable[[], EmulatedBoard], sensor: I2cRegisters) -> None:
    measure(sensor, 12.5, 170.0)
    board, parser = imu_board(), LineParser()
    parser.feed(said(board, encode_line([90, 120, 150])))
    readings = parser.feed(said(board, encode_line([90, 120, 150])))
    assert [(math.degrees(r.tilt_x), math.degrees(r.tilt_y)) for r in readings] == [
        pytest.approx((-12.5, -10.0))
    ]


def test_lines_move_the_servos(imu_board: Callable[[], EmulatedBoard]) -> None:
    board = imu_board()
    for _ in range(40):
        said(board, encode_line([90, 120, 150]))
    assert board.widths_us() == pytest.approx(ideal(90, 120, 150), abs=TOLERANCE_US)
    for bad in (b"90 120\n", b"90 120 59\n", b"90 120 181\n", b"90 120 150 1\n", b"1e2 120 150\n", b"x\n"):
        assert said(board, bad).endswith(b",\r\n")
    board.run(0.3)
    assert board.widths_us() == pytest.approx(ideal(90, 120, 150), abs=TOLERANCE_US)


def test_silence_never_moves_a_servo(imu_board: Callable[[], EmulatedBoard]) -> None:
    board = imu_board()
    for _ in range(40):
        said(board, encode_line([90, 120, 170]))
    board.run(10.0)
    assert board.widths_us() == pytest.approx(ideal(90, 120, 170), abs=TOLERANCE_US)


def test_nothing_is_said_unasked_and_a_missing_sensor_is_told(
    imu_board: Callable[[], EmulatedBoard], sensor: I2cRegisters
) -> None:
    sensor.present = False
    board = imu_board()
    board.run(2.0)
    assert board.transmitted == b""
    assert said(board, encode_line([90, 120, 150])) == b"no imu\r\n"
    board.run(0.03)
    assert board.widths_us() == pytest.approx(ideal(90, 120, 150), abs=TOLERANCE_US)
    sensor.present = True
    board.run(2.0)
    assert said(board, encode_line([90, 120, 150])).endswith(b",\r\n")
    assert board.resets == 1
