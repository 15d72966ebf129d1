"""The picture of a proposed scene: bodies at rest, regions, the nodes they choose, cables, handles."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array, IndexArray
from softsim_core.editing.regions import Region
from softsim_core.values import Box, Sphere
from softsim_ros.viewer.edit_session import EditSession, dragged
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.shapes import box_lines, sphere_lines
from softsim_ros.viewer.surface import MM, Part

Points = NDArray[np.float32]

SEND_PERIOD_S: Final = 0.2
"""While a handle is dragged its place is proposed this often, in [s]."""

OPACITY: Final = 0.5
COLOURS: Final = {
    "world": (201, 42, 42),
    "free": (230, 119, 0),
    "joint": (174, 62, 201),
    "bodies": (52, 58, 64),
    "collisions": (12, 133, 153),
    "joints": (25, 113, 194),
}
"""Of attachments by what moves them; of masses, contact surfaces, chambers and cables."""


class EditStage:
    """Draws what an EditSession edits, and takes clicks and drags for it.

    Args:
        scene: viser's scene.
        inbox: Where the mouse's events go.
        session: What is edited.
        attempt: Carries out an action of a person in its turn and says what came of it.
        is_behind: Whether such an action has to wait.
    """

    def __init__(
        self,
        scene: Any,
        inbox: Inbox,
        session: EditSession,
        attempt: Callable[[Callable[[], str | None]], None],
        is_behind: Callable[[], bool],
    ) -> None:
        self._scene, self._inbox, self._session = scene, inbox, session
        self._attempt, self._is_behind = attempt, is_behind
        self._bodies: list[Any] = []
        self._drawn: list[Any] = []
        self._handles: dict[str, Any] = {}
        self._held = ""
        self._strokes = 0
        self._sent_at = -np.inf
        self._lines: Any = None
        self._size = 100.0

    def show_bodies(self, parts: Sequence[Part], points: Points) -> None:
        """Draw bodies at rest, or none; `points` in [mm], shape (p, 3)."""
        for handle in self._bodies:
            handle.remove()
        if parts:
            self._size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self._bodies = [self._body(part, points) for part in parts]

    def _body(self, part: Part, points: Points) -> Any:
        own, triangles = points[slice(*part.points)], part.triangles - part.points[0]
        *rgb, _ = part.colour
        mesh = self._scene.add_mesh_simple(
            f"/edit/bodies/{part.name}",
            own,
            triangles.astype(np.uint32),
            color=tuple(round(255 * channel) for channel in rgb),
            opacity=OPACITY,
            side="double",
        )

        async def clicked(event: Any) -> None:
            origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)

            def press() -> str | None:
                hit = first_hit(origin, direction, own.astype(float), triangles)
                return (
                    None if hit is None else self._session.press(part.name, hit / MM, own.astype(float) / MM)
                )

            self._inbox.put(lambda: self._attempt(press))

        mesh.on_click(clicked)
        return mesh

    def show(self) -> None:
        """Draw regions, chosen nodes, cables and handles as the session has them."""
        for handle in self._drawn:
            handle.remove()
        self._drawn, self._lines = [], None
        session = self._session
        told = session.told
        if not session.is_on or told is None or told.robot is None:
            self._show_handles({})
            return
        targets = {f"attachments/{each.name}": each.to for each in told.robot.scene.attachments}
        for number, region in enumerate(session.regions.values()):
            chosen = region.part == session.part
            lines = self._scene.add_line_segments(
                f"/edit/regions/{number}",
                lines_of(region, region.shape),
                colour_of(region.part, targets),
                thickness=(0.008 if chosen else 0.003) * self._size,
            )
            self._lines = lines if chosen else self._lines
            self._drawn.append(lines)
        for number, each in enumerate(told.chosen):
            if len(each.points):
                self._drawn.append(
                    self._scene.add_point_cloud(
                        f"/edit/chosen/{number}",
                        (each.points * MM).astype(np.float32),
                        colour_of(each.part, targets),
                        point_size=self._size * (0.015 if each.part == session.part else 0.009),
                        point_shape="circle",
                        precision="float32",
                    )
                )
        self._show_cables()
        self._show_handles(session.handles())

    def _show_cables(self) -> None:
        robot, told = self._session.robot, self._session.told
        assert robot is not None
        assert told is not None
        for number, joint in enumerate(robot.joints):
            points = told.routes.get(joint.name)
            if points is None or not len(points):
                continue
            pull = getattr(joint.actuator, "pull_point", None)
            line = (np.vstack([points] if pull is None else [[pull], points]) * MM).astype(np.float32)
            name, colour = f"/edit/cables/{number}", COLOURS["joints"]
            if len(line) > 1:
                pairs = np.stack([line[:-1], line[1:]], axis=1)
                self._drawn.append(
                    self._scene.add_line_segments(f"{name}/line", pairs, colour, thickness=0.006 * self._size)
                )
            self._drawn.append(
                self._scene.add_point_cloud(
                    f"{name}/points",
                    line,
                    colour,
                    point_size=0.018 * self._size,
                    point_shape="circle",
                    precision="float32",
                )
            )

    # --- handles --------------------------------------------------------------------------------------

    def _show_handles(self, places: dict[str, Array]) -> None:
        """Place the handles; one that is in the hand stays there."""
        for name in [name for name in self._handles if name not in places]:
            self._handles.pop(name).remove()
            self._held = "" if self._held == name else self._held
        for name, place in places.items():
            if name not in self._handles:
                self._handles[name] = self._make(name, place * MM)
            if name != self._held:
                self._handles[name].position = place * MM

    def _make(self, name: str, position: Array) -> Any:
        handle = self._scene.add_transform_controls(
            f"/edit/{name}",
            scale=self._size * (0.11 if name == "size" else 0.18),
            disable_rotations=True,
            disable_sliders=True,
            depth_test=False,
            position=position,
        )

        async def moved(event: Any) -> None:
            place, phase = np.array(event.target.position), event.phase
            self._inbox.put(lambda: self._drag(name, place, phase))

        handle.on_update(moved)
        return handle

    def _drag(self, name: str, place: Array, phase: str) -> None:
        if name not in self._handles:
            return
        if self._held != name:
            self._held, self._strokes = name, self._strokes + 1
        region = self._session.regions.get(self._session.part)
        if region is not None and self._lines is not None:
            self._lines.points = lines_of(region, dragged(region, name, place / MM))
        ends, now = phase == "end", time.monotonic()
        if ends or (now - self._sent_at >= SEND_PERIOD_S and not self._is_behind()):
            self._sent_at = now
            stroke = f"drag {self._strokes} of {id(self)}"
            self._attempt(lambda: self._session.drag(name, place / MM, stroke))
        if ends:
            self._held = ""


def first_hit(origin: Array, direction: Array, points: Array, triangles: IndexArray) -> Array | None:
    """Where a ray first meets triangles, shape (3,); None: nowhere.

    Args:
        origin: Where the ray begins, shape (3,).
        direction: Where it goes, shape (3,).
        points: Vertices, shape (p, 3).
        triangles: Their indices, shape (k, 3).

    Source: Möller, Trumbore 1997, Fast, minimum storage ray/triangle intersection.
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    ab, ac, oa = b - a, c - a, origin - a
    p = np.cross(direction, ac)
    volume = np.einsum("ki,ki->k", ab, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ki,ki->k", oa, p) / volume
        q = np.cross(oa, ab)
        v = q @ direction / volume
        t = np.einsum("ki,ki->k", ac, q) / volume
        hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & np.isfinite(t)
    return origin + t[hit].min() * direction if hit.any() else None


def lines_of(region: Region, shape: Box | Sphere) -> Points:
    """The wire frame of a region in the world with a shape, in [mm], shape (k, 2, 3)."""
    if isinstance(shape, Sphere):
        lines = sphere_lines(shape.center, shape.radius)
    else:
        lines = box_lines(shape.center, shape.size, shape.rotation_deg)
    return np.asarray(region.in_world(lines) * MM, dtype=np.float32)


def colour_of(part: str, targets: dict[str, str]) -> tuple[int, int, int]:
    """Colour of a part; `targets` tells what moves each attachment."""
    if part in targets:
        return COLOURS.get(targets[part], COLOURS["joint"])
    return COLOURS[part.partition("/")[0]]
