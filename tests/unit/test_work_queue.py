"""Requests to a thread: done in turn, and what was given up is never done."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from waiting import DEADLINE_S, spin_until

from softsim_core.base import SoftSimError
from softsim_node import WorkQueue, background


class Owner:
    """A thread that serves a queue, and can be kept busy."""

    def __init__(self) -> None:
        self.queue = WorkQueue("the thread", "its work", lambda: self.alive and self.thread.is_alive())
        self.thread = threading.Thread(target=self._run)
        self.alive = True
        self.busy, self.go_on = threading.Event(), threading.Event()
        self.thread.start()

    def _run(self) -> None:
        while self.queue.serve(None, lambda: None):
            pass

    def work(self) -> str:
        self.busy.set()
        self.go_on.wait()
        return "worked"

    def end(self) -> None:
        self.go_on.set()
        self.queue.ask_to_end()
        self.thread.join()


@pytest.fixture
def owner() -> Iterator[Owner]:
    made = Owner()
    yield made
    made.end()


def test_what_is_asked_is_done_and_what_it_raises_is_raised(owner: Owner) -> None:
    assert owner.queue.ask(lambda: threading.current_thread() is owner.thread)
    with pytest.raises(ZeroDivisionError):
        owner.queue.ask(lambda: 1 // 0)
    assert owner.queue.ask(lambda: 3) == 3


def test_what_is_given_up_is_never_done(owner: Owner, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    said: list[str] = []

    def ask_for_work() -> None:
        with pytest.raises(SoftSimError) as caught:
            owner.queue.ask(owner.work)
        said.append(str(caught.value))

    first = threading.Thread(target=ask_for_work)
    first.start()
    assert owner.busy.wait(DEADLINE_S)
    with monkeypatch.context() as patch:
        patch.setattr(background, "REQUEST_TIMEOUT_S", 0.0)
        with pytest.raises(SoftSimError, match="its work takes more than 0 s; it is not done later"):
            owner.queue.ask(lambda: done.append("late"))
    owner.alive = False  # as a thread that is taken for dead in the middle of an action
    first.join()
    assert said == ["request refused: the thread has ended; it has begun, and may still be done"]
    owner.alive = True
    owner.go_on.set()
    assert owner.queue.ask(lambda: "next") == "next"
    assert done == []


def test_of_a_thread_that_has_ended_nothing_can_be_asked(owner: Owner) -> None:
    owner.end()
    assert spin_until(lambda: not owner.thread.is_alive())
    with pytest.raises(SoftSimError, match="the thread has ended; it is not done later"):
        owner.queue.ask(lambda: None)
