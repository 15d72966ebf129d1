"""The legacy packet: table, every tenth of a degree, exactness at whole degrees, round trip, refusals."""

from __future__ import annotations

import math
from decimal import Decimal, getcontext
from fractions import Fraction

import pytest
from hypothesis import given, settings, strategies as st

from servo_bridge import PacketError
from servo_bridge.driver import angle_to_byte, byte_to_angle, bytes_to_angles
from servo_bridge.protocols import PacketParser, avoid_byte_100, encode_packet
from softsim_core.base import CommandError
from softsim_core.scene import ServoCalibration

getcontext().prec = 60
PI = Fraction(Decimal("3.14159265358979323846264338327950288419716939937510582097494459"))
SERVO = ServoCalibration(joint="servo_0")
SERVOS = tuple(ServoCalibration(joint=f"servo_{i}") for i in range(3))

calibrations = st.builds(
    lambda low, width, rest, zero, sign, trim: ServoCalibration(
        joint="j",
        byte_min=low,
        byte_max=min(low + width, 180),
        rest_byte=min(low + rest, low + width, 180),
        zero_byte=zero,
        sign=sign,
        trim_deg=trim,
    ),
    st.integers(0, 170),
    st.integers(0, 180),
    st.integers(0, 180),
    st.integers(0, 255),
    st.sampled_from([1, -1]),
    st.floats(-30.0, 30.0),
)


def exact_byte(angle_rad: float, servo: ServoCalibration = SERVO) -> int:
    """The byte by exact arithmetic with 60 digits of pi."""
    degrees = servo.sign * Fraction(angle_rad) * 180 / PI + Fraction(servo.trim_deg)
    return min(max(math.floor(degrees) + servo.zero_byte, servo.byte_min), servo.byte_max)


@pytest.mark.parametrize(
    ("angle_rad", "expected"),
    [
        (0.0, 179),
        (-0.0255, 177),
        (-0.785, 134),
        (-1.0, 121),
        (-1.046667, 119),
        (-1.4965, 93),
        (-2.0225, 63),
        (0.0175, 180),
        (1.0, 180),
        (-2.077, 60),
        (-3.0, 60),
        (1e9, 180),
        (-1e9, 60),
        (1.7e308, 180),
        (-1.7e308, 60),
        (5e-324, 179),
        (-5e-324, 178),  # below zero by however little: floor
        (-0.0, 179),
    ],
)
def test_table(angle_rad: float, expected: int) -> None:
    assert angle_to_byte(angle_rad, SERVO) == expected
    assert encode_packet([angle_rad] * 3, SERVOS) == bytes([255, expected, expected, expected])


def test_before_the_start_every_servo_is_sent_150() -> None:
    assert encode_packet(bytes_to_angles([150, 150, 150], SERVOS), SERVOS) == bytes([255, 150, 150, 150])
    assert byte_to_angle(150, SERVO) == pytest.approx(math.radians(-29.0), abs=1e-14)
    assert angle_to_byte(math.radians(-29.0) - 1e-9, SERVO) == 149


def test_every_tenth_of_a_degree_in_the_middle_of_its_interval() -> None:
    for tenths in range(-1300, 200):
        angle_rad = (tenths + 0.5) / 10.0 * math.pi / 180.0
        degrees = math.floor(Fraction(2 * tenths + 1, 20))
        assert angle_to_byte(angle_rad, SERVO) == min(max(degrees + 179, 60), 180)


def test_every_tenth_of_a_degree_is_the_formula_in_its_order_of_operations() -> None:
    for tenths in range(-1300, 200):
        angle_rad = math.radians(tenths / 10.0)
        expected = min(max(math.floor(angle_rad * 180 / math.pi) + 179, 60), 180)
        assert angle_to_byte(angle_rad, SERVO) == expected


def test_beside_whole_degrees_the_byte_is_the_exact_one() -> None:
    """Two roundings move the degrees by at most 1e-13; further from a whole degree the byte is exact."""
    for degree in range(-125, 10):
        edge = math.radians(degree)
        for gap in (1e-14, 1e-12, 1e-9):
            assert angle_to_byte(edge + gap * 3.0, SERVO) == exact_byte(edge + gap * 3.0)
            assert angle_to_byte(edge - gap * 3.0, SERVO) == exact_byte(edge - gap * 3.0)


@settings(derandomize=True, max_examples=500)
@given(st.floats(-4.0, 4.0), calibrations)
@pytest.mark.slow
def test_any_angle_and_calibration_is_exact_away_from_whole_degrees(
    angle_rad: float, servo: ServoCalibration
) -> None:
    degrees = servo.sign * Fraction(angle_rad) * 180 / PI + Fraction(servo.trim_deg)
    if abs(degrees - round(degrees)) > Fraction(1, 10**12):
        assert angle_to_byte(angle_rad, servo) == exact_byte(angle_rad, servo)


@settings(derandomize=True, max_examples=500)
@given(calibrations, st.data())
def test_every_byte_comes_back_from_its_nominal_angle(servo: ServoCalibration, data: st.DataObject) -> None:
    value = data.draw(st.integers(servo.byte_min, servo.byte_max))
    assert angle_to_byte(byte_to_angle(value, servo), servo) == value


@settings(derandomize=True, max_examples=500)
@given(st.floats(allow_nan=True, allow_infinity=True), calibrations)
def test_a_byte_never_leaves_the_servos_range(angle_rad: float, servo: ServoCalibration) -> None:
    if math.isfinite(angle_rad):
        assert servo.byte_min <= angle_to_byte(angle_rad, servo) <= servo.byte_max
    else:
        with pytest.raises(CommandError, match="finite"):
            angle_to_byte(angle_rad, servo)


@settings(derandomize=True)
@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_the_byte_never_falls_as_the_angle_grows(one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert angle_to_byte(low, SERVO) <= angle_to_byte(high, SERVO)


@pytest.mark.parametrize("angles", [[], [0.0], [0.0] * 4])
def test_a_wrong_number_of_angles_is_refused(angles: list[float]) -> None:
    with pytest.raises(CommandError, match="3 servos"):
        encode_packet(angles, SERVOS)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_non_finite_angle_refuses_the_whole_packet(bad: float) -> None:
    with pytest.raises(CommandError, match="servo_1"):
        encode_packet([0.0, bad, 0.0], SERVOS)


def test_byte_100_becomes_101_and_nothing_else_changes() -> None:
    for value in range(60, 181):
        packet = bytes([255, value, 100, 180])
        expected = bytes([255, 101 if value == 100 else value, 101, 180])
        assert avoid_byte_100(packet, SERVOS) == expected
    narrow = ServoCalibration(joint="j", byte_max=100, rest_byte=90)
    assert avoid_byte_100(bytes([255, 100]), [narrow]) == bytes([255, 99])


@pytest.mark.parametrize("bad", [-1, 181, 255])
def test_an_impossible_byte_has_no_angle(bad: int) -> None:
    with pytest.raises(PacketError, match=r"allowed are 0\.\.180"):
        byte_to_angle(bad, SERVO)


def test_decode_is_the_inverse_of_encode() -> None:
    assert PacketParser(3).feed(encode_packet([-1.4965, -1.0, 0.0], SERVOS), 0.0) == [(93, 121, 179)]


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\xff",
        b"\xff\x96\x96",
        b"\xfe\x96\x96\x96",
        b"\xff\x96\x96\x3b",
        b"\xff\x96\x96\xb5",
        b"\xff" * 4,
    ],
)
def test_decode_refuses_what_the_board_would_drop(packet: bytes) -> None:
    assert PacketParser(3).feed(packet, 0.0) == []
