"""Due times of steps and rates of topics, on a clock of the test."""

from __future__ import annotations

import pytest

from softsim_ros.nodes.simulator import Pacer, RateGate, SpeedMeter


def test_steps_keep_their_schedule_whatever_each_costs() -> None:
    pacer, now, began = Pacer(), 100.0, 100.0
    for cost in [0.001, 0.009, 0.015, 0.002] * 25:
        now += cost
        now += pacer.wait_s(now, 0.01)
    assert now - began == pytest.approx(100 * 0.01 + 0.001)  # the schedule starts after the first step
    assert pacer.late_s == 0.0


def test_falling_behind_starts_the_schedule_anew_and_is_counted() -> None:
    tick = 1.0 / 64.0  # exact in binary
    pacer, now = Pacer(tolerance_s=8 * tick), 0.0
    waits = []
    for _ in range(50):
        now += 2 * tick  # each step takes twice its time
        waits.append(pacer.wait_s(now, tick))
    assert max(waits[1:]) == 0.0
    assert pacer.late_s == 45 * tick


def test_a_short_delay_is_caught_up() -> None:
    pacer = Pacer(tolerance_s=0.1)
    assert pacer.wait_s(0.0, 0.01) == pytest.approx(0.01)
    assert pacer.wait_s(0.06, 0.01) == 0.0
    assert pacer.wait_s(0.06, 0.01) == 0.0
    assert pacer.late_s == 0.0


def test_as_fast_as_possible_never_waits() -> None:
    pacer = Pacer()
    assert pacer.wait_s(0.0, 0.0) == pacer.wait_s(9.0, 0.0) == 0.0
    assert pacer.late_s == 0.0


def test_a_rate_gate_has_no_drift_and_no_burst() -> None:
    gate = RateGate(1.0 / 30.0)
    passed = [step for step in range(1000) if gate.passes(step * 0.01)]
    assert len(passed) == 300
    gate = RateGate(0.1)
    assert [gate.passes(t) for t in (0.0, 0.05, 0.1, 5.0, 5.01, 5.1)] == [
        True,
        False,
        True,
        True,
        False,
        True,
    ]


def test_the_meter_gives_the_real_time_factor_and_mean_stage_times() -> None:
    meter = SpeedMeter(0.01, now=10.0)
    for _ in range(50):
        meter.add_step({"assemble": 0.2, "step": 0.5})
    speed = meter.take(11.0)
    assert speed.real_time_factor == pytest.approx(0.5)
    assert speed.steps_per_second == pytest.approx(50.0)
    assert speed.stages_ms == pytest.approx({"assemble": 0.2, "step": 0.5})
    assert meter.take(12.0).real_time_factor == 0.0


def test_the_meter_keeps_the_smallest_and_the_largest_time_of_a_stage() -> None:
    meter = SpeedMeter(0.01, now=0.0)
    for time_ms in (0.5, 0.2, 0.8):
        meter.add_step({"step": time_ms})
    stage = meter.take(1.0).stages["step"]
    assert (stage.calls, stage.minimum, stage.maximum) == (3, 0.2, 0.8)
    assert stage.mean == pytest.approx(0.5)
