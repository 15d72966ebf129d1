"""A self-contained web page about a recording: its content, charts, and the moving picture."""

from __future__ import annotations

import base64
import importlib.util
import secrets
import socket
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from html import escape
from typing import Any

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base import SoftSimError, install_command
from softsim_core.scene import SceneCatalog, ViewSettings
from softsim_ros.nodes.viewer import MM, AccessRule, GuardedServer, MarkerView, Part, RigidView, SurfaceView
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.curves import charts
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.surface_frames import SURFACE, MeshFrame, mesh_frames
from softsim_ros.recording.tables import diagnostic_row

MOST_FRAMES = 600
"""Largest number of frames; long recordings get fewer per second, so that a page stays below about 20 MB."""

RATE = 20.0
BODY_COLOUR = (0.9, 0.9, 0.9, 1.0)


def html_replay(bag: Bag, *, stress: bool = True) -> str:
    """Return the page as HTML.

    Args:
        bag: Open bag with the surface (topics mesh/topology and mesh/points).
        stress: Colour by von Mises stress; the largest stress of the bag has the last colour.

    Raises:
        BagError: the bag contains no surface.
        ViewerError: the installed viser is not the expected one.
    """
    rate = min(RATE, MOST_FRAMES / max(bag.duration_s, 1e-3))
    frames = list(mesh_frames(bag, SURFACE, rate))
    if not frames:
        raise BagError(bag.path, f"holds no surface ({', '.join(map(bag.topic, SURFACE[:2]))})")
    with _unreachable_server() as server:
        scene = server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        _look_at(server, frames[0])
        layers = _layers(bag, scene)
        surface = SurfaceView(scene, lambda mesh: None)
        top = max(float(frame.von_mises.max(initial=0.0)) for frame in frames)
        surface.apply_view(ViewSettings(stress=stress, stress_top=top or None))
        recording = server.get_scene_serializer()
        shown: MeshFrame | None = None
        for frame in frames:
            if shown is not None:
                recording.insert_sleep(frame.time_s - shown.time_s)
            with server.atomic():
                if shown is None or frame.cells is not shown.cells:
                    whole = (0, len(frame.points))
                    surface.show([Part("body", whole, frame.cells, BODY_COLOUR)], MM * frame.points)
                surface.update(MM * frame.points, frame.von_mises, frame.time_s)
                for layer in layers:
                    layer.show(frame.time_s)
            shown = frame
        page: str = recording.as_html()
    return page


class _Layer:
    """A topic that is drawn beside the surface: at each time its newest message, if that is a new one."""

    def __init__(self, bag: Bag, topic: str, draw: Callable[[Any], None]) -> None:
        messages = [(1e-9 * (stamp - bag.begin_ns), each) for stamp, each in bag.messages(bag.topic(topic))]
        self._times, self._messages = [time for time, _ in messages], [each for _, each in messages]
        self._draw, self._shown = draw, -1

    def show(self, time_s: float) -> None:
        newest = bisect_right(self._times, time_s) - 1
        if newest > self._shown:
            self._shown = newest
            self._draw(self._messages[newest])


def _arrow(scene: Any, name: str) -> Callable[[Any], None]:
    """Return a function that draws a pose as three arrows."""
    handles: list[Any] = []

    def place(message: Any) -> None:
        if not handles:
            handles.append(scene.add_frame(f"/{name}", axes_length=12.0, axes_radius=0.6))
        at, turn = message.pose.position, message.pose.orientation
        handles[0].position = (MM * at.x, MM * at.y, MM * at.z)
        handles[0].wxyz = (turn.w, turn.x, turn.y, turn.z)

    return place


def _layers(bag: Bag, scene: Any) -> list[_Layer]:
    """Return layers for effector and goal (arrows), cables, contacts and rigid bodies, if recorded."""
    rigid = RigidView(scene)
    drawn = {
        "effector_pose": _arrow(scene, "effector"),
        "effector_goal": _arrow(scene, "goal"),
        "cables": MarkerView(scene, "cables").update,
        "contacts": MarkerView(scene, "contacts").update,
        "bodies/topology": rigid.show,
        "bodies/poses": rigid.move,
    }
    return [_Layer(bag, topic, draw) for topic, draw in drawn.items() if bag.counts.get(bag.topic(topic))]


def _look_at(server: Any, frame: MeshFrame) -> None:
    lower, upper = MM * frame.points.min(axis=0), MM * frame.points.max(axis=0)
    centre, size = 0.5 * (lower + upper), float(np.linalg.norm(upper - lower))
    server.initial_camera.position = centre + size * np.array([0.6, -0.6, 0.45])
    server.initial_camera.look_at = centre
    server.scene.add_grid(
        "/grid", width=3 * size, height=3 * size, cell_size=10.0, position=(*centre[:2], lower[2])
    )


@contextmanager
def _unreachable_server() -> Iterator[GuardedServer]:
    """Start a viser server to use its scene only; nobody knows the token of its page."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = GuardedServer(AccessRule("127.0.0.1", port, secrets.token_urlsafe()), "export")
    try:
        yield server
    finally:
        server.stop()


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
    from softsim_ros.recording.curves import draw

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
    from softsim_ros.recording.report_page import html_replay

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
