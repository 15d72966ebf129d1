"""Controls of the page, served in the node's own thread."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final


class Spoken:
    """The newest sentence for the person.

    Attributes:
        sentence: Empty: nothing was said.
    """

    def __init__(self) -> None:
        self.sentence = ""

    def say(self, sentence: str) -> None:
        """Show one sentence."""
        self.sentence = sentence


HOLD_S: Final = 1.0
"""A control that was changed by hand stays as it is this long, in [s], before it follows the robot again."""


class Inbox:
    """What browsers did, in order, handed over from viser's thread to the node's.

    Plain callbacks run in a pool of viser's, out of order; `async` ones run in order in its own thread, where
    nothing may wait. So every callback here only puts an action into the queue.
    """

    def __init__(self) -> None:
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._page = 0

    def turn_page(self) -> None:
        """The controls are made anew: changes of the old ones that are still here go nowhere."""
        self._page += 1

    def put(self, action: Callable[[], None]) -> None:
        """Leave an action for the node's thread."""
        self._actions.put(action)

    def take(self) -> Iterator[Callable[[], None]]:
        """The actions left so far, oldest first."""
        for _ in range(self._actions.qsize()):
            yield self._actions.get()

    def on_click(self, button: Any, action: Callable[[], None]) -> None:
        """Run an action whenever a button is clicked."""

        async def clicked(_: Any) -> None:
            self.put(action)

        button.on_click(clicked)

    def on_press(self, row: Any, actions: Mapping[str, Callable[[], None]]) -> None:
        """Run the action of the button that is pressed in a row of them."""

        async def pressed(event: Any) -> None:
            if event.target.value in actions:
                self.put(actions[event.target.value])

        row.on_click(pressed)

    def on_change(self, handle: Any, action: Callable[[Any], None]) -> Control:
        """Run an action with the new value whenever a person changes a control of the present page."""
        control, page = Control(handle, action), self._page

        async def changed(event: Any) -> None:
            if event.client_id is not None:
                value = event.target.value
                self.put(lambda: control.take(value) if page == self._page else None)

        handle.on_update(changed)
        return control

    def on_key(self, command: Any, action: Callable[[], None]) -> None:
        """Run an action whenever the key of a command is pressed."""

        async def pressed(_: Any) -> None:
            self.put(action)

        command.on_trigger(pressed)


class Control:
    """A control with a value, which follows the robot and which a person changes.

    The page commands nothing by itself: whatever a browser sends, only a value that differs from the one on
    the page by more than its rounding counts as a person's.

    Args:
        handle: viser's control.
        action: Called with the value that a person has given.
    """

    def __init__(self, handle: Any, action: Callable[[Any], None]) -> None:
        self._handle, self._action = handle, action
        self._on_page = handle.value
        self._differed = False
        self._taken_at = -float("inf")

    def show(self, value: Any) -> None:
        """Show what the robot has, unless a person has just changed it.

        viser gives the handle a person's value before that is taken here. So a value that differs while the
        robot's is the one shown before may be such a one: it is replaced only if it was there at the last
        call too, and has been taken since.
        """
        differed, self._differed = self._differed, value != self._handle.value
        news = value != self._on_page or differed
        if self._differed and news and time.monotonic() - self._taken_at > HOLD_S:
            self._handle.value = self._on_page = value

    def take(self, value: Any) -> None:
        """Act on what a person has given."""
        if self._is_on_page(value):
            return
        self._on_page, self._taken_at = value, time.monotonic()
        self._action(value)

    def _is_on_page(self, value: Any) -> bool:
        step = getattr(self._handle, "step", None)
        if step is None or isinstance(value, bool):
            return bool(value == self._on_page)
        return bool(abs(value - self._on_page) < 0.5 * step)


class Shown:
    """A piece of HTML that is sent only when it changes."""

    def __init__(self, handle: Any) -> None:
        self._handle, self._content = handle, ""

    def show(self, content: str) -> None:
        """Show this content."""
        if content != self._content:
            self._content = content
            self._handle.content = content
