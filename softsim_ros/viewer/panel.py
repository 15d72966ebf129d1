"""Controls of the page whose events are served in the node's own thread."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from typing import Any


class Inbox:
    """What browsers did, in order, handed over from viser's thread to the node's.

    Plain callbacks run in a pool of viser's, out of order; `async` ones run in order in its own thread, where
    nothing may wait. So every callback here only puts an action into the queue.
    """

    def __init__(self) -> None:
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

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

    def on_change(self, control: Any, action: Callable[[Any], None]) -> None:
        """Run an action with the new value whenever a person (not this program) changes a control."""

        async def changed(event: Any) -> None:
            if event.client_id is not None:
                value = event.target.value
                self.put(lambda: action(value))

        control.on_update(changed)

    def on_key(self, command: Any, action: Callable[[], None]) -> None:
        """Run an action whenever the key of a command is pressed."""

        async def pressed(_: Any) -> None:
            self.put(action)

        command.on_trigger(pressed)


class Shown:
    """A piece of HTML that is sent only when it changes."""

    def __init__(self, handle: Any) -> None:
        self._handle, self._content = handle, ""

    def show(self, content: str) -> None:
        """Show this content."""
        if content != self._content:
            self._content = content
            self._handle.content = content
