"""A self-contained web page about a recording: its content, charts, and the moving picture."""

from __future__ import annotations

import base64
import importlib.util
from datetime import datetime

from softsim_core import RobotDescription
from softsim_core.base import SoftSimError, install_command
from softsim_core.scene import SceneCatalog
from softsim_ros import render_page
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.curves import charts, draw
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.tables import diagnostic_row


def report(bag: Bag) -> str:
    """Return the page as HTML.

    Raises:
        BagError: the bag has no messages.
    """
    if not bag.topics:
        raise BagError(bag.path, "holds no messages")
    pictures = (
        (chart, base64.b64encode(draw(chart, bag.duration_s).encode()).decode() if chart.curves else "")
        for chart in charts(bag, _scene(bag))
    )
    replay, left_out = _replay(bag)
    return render_page(
        "recording.html",
        title=f"{bag.robot}: {bag.path.resolve().name}",
        begin=datetime.fromtimestamp(1e-9 * bag.begin_ns).astimezone(),
        bag=bag,
        replay=replay,
        left_out=left_out,
        charts=pictures,
        troubles=_troubles(bag),
        topics=[
            (topic, kind, bag.counts[topic], f"{bag.counts[topic] / max(bag.duration_s, 1e-3):.1f}")
            for topic, kind in sorted(bag.topics.items())
        ],
    )


def _scene(bag: Bag) -> RobotDescription | None:
    try:
        return SceneCatalog().load(bag.robot)  # only known names, since a bag may name anything
    except SoftSimError:
        return None


def _replay(bag: Bag) -> tuple[str, str]:
    """Return the moving picture as HTML, or why it is left out."""
    if importlib.util.find_spec("viser") is None:
        return "", f"it needs viser ({install_command('viewer')})"
    from softsim_ros.recording.replay_page import html_replay

    try:
        return html_replay(bag), ""
    except BagError as error:
        return "", error.reason


def _troubles(bag: Bag) -> list[tuple[str, ...]]:
    """Return every message of /diagnostics that was not OK, once, with the time of its first occurrence."""
    first: dict[tuple[str, int, str], float] = {}
    for stamp, message in bag.messages("/diagnostics"):
        for status in message.status:
            row = diagnostic_row(status)
            if row["level"]:
                key = (status.name, row["level"], status.message)
                first.setdefault(key, 1e-9 * (stamp - bag.begin_ns))
    levels = {1: "warning", 2: "error", 3: "stale"}
    return [
        (f"{time_s:.1f} s", name, levels.get(level, str(level)), text)
        for (name, level, text), time_s in first.items()
    ]
