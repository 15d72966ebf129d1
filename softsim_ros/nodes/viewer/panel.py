"""Controls of the page, handled in the node's own thread."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from softsim_core.scene import RobotDescription


class LastMessage:
    """The newest message for the user.

    Attributes:
        message: The message; empty if there is none.
    """

    def __init__(self) -> None:
        self.message = ""

    def say(self, message: str) -> None:
        """Set the message."""
        self.message = message


HOLD_S: Final = 1.0
"""Time in [s] for which a control stays as the user set it before it follows the robot again."""


class Inbox:
    """Actions of browsers in order, passed from viser's thread to the node's.

    viser runs plain callbacks in a thread pool, out of order. It runs `async` callbacks in order in its own
    thread, which must not block. Every callback here therefore only puts an action into the queue.
    """

    def __init__(self) -> None:
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._page = 0

    def turn_page(self) -> None:
        """Start a new page of controls; pending changes of the previous controls are dropped."""
        self._page += 1

    def put(self, action: Callable[[], None]) -> None:
        """Queue an action for the node's thread."""
        self._actions.put(action)

    def take(self) -> Iterator[Callable[[], None]]:
        """Yield the queued actions, oldest first."""
        for _ in range(self._actions.qsize()):
            yield self._actions.get()

    def on_click(self, button: Any, action: Callable[[], None]) -> None:
        """Run an action whenever a button is clicked."""

        async def queue_click(_: Any) -> None:
            self.put(action)

        button.on_click(queue_click)

    def on_key(self, command: Any, action: Callable[[], None]) -> None:
        """Run an action whenever the hotkey of a command is pressed."""

        async def queue_key(_: Any) -> None:
            self.put(action)

        command.on_trigger(queue_key)

    def on_press(self, row: Any, actions: Mapping[str, Callable[[], None]]) -> None:
        """Run the action of the pressed button in a row of buttons."""

        async def queue_press(event: Any) -> None:
            if event.target.value in actions:
                self.put(actions[event.target.value])

        row.on_click(queue_press)

    def on_change(self, handle: Any, action: Callable[[Any], None]) -> Control:
        """Run an action with the new value whenever a user changes a control of the present page."""
        control, page = Control(handle, action), self._page

        async def queue_change(event: Any) -> None:
            if event.client_id is not None:
                value = event.target.value
                self.put(lambda: control.take(value) if page == self._page else None)

        handle.on_update(queue_change)
        return control


class Control:
    """A control with a value that follows the robot and that the user can change.

    The page sends no command by itself: only a value that differs from the displayed one by more than its
    rounding counts as the user's, whatever a browser sends.

    Args:
        handle: viser's control.
        action: Called with the value that the user has set.
    """

    def __init__(self, handle: Any, action: Callable[[Any], None]) -> None:
        self._handle, self._action = handle, action
        self._on_page = handle.value
        self._differed = False
        self._taken_at = -float("inf")

    def show(self, value: Any) -> None:
        """Show the robot's value, unless the user has just changed the control.

        viser writes a user's value into the handle before `take` is called. A handle value that differs while
        the robot's value is unchanged may therefore be a new one of the user. It is overwritten only if it
        differed at the last call too, because `take` has been called since.
        """
        differed, self._differed = self._differed, value != self._handle.value
        news = value != self._on_page or differed
        if self._differed and news and time.monotonic() - self._taken_at > HOLD_S:
            self._handle.value = self._on_page = value

    def take(self, value: Any) -> None:
        """Run the action for a value that the user has set."""
        if self._is_on_page(value):
            return
        self._on_page, self._taken_at = value, time.monotonic()
        self._action(value)

    def _is_on_page(self, value: Any) -> bool:
        step = getattr(self._handle, "step", None)
        if step is None or isinstance(value, bool):
            return bool(value == self._on_page)
        return bool(abs(value - self._on_page) < 0.5 * step)


class HtmlElement:
    """An HTML element that is sent only when its content changes."""

    def __init__(self, handle: Any) -> None:
        self._handle, self._content = handle, ""

    def show(self, content: str) -> None:
        """Set the content."""
        if content != self._content:
            self._content = content
            self._handle.content = content


class Tab:
    """A tab of the panel; it overrides what it needs."""

    def refresh(self) -> None:
        """Show the newest state; called a few times per second."""

    def sample(self, now: float) -> None:
        """Add a point to each of its curves at `now`, steady clock, in [s]."""

    def show_scene(self, robot: RobotDescription) -> None:
        """Show another scene, whose joints, keys and parameters have the same controls."""
