"""The edit mode of a page whose person is faster than the simulator: nothing is lost, and in its order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

import rclpy
from std_srvs.srv import Trigger
from waiting import spin_until

from softsim_core.scene.editing import Put
from softsim_ros.client import Editing
from softsim_ros.messages import Proposal, write_proposal
from softsim_ros.nodes.viewer import MOST_WAITING, EditMode


class Bench:
    """An edit mode, and a simulator that answers when the test says so."""

    def __init__(self, node: Any) -> None:
        self.asked: list[str] = []
        self.said: list[str] = []
        self.revision = 0
        self.editing = Editing(node, self.said.append)
        for name in ("undo", "redo"):
            self.editing._requests[name] = SimpleNamespace(  # type: ignore[assignment]
                ask=self._asker(name), is_busy=False, expire=lambda now: None
            )
        self.editing._edits = SimpleNamespace(publish=lambda message: self.asked.append("edit"))
        server: Any = SimpleNamespace(atomic=nullcontext)
        picture: Any = SimpleNamespace(rest=((), None), hide_scene=lambda hidden: None)
        self.mode = EditMode(server, SimpleNamespace(), picture, self.editing, self.said.append)  # type: ignore[arg-type]
        self.mode._stage = SimpleNamespace(show=lambda: None, show_bodies=lambda *_: None)  # type: ignore[assignment]

    def _asker(self, name: str) -> Callable[..., None]:
        def ask(request: Trigger.Request, done: Any) -> None:
            self.asked.append(name)
            self.editing._requests[name].is_busy = True  # type: ignore[misc]

        return ask

    def tell(self) -> None:
        """The proposal comes, and the page is drawn; a service's answer may come later."""
        self.revision += 1
        self.editing._on_proposal(SimpleNamespace(data=write_proposal(Proposal(self.revision), "")))
        self.mode.refresh()

    def answer(self, name: str) -> None:
        self.editing._requests[name].is_busy = False  # type: ignore[misc]
        self.mode.refresh()


@pytest.fixture
def bench(ros_domain: int) -> Iterator[Bench]:
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node("page", context=context)
    yield Bench(node)
    node.destroy_node()
    context.try_shutdown()


def test_a_second_click_on_undo_waits_for_the_answer_to_the_first(bench: Bench) -> None:
    for _ in range(3):
        bench.mode.ask("undo")
    assert bench.asked == ["undo"]
    bench.tell()
    assert bench.asked == ["undo"]  # what it did is told, but it has not answered: it would be busy
    bench.answer("undo")
    assert bench.asked == ["undo", "undo"]
    bench.tell()
    bench.answer("undo")
    assert bench.asked == ["undo"] * 3
    assert bench.said == []


def test_an_edit_is_made_of_what_is_proposed_and_not_of_an_older_scene(bench: Bench) -> None:
    seen: list[int] = []

    def edit() -> None:
        told = bench.mode.session.proposal
        seen.append(told.revision if told else 0)
        bench.editing.change([Put(("effector",), "tip")])

    for _ in range(3):
        bench.mode.attempt(edit)
    bench.mode.ask("undo")
    assert seen == [0]
    for revision in (1, 2):
        bench.tell()
        assert seen[-1] == revision
        assert bench.asked == ["edit"] * (revision + 1)
    bench.tell()
    assert bench.asked == [*["edit"] * 3, "undo"]


def test_a_simulator_that_is_lost_holds_nothing_up_for_ever(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.mode.attempt(lambda: bench.editing.change([]))
    bench.mode.attempt(lambda: "done")
    assert bench.mode.is_behind
    monkeypatch.setattr("softsim_ros.client.simulator.PROPOSAL_WITHIN_S", 0.0)
    assert spin_until(lambda: bench.editing._expire() or not bench.mode.is_behind)
    bench.mode.refresh()
    assert bench.said == ["done"]


def test_more_than_a_person_does_is_refused_in_words(bench: Bench) -> None:
    bench.mode.attempt(lambda: bench.editing.change([]))
    for _ in range(MOST_WAITING + 1):
        bench.mode.attempt(lambda: None)
    (sentence,) = bench.said
    assert "wait for the simulator's response" in sentence
