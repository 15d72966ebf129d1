"""A self-contained web page about a recording: its content, charts, and the moving picture."""

from __future__ import annotations

import base64
import importlib.util
from datetime import datetime
from html import escape

from softsim_core import RobotDescription
from softsim_core.base import SoftSimError, install_command
from softsim_core.scene import SceneCatalog
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.curves import charts, draw
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.tables import diagnostic_row

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }}
h1 {{ margin-bottom: 0 }}
h2 {{ margin: 2rem 0 0.3rem; font-size: 1.15rem }}
p {{ margin: 0.2rem 0; color: #555 }}
table {{ border-collapse: collapse; font-size: 0.9rem }}
td, th {{ text-align: left; padding: 0.15rem 1.2rem 0.15rem 0 }}
img {{ width: 100%; max-width: 56rem }}
iframe {{ width: 100%; height: 34rem; border: 1px solid #ddd }}
</style>
<h1>{title}</h1>
{body}
</html>
"""


def report(bag: Bag) -> str:
    """Return the page as HTML.

    Raises:
        BagError: the bag has no messages.
    """
    if not bag.topics:
        raise BagError(bag.path, "holds no messages")
    parts = [_summary(bag), "<h2>Replay</h2>", _replay(bag)]
    for chart in charts(bag, _scene(bag)):
        parts.append(f"<h2>{escape(chart.title)}</h2>")
        if chart.caption:
            parts.append(f"<p>{escape(chart.caption)}</p>")
        if chart.curves:
            data = base64.b64encode(draw(chart, bag.duration_s).encode()).decode()
            parts.append(f'<img alt="{escape(chart.title)}" src="data:image/svg+xml;base64,{data}">')
    parts += ["<h2>Warnings and errors</h2>", _troubles(bag), "<h2>Topics</h2>", _topics(bag)]
    return PAGE.format(title=escape(f"{bag.robot}: {bag.path.resolve().name}"), body="\n".join(parts))


def _summary(bag: Bag) -> str:
    begin = datetime.fromtimestamp(1e-9 * bag.begin_ns).astimezone()
    total = sum(bag.counts.values())
    return (
        f"<p>Recorded {begin:%Y-%m-%d %H:%M:%S %Z} in {escape(bag.namespace)}: {bag.duration_s:.1f} s, "
        f"{total} messages on {len(bag.topics)} topics.</p>"
    )


def _scene(bag: Bag) -> RobotDescription | None:
    try:
        return SceneCatalog().load(bag.robot)  # only known names, since a bag may name anything
    except SoftSimError:
        return None


def _replay(bag: Bag) -> str:
    if importlib.util.find_spec("viser") is None:
        return f"<p>Left out: it needs viser ({install_command('viewer')}).</p>"
    from softsim_ros.recording.replay_page import html_replay

    try:
        page = html_replay(bag)
    except BagError as error:
        return f"<p>Left out: {escape(error.reason)}.</p>"
    return f'<iframe title="replay" srcdoc="{escape(page)}"></iframe>'


def _topics(bag: Bag) -> str:
    rows = [
        f"<tr><td>{escape(topic)}<td>{escape(kind)}<td>{bag.counts[topic]}"
        f"<td>{bag.counts[topic] / max(bag.duration_s, 1e-3):.1f}"
        for topic, kind in sorted(bag.topics.items())
    ]
    return f"<table><tr><th>topic<th>type<th>messages<th>a second{''.join(rows)}</table>"


def _troubles(bag: Bag) -> str:
    """Return every message of /diagnostics that was not OK, once, with the time of its first occurrence."""
    if not bag.counts.get("/diagnostics"):
        return "<p>Not in this recording: /diagnostics.</p>"
    first: dict[tuple[str, int, str], float] = {}
    for stamp, message in bag.messages("/diagnostics"):
        for status in message.status:
            row = diagnostic_row(status)
            if row["level"]:
                key = (status.name, row["level"], status.message)
                first.setdefault(key, 1e-9 * (stamp - bag.begin_ns))
    if not first:
        return "<p>None.</p>"
    levels = {1: "warning", 2: "error", 3: "stale"}
    rows = [
        f"<tr><td>{time_s:.1f} s<td>{escape(name)}<td>{levels.get(level, level)}<td>{escape(text)}"
        for (name, level, text), time_s in first.items()
    ]
    return f"<table>{''.join(rows)}</table>"
