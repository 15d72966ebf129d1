"""The thread that keeps the rate of packets."""

from __future__ import annotations

import threading
import time

from waiting import DEADLINE_S, spin_until

from servo_bridge.driver import PeriodicThread


def test_no_call_comes_before_its_beat() -> None:
    times: list[float] = []
    enough = threading.Event()

    def tick() -> None:
        times.append(time.monotonic())
        if len(times) >= 50:
            enough.set()

    begun = time.monotonic()
    thread = PeriodicThread(tick, 0.005)
    assert enough.wait(DEADLINE_S)
    thread.stop()
    assert thread.join(DEADLINE_S)
    assert thread.figures() is not None
    assert all(moment - begun >= 0.005 * beat for beat, moment in enumerate(times))


def test_a_call_that_takes_long_leaves_calls_out_instead_of_queueing_them() -> None:
    starts: list[float] = []
    enough = threading.Event()

    def tick() -> None:
        starts.append(time.monotonic())
        if len(starts) == 1:
            spin_until(lambda: time.monotonic() > starts[0] + 0.055)  # five and a half periods
        if len(starts) == 4:
            enough.set()

    begun = time.monotonic()
    thread = PeriodicThread(tick, 0.01)
    assert enough.wait(DEADLINE_S)
    thread.stop()
    assert thread.join(DEADLINE_S)
    figures = thread.figures()
    assert figures is not None
    assert figures.missed >= 5
    assert starts[3] - begun >= 0.01 * (3 + 5)


def test_it_can_stop_itself_and_be_joined_from_its_own_call() -> None:
    done = threading.Event()

    def tick() -> None:
        thread.stop()
        thread.join()
        done.set()

    ready = threading.Event()
    thread = PeriodicThread(lambda: ready.wait() and tick(), 0.001)
    ready.set()
    assert done.wait(DEADLINE_S)
    thread.join()
    assert thread.figures() is None


def test_a_hurried_call_comes_at_once_and_the_beat_goes_on_from_it() -> None:
    calls = 0
    came = threading.Condition()

    def tick() -> None:
        nonlocal calls
        with came:
            calls += 1
            if calls > 1:
                thread.period = 0.001 if calls == 2 else 3600.0  # until the next call
            came.notify_all()

    thread = PeriodicThread(tick, 3600.0)
    with came:
        assert came.wait_for(lambda: calls == 1, DEADLINE_S)
    thread.hurry()
    with came:
        assert came.wait_for(lambda: calls == 3, DEADLINE_S)
    thread.stop()
    assert thread.join(DEADLINE_S)
