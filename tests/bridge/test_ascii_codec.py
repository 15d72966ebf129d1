"""The text protocol with IMU: lines out, angles in, whatever else the board says."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings, strategies as st

from servo_bridge import PacketError
from servo_bridge.protocols import LineParser, TiltReading, encode_line, parse_line


def test_servo_bytes_become_a_line_of_text() -> None:
    assert encode_line((93, 119, 134)) == b"93 119 134\n"
    with pytest.raises(PacketError, match=r"181 refused: allowed are 60\.\.180"):
        encode_line((93, 181, 134))


@pytest.mark.parametrize(
    ("line", "first", "second"),
    [
        (b"1.2500,-3.0000,", 1.25, -3.0),
        (b"-179.9375,0.0625,", -179.9375, 0.0625),
        (b" 10 , 20 , 30.5", 10.0, 20.0),
        (b"0.0000,0.0000,", 0.0, 0.0),
    ],
)
def test_the_first_angle_is_about_y_and_the_second_about_x(line: bytes, first: float, second: float) -> None:
    reading = parse_line(line)
    assert reading is not None
    assert reading.tilt_y == pytest.approx(math.radians(first))
    assert reading.tilt_x == pytest.approx(math.radians(second))


@pytest.mark.parametrize(
    "line",
    [b"", b"1.0", b"1.0,2.0", b"nan,1.0,", b"inf,1,", b"1e3,1,", b"1,2,3,4", b"361.0,0.0,", b"\xff1,2,",
     b"Orientation Sensor Test", b"1.0;2.0;", b"1.0.0,2.0,", b"--1,2,"],
)  # fmt: skip
def test_other_text_is_no_reading(line: bytes) -> None:
    assert parse_line(line) is None


def test_start_up_text_and_a_cut_first_line_are_passed_over() -> None:
    stream = b"5,9.0,\r\nOrientation Sensor Test\r\n\r\nCalibrated!\r\n1.0,2.0,\r\n3.0,4.0,\r\n5.0,"
    whole, bytewise = LineParser(), LineParser()
    readings = whole.feed(stream)
    assert [round(math.degrees(reading.tilt_y), 9) for reading in readings] == [1.0, 3.0]
    assert [found for value in stream for found in bytewise.feed(bytes([value]))] == readings
    assert (whole.accepted, whole.ignored) == (bytewise.accepted, bytewise.ignored) == (2, 2)


def test_a_line_without_end_is_given_up() -> None:
    parser = LineParser()
    parser.feed(b"\r\n" + b"x" * 10_000)
    assert parser.ignored == 1
    assert len(parser.feed(b"1,2,\r\n3,4,\r\n")) == 1


@settings(derandomize=True, max_examples=300)
@given(st.binary(max_size=300))
def test_any_bytes_are_survived_and_a_line_after_them_is_read(data: bytes) -> None:
    parser = LineParser()
    parser.feed(data)
    assert parser.feed(b"\r\n7.5,-7.5,\r\n")[-1] == parse_line(b"7.5,-7.5,")


@settings(derandomize=True)
@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_the_quaternion_turns_up_as_the_tilts_say(tilt_x: float, tilt_y: float) -> None:
    x, y, z, w = TiltReading(tilt_x, tilt_y).quaternion_xyzw()
    assert math.hypot(x, y, z, w) == pytest.approx(1.0)
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))  # third row of the matrix
    assert math.asin(max(min(up[1], 1.0), -1.0)) == pytest.approx(tilt_x, abs=1e-9)
    assert math.atan2(-up[0], up[2]) == pytest.approx(tilt_y, abs=1e-9)
