"""The teleop's loop: keys, callbacks and display, in turn, in one thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final, Protocol

from softsim_node.ending import ending
from softsim_ros.keys.names import KeyPress
from softsim_ros.teleop.decoder import KeyDecoder
from softsim_ros.teleop.display import View, frame, render
from softsim_ros.teleop.terminal import RawTerminal

KEY_WAIT_S: Final = 0.04
"""Longest wait for a key in [s]; callbacks are served at least this often."""

DRAW_INTERVAL_S: Final = 0.1


class DrivenByKeys(Protocol):
    """What the loop asks of a node; a Teleop is one."""

    @property
    def context(self) -> Any:
        """The node's rclpy context."""
        ...

    @property
    def quit_requested(self) -> bool:
        """Whether a key has asked to end."""
        ...

    def handle_key(self, key: KeyPress, now: float) -> None:
        """Act on a key, `now` in [s]."""
        ...

    def view(self, now: float) -> View:
        """What the terminal shows."""
        ...


def run_teleop(node: DrivenByKeys, terminal: RawTerminal, serve_callbacks: Callable[[], None]) -> None:
    """Drive the robot from a terminal until a key quits, the process shall end or the terminal is gone.

    Args:
        node: The teleop; may share its process with other nodes that spin in threads of their own.
        terminal: Entered already.
        serve_callbacks: Runs the node's callbacks that are ready, without waiting, such as
            `lambda: ready_callbacks(executor)`.
    """
    try:
        _run(node, terminal, serve_callbacks)
    except Exception:
        if node.context.ok():
            raise
        # the context was shut down in the middle of a call: an ordinary end


def _run(node: DrivenByKeys, terminal: RawTerminal, serve_callbacks: Callable[[], None]) -> None:
    decoder = KeyDecoder()
    shown: tuple[list[str], tuple[int, int]] | None = None
    next_draw = time.monotonic()
    while node.context.ok() and not (node.quit_requested or ending.asked):
        data = terminal.read() if terminal.wait(KEY_WAIT_S) else b""
        if data is None:
            return
        serve_callbacks()  # before the keys: a step starts from the newest measured position
        now = time.monotonic()
        for key in decoder.flush(now) + decoder.feed(data, now):
            node.handle_key(key, now)
            if node.quit_requested:
                return
        if now >= next_draw:
            size = terminal.size
            content = (render(node.view(now), *size), size)
            if terminal.take_redraw() or content != shown:
                terminal.write(frame(content[0], size[1]))
                shown = content
            next_draw = now + DRAW_INTERVAL_S
