"""The back-off between tries."""

from __future__ import annotations

from servo_bridge.recovery import Recovery


def test_tries_are_due_after_half_one_two_four_and_then_every_five_seconds() -> None:
    recovery, now, due = Recovery(), 10.0, []
    recovery.want("activate", now, wait=True)
    for tick in range(1, 4000):
        now = 10.0 + tick / 100.0
        if recovery.due(now):
            due.append(round(now - 10.0, 1))
            recovery.failed(now)
    assert due == [0.5, 1.5, 3.5, 7.5, 12.5, 17.5, 22.5, 27.5, 32.5, 37.5]


def test_at_start_the_first_try_is_due_at_once() -> None:
    recovery = Recovery()
    recovery.want("configure", 3.0, wait=False)
    assert recovery.due(3.0)
    recovery.give_up()
    assert not recovery.due(100.0)
    recovery.want("none", 3.0, wait=False)
    assert not recovery.due(100.0)
