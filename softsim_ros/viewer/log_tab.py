"""The tab Log: what nodes and the scene's own code say, newest first."""

from __future__ import annotations

import html
import time
from collections.abc import Iterable
from typing import Any, Final

from softsim_ros.client.log import LogLine, RobotLog
from softsim_ros.viewer.panel import Shown
from softsim_ros.viewer.readings import AMBER, RED, box
from softsim_ros.viewer.spoken import Spoken

INFO, WARNING, ERROR = 20, 30, 40
REFRESH_S: Final = 0.5
SHOWN: Final = 60
"""Lines on the page."""


class LogTab:
    """Lines of the log.

    Args:
        gui: viser's controls, inside the tab.
        log: What the robot's nodes say.
        spoken: What the page says itself.
    """

    def __init__(self, gui: Any, log: RobotLog, spoken: Spoken) -> None:
        self._log, self._spoken = log, spoken
        self._lines = Shown(gui.add_html(""))
        self._said = ""
        self._shown, self._due = -1, 0.0

    def refresh(self) -> None:
        """Show the newest lines; the page's own sentences are among them."""
        log, sentence = self._log, self._spoken.sentence
        if sentence and sentence != self._said:
            log.add(LogLine(time.time(), INFO, "page", sentence))
        self._said = sentence
        now = time.monotonic()
        if log.count != self._shown and now >= self._due:
            self._shown, self._due = log.count, now + REFRESH_S
            self._lines.show(log_table(list(log.lines)[-SHOWN:]))


def log_table(lines: Iterable[LogLine]) -> str:
    """Lines as HTML, newest first: time of day, who, what; warnings and errors coloured."""
    rows = "".join(_row(line) for line in reversed(list(lines)))
    return box(f'<div style="overflow-wrap:anywhere">{rows or "nothing was said yet"}</div>')


def _row(line: LogLine) -> str:
    clock = time.strftime("%H:%M:%S", time.localtime(line.time_s))
    colour = RED if line.level >= ERROR else AMBER if line.level >= WARNING else "inherit"
    return (
        f'<div style="color:{colour}"><span style="opacity:0.6">{clock}</span> '
        f"<b>{html.escape(line.source)}</b> {html.escape(line.text)}</div>"
    )
