"""How the bridge's benchmark counts: each command against the first packet that follows it."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import (
    BridgeFigures,
    Crossing,
    latencies,
)
from servo_bridge.emulator import ReceivedPacket


def packets(*rows: tuple[float, int]) -> list[ReceivedPacket]:
    return [ReceivedPacket(time_s, (servo_byte, 130, 130)) for time_s, servo_byte in rows]


def test_a_command_is_followed_by_the_first_packet_with_its_byte() -> None:
    found, missed = latencies(
        [Crossing(0.01, 0, 129), Crossing(0.05, 0, 130)],
        packets((0.00, 130), (0.02, 130), (0.03, 129), (0.045, 129), (0.0625, 130)),
    )
    assert missed == 0
    np.testing.assert_allclose(found, [20.0, 12.5])


def test_a_command_that_the_next_one_overtakes_is_missed() -> None:
    crossings = [Crossing(0.01, 0, 129), Crossing(0.05, 0, 130), Crossing(0.06, 1, 129)]
    _, missed = latencies(crossings, packets((0.02, 130), (0.04, 130), (0.055, 130)))
    assert missed == 1


@pytest.mark.parametrize(("last", "late"), [(20.0, False), (500.0, True)])
def test_the_verdict_looks_at_the_slowest_hundredth(last: float, late: bool) -> None:
    figures = BridgeFigures("x", np.array([10.0] * 49 + [last]), 0, np.array([20.0, 21.0]), 20.0)
    assert figures.late is late
    assert ("MISSED" in figures.lines()[1]) is late
