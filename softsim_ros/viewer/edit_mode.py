"""The edit mode of the page: what stays of it when the page is made anew, and its drawing."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Final

from softsim_core.errors import SoftSimError
from softsim_ros.client.editing import Editing
from softsim_ros.client.services import Outcome
from softsim_ros.viewer.edit_session import EditSession
from softsim_ros.viewer.edit_stage import EditStage
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.picture import Picture

Action = Callable[[], "str | None"]
"""What a person does; returns a sentence for them, or none."""

MOST_WAITING: Final = 50


class EditMode:
    """Session and stage of the edit mode.

    A person may be faster than the simulator: what they do waits until it is known what came of what they did
    before, so that all of it happens, in its order, to the scene that they meant.

    Args:
        server: viser's server.
        inbox: Where events of browsers go.
        picture: Shows what runs, which is put aside while somebody edits.
        editing: The simulator's side.
        say: Called with sentences for the person.

    Attributes:
        session: What is edited; it stays when another scene begins.
    """

    def __init__(
        self, server: Any, inbox: Inbox, picture: Picture, editing: Editing, say: Callable[[str], None]
    ) -> None:
        self._server, self._inbox, self._picture = server, inbox, picture
        self._say, self._editing = say, editing
        self.session = EditSession(editing.change)
        self._stage: EditStage | None = None
        self._drawn: object = None
        self._waiting: deque[Action] = deque()

    def build(self) -> None:
        """Begin anew on an empty 3-D scene."""
        self._stage = EditStage(
            self._server.scene, self._inbox, self.session, self.attempt, lambda: self.is_behind
        )
        self._drawn = None
        self.show()

    def turn(self, on: bool) -> None:
        """Show the proposal in place of what runs, or what runs."""
        self.session.is_on = on
        if on:
            self.ask("begin")
        self.show()

    def ask(self, name: str) -> None:
        """Ask the simulator for something by name; what was applied is looked at while it runs."""

        def done(end: Outcome) -> None:
            if end.success and name == "apply":
                self.turn(False)

        self.attempt(lambda: self._editing.ask(name, done))

    @property
    def is_behind(self) -> bool:
        """What the session knows is older than what was asked for."""
        return self._editing.is_behind or self._editing.proposal is not self.session.told

    def attempt(self, action: Action) -> None:
        """Carry out an action of a person in its turn, and say what it returns or why it is refused."""
        if len(self._waiting) >= MOST_WAITING:
            self._say(f"{MOST_WAITING} actions wait for the simulator's answer; wait until it tells")
        else:
            self._waiting.append(action)
            self._go_on()

    def _go_on(self) -> None:
        """Carry out what waits, as far as it is known what came of what was before it."""
        while self._waiting and not self.is_behind:
            self._carry_out(self._waiting.popleft())

    def _carry_out(self, action: Action) -> None:
        try:
            sentence = action()
        except SoftSimError as error:
            sentence = str(error)
        if sentence:
            self._say(sentence)

    def refresh(self) -> None:
        """Draw what was told since the last time."""
        told = self._editing.proposal
        if told is not None and told is not self.session.told:
            self.session.take(told)
            self.show()
        elif self._bodies is not self._drawn:
            self.show()
        self._go_on()

    @property
    def _bodies(self) -> object:
        """The bodies that are to be drawn; None: what runs is shown."""
        return self._picture.rest if self.session.is_on and self.session.robot is not None else None

    def show(self) -> None:
        """Draw the proposal in place of what runs, or what runs again."""
        assert self._stage is not None  # as after `build`
        bodies, (parts, points) = self._bodies, self._picture.rest
        self._picture.put_aside(bodies is not None)
        with self._server.atomic():
            if bodies is not self._drawn:
                self._stage.show_bodies(() if bodies is None else parts, points)
                self._drawn = bodies
            self._stage.show()
