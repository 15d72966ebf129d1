"""Long runs in virtual time: flipped bits never make a servo fast, and a clean line loses nothing."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from benchmarks import resident_mb
from servo_bridge.driver import byte_to_width
from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import frames

pytestmark = pytest.mark.usefixtures("emulator")

PERIOD_S = 0.020
SLEW_US = 61.5  # a frame: 5.96 degrees, just below 300 degrees a second
EDGE_US = 1.0  # what two edges may be off together
LOWEST_US, HIGHEST_US = 544.0, 2400.0


def flipped(data: bytes, rate: float, noise: random.Random) -> bytes:
    """The bytes with each bit turned over with probability `rate`."""
    return bytes(value ^ sum((noise.random() < rate) << bit for bit in range(8)) for value in data)


def packets(kind: str, count: int, choose: random.Random) -> list[bytes]:
    """Packets of poses that jump anywhere every 0.3 s, which the bridge never asks for."""
    pose, made = [150, 150, 150], []
    for index in range(count):
        if index % 15 == 0:
            pose = [choose.randint(60, 180) for _ in range(3)]
        if kind == "legacy":
            made.append(bytes([255, *pose]))
        else:
            widths = [round(byte_to_width(each)) for each in pose]
            made.append(frames.set_widths(index % frames.SEQUENCES, widths))
    return made


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e-3, 1e-2])
@pytest.mark.parametrize("kind", ["legacy", "extended"])
def test_noise_never_makes_a_servo_faster_than_the_slew_limit(kind: str, rate: float) -> None:
    choose, noise = random.Random(6), random.Random(7)
    minutes = 1
    with EmulatedBoard() as board:
        damaged = 0
        for packet in packets(kind, minutes * 3000, choose):
            sent = flipped(packet, rate, noise)
            damaged += sent != packet
            board.feed(sent)
            board.run(PERIOD_S)
        pulses = board.pulses
        assert damaged > 20 * minutes
        for channel in range(3):
            widths = [pulse.width_us for pulse in pulses if pulse.channel == channel]
            assert len(widths) > minutes * 2990  # it never stopped, never hung
            assert max(abs(b - a) for a, b in pairwise(widths)) <= SLEW_US + EDGE_US
            assert min(widths) >= LOWEST_US - EDGE_US
            assert max(widths) <= HIGHEST_US + EDGE_US
        assert board.resets == 1
        for _ in range(80):  # and on a quiet line it goes where it is told
            board.feed(bytes([255, 90, 120, 150]))
            board.run(PERIOD_S)
        assert board.widths_us() == pytest.approx([1472.0, 1781.333, 2090.667], abs=1.5)


@pytest.mark.slow
@pytest.mark.exhaustive
def test_thirty_minutes_lose_no_acknowledgement_and_no_memory() -> None:
    seconds, before = 1800, 0.0
    parser, acknowledged, telemetry = frames.FrameParser(), 0, None
    with EmulatedBoard(log_length=1000) as board:
        sweep = [round(byte_to_width(each)) for each in (*range(90, 150), *range(150, 90, -1))]
        for index in range(seconds * 50):
            at = index % len(sweep)
            widths = [sweep[at], sweep[at - 40], sweep[at - 80]]
            sequence = index % frames.SEQUENCES
            board.feed(frames.set_widths(sequence, widths))
            board.run(PERIOD_S)
            for frame in parser.feed(board.take_transmitted()):
                if frame.kind is frames.FrameType.TELEMETRY:
                    telemetry = frames.read_telemetry(frame)
                    lag = (sequence - telemetry.seq) % frames.SEQUENCES
                    assert lag <= 1, f"frame {index}: {lag} frames not acknowledged"
                    acknowledged += 1
            if index == 5000:
                before = resident_mb("self")
        assert telemetry is not None
        assert (telemetry.rejects, telemetry.overruns, parser.dropped, board.resets) == (0, 0, 0, 1)
        assert acknowledged == pytest.approx(seconds * 20, abs=3)
        assert resident_mb("self") - before < 1.0
