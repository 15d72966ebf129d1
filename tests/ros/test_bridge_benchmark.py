"""`softsim bench --bridge` against a bridge that runs."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from benchmarks import (
    ABOVE_RAD,
    BELOW_RAD,
    measure_bridge,
)
from softsim_core import load_scene

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_commands_are_followed_to_the_line_in_both_arrangements() -> None:
    """How fast is what `softsim bench --bridge` measures; here, that it finds commands on the line."""
    measured = measure_bridge(seconds=4.0)  # a pause of the machine leaves enough of it
    assert ["softsim up" in figures.what for figures in measured] == [False, True]
    for figures in measured:
        assert len(figures.latency_ms) > 0
        assert len(figures.periods_ms) > 0
        assert figures.period_ms == 20.0


@pytest.mark.parametrize(("start", "goal"), [(ABOVE_RAD, -BELOW_RAD), (-BELOW_RAD, ABOVE_RAD)])
def test_the_packet_after_a_command_is_across_the_edge_either_way(start: float, goal: float) -> None:
    limits = load_scene("tripod").joints[0].limits
    position, _ = limits.step(start - 1.0, 0.0, goal - 1.0, 0.02)  # the edge lies at -1 rad
    assert (position + 1.0) * goal > 0.0
