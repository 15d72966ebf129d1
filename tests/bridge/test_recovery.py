"""The back-off between tries."""

from __future__ import annotations

from random import Random

from servo_bridge.driver import DELAYS_S, Recovery


def test_tries_are_due_after_half_one_two_four_and_then_every_five_seconds() -> None:
    recovery, now, due = Recovery(), 10.0, []
    recovery.request("activate", now, wait=True)
    for tick in range(1, 4000):
        now = 10.0 + tick / 100.0
        if recovery.due(now):
            due.append(round(now - 10.0, 1))
            recovery.record_failure(now)
    assert due == [0.5, 1.5, 3.5, 7.5, 12.5, 17.5, 22.5, 27.5, 32.5, 37.5]


def test_at_start_the_first_try_is_due_at_once() -> None:
    recovery = Recovery()
    recovery.request("configure", 3.0, wait=False)
    assert recovery.due(3.0)
    recovery.cancel()
    assert not recovery.due(100.0)
    recovery.request("none", 3.0, wait=False)
    assert not recovery.due(100.0)


def test_jitter_parts_bridges_and_stays_within_its_fraction() -> None:
    recovery, twin, other = (Recovery(0.2, Random(seed)) for seed in (1, 1, 2))
    starts = []
    for each in (recovery, twin, other):
        each.request("activate", 0.0, wait=True)
        now, due = 0.0, []
        while len(due) < 8:
            now += 0.001
            if each.due(now):
                due.append(now)
                each.record_failure(now)
        starts.append(due)
    assert starts[0] == starts[1] != starts[2]
    for due in starts:
        for tries, (before, after) in enumerate(zip([0.0, *due], due, strict=False)):
            delay = DELAYS_S[min(tries, len(DELAYS_S) - 1)]
            assert 0.8 * delay <= after - before <= 1.2 * delay + 0.002
