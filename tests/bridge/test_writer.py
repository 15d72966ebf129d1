"""The thread that keeps the rate of packets."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

import pytest

from servo_bridge.writer import PeriodicThread


def test_calls_keep_the_rate_on_average() -> None:
    times: list[float] = []
    enough = threading.Event()

    def tick() -> None:
        times.append(time.monotonic())
        if len(times) >= 50:
            enough.set()

    thread = PeriodicThread(tick, 0.005)
    assert enough.wait(10.0)
    thread.stop()
    thread.join()
    figures = thread.figures()
    assert figures is not None
    beats = 49 + figures.missed
    assert abs((times[49] - times[0]) / beats - 0.005) < 0.001


def test_a_call_that_takes_long_leaves_calls_out_instead_of_queueing_them() -> None:
    starts: list[float] = []
    enough = threading.Event()

    def tick() -> None:
        starts.append(time.monotonic())
        if len(starts) == 1:
            threading.Event().wait(0.055)  # five and a half periods
        if len(starts) == 4:
            enough.set()

    thread = PeriodicThread(tick, 0.01)
    assert enough.wait(10.0)
    thread.stop()
    thread.join()
    figures = thread.figures()
    assert figures is not None
    assert figures.missed >= 5
    assert all(later - earlier > 0.001 for earlier, later in pairwise(starts))


def test_it_can_stop_itself_and_be_joined_from_its_own_call() -> None:
    done = threading.Event()

    def tick() -> None:
        thread.stop()
        thread.join()
        done.set()

    ready = threading.Event()
    thread = PeriodicThread(lambda: ready.wait() and tick(), 0.001)
    ready.set()
    assert done.wait(10.0)
    thread.join()
    assert thread.figures() is None


def test_a_hurried_call_comes_at_once_and_the_beat_goes_on_from_it() -> None:
    calls: list[float] = []
    came = threading.Condition()

    def tick() -> None:
        with came:
            calls.append(time.monotonic())
            came.notify_all()

    thread = PeriodicThread(tick, 0.5)
    with came:
        assert came.wait_for(lambda: len(calls) == 1, 10.0)
    asked = time.monotonic()
    thread.hurry()
    with came:
        assert came.wait_for(lambda: len(calls) == 3, 10.0)
    thread.stop()
    thread.join()
    assert calls[1] - asked < 0.25  # half a period: it was not waited for the beat
    assert calls[2] - calls[1] == pytest.approx(0.5, abs=0.2)
