"""A bag as a self-contained web page with a moving picture and a time bar."""

from __future__ import annotations

import secrets
import socket
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from softsim_core.scene import ViewSettings
from softsim_ros.nodes.viewer import MM, AccessRule, GuardedServer, MarkerView, Part, RigidView, SurfaceView
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.errors import BagError
from softsim_ros.recording.surface_frames import SURFACE, MeshFrame, mesh_frames

MOST_FRAMES = 600
"""Largest number of frames; long recordings get fewer per second, so that a page stays below about 20 MB."""

RATE = 20.0
BODY_COLOUR = (0.9, 0.9, 0.9, 1.0)


def html_replay(bag: Bag) -> str:
    """Return the page as HTML.

    The surface (topics mesh/topology and mesh/points) is coloured by von Mises stress; the largest stress of
    the bag has the last colour.

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
        surface.apply_view(ViewSettings(stress=True, stress_top=top or None))
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
