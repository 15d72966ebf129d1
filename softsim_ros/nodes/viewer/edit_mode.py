"""The edit mode of the page: its tab, its drawing, and its state when the page is rebuilt."""

from __future__ import annotations

import html
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import PurePath
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, Box, IndexArray, SoftSimError, Sphere
from softsim_core.scene.editing import Region
from softsim_ros.client import Editing, Outcome
from softsim_ros.messages import Proposal
from softsim_ros.nodes.viewer.edit_session import CLICKS, EditSession, Field, drag_handle
from softsim_ros.nodes.viewer.panel import Control, HtmlElement, Inbox, Tab
from softsim_ros.nodes.viewer.picture import Picture
from softsim_ros.nodes.viewer.surface import MM, Part, Points, box_lines, sphere_lines

SEND_PERIOD_S: Final = 0.2
"""Period in [s] at which the position of a dragged handle is proposed."""

OPACITY: Final = 0.5
COLOURS: Final = {
    "world": (201, 42, 42),
    "free": (230, 119, 0),
    "joint": (174, 62, 201),
    "bodies": (52, 58, 64),
    "collisions": (12, 133, 153),
    "joints": (25, 113, 194),
}
"""Colours of attachments by what moves them; of masses, contact surfaces, chambers and cables."""


class EditStage:
    """Draws the proposal of an EditSession, and handles its clicks and drags.

    `attempt` runs a user's action in its turn and reports the result; `is_behind` returns whether it has to
    wait.
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
        self._dragged = ""
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
        mesh = self._scene.add_mesh_simple(
            f"/edit/bodies/{part.name}",
            own,
            triangles.astype(np.uint32),
            color=part.rgb,
            opacity=OPACITY,
            side="double",
        )

        async def on_click(event: Any) -> None:
            origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)

            def press() -> str | None:
                hit = first_hit(origin, direction, own.astype(float), triangles)
                return (
                    None if hit is None else self._session.press(part.name, hit / MM, own.astype(float) / MM)
                )

            self._inbox.put(lambda: self._attempt(press))

        mesh.on_click(on_click)
        return mesh

    def show(self) -> None:
        """Draw regions, chosen nodes, cables and handles of the session."""
        for handle in self._drawn:
            handle.remove()
        self._drawn, self._lines = [], None
        session = self._session
        proposal = session.proposal
        if not session.is_on or proposal is None or proposal.robot is None:
            self._show_handles({})
            return
        targets = {f"attachments/{each.name}": each.to for each in proposal.robot.scene.attachments}
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
        for number, each in enumerate(proposal.chosen):
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
        robot, proposal = self._session.robot, self._session.proposal
        assert robot is not None
        assert proposal is not None
        for number, joint in enumerate(robot.joints):
            points = proposal.routes.get(joint.name)
            if points is None or not len(points):
                continue
            way = None if joint.actuator is None else joint.actuator.route
            outside = () if way is None or way.pull_point is None else (way.pull_point, *way.guides)
            line = (np.vstack([*outside, points]) * MM).astype(np.float32)
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
        """Move the handles to their places, except one that is being dragged."""
        for name in [name for name in self._handles if name not in places]:
            self._handles.pop(name).remove()
            self._dragged = "" if self._dragged == name else self._dragged
        for name, place in places.items():
            if name not in self._handles:
                self._handles[name] = self._make(name, place * MM)
            if name != self._dragged:
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

        async def on_move(event: Any) -> None:
            place, phase = np.array(event.target.position), event.phase
            self._inbox.put(lambda: self._drag(name, place, phase))

        handle.on_update(on_move)
        return handle

    def _drag(self, name: str, place: Array, phase: str) -> None:
        if name not in self._handles:
            return
        if self._dragged != name:
            self._dragged, self._strokes = name, self._strokes + 1
        region = self._session.regions.get(self._session.part)
        if region is not None and self._lines is not None:
            self._lines.points = lines_of(region, drag_handle(region, name, place / MM))
        ends, now = phase == "end", time.monotonic()
        if ends or (now - self._sent_at >= SEND_PERIOD_S and not self._is_behind()):
            self._sent_at = now
            stroke = f"drag {self._strokes} of {id(self)}"
            self._attempt(lambda: self._session.drag(name, place / MM, stroke))
        if ends:
            self._dragged = ""


def first_hit(origin: Array, direction: Array, points: Array, triangles: IndexArray) -> Array | None:
    """Return where a ray first meets triangles, shape (3,), or None if it misses all of them.

    Args:
        origin: Start of the ray, shape (3,).
        direction: Direction of the ray, shape (3,).
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
    """Return the wire frame of a region in the world with a given shape, in [mm], shape (k, 2, 3)."""
    if isinstance(shape, Sphere):
        lines = sphere_lines(shape.center, shape.radius)
    else:
        lines = box_lines(shape.center, shape.size, shape.rotation_deg)
    return np.asarray(region.in_world(lines) * MM, dtype=np.float32)


def colour_of(part: str, targets: dict[str, str]) -> tuple[int, int, int]:
    """Return the colour of a part; `targets` maps each attachment to what moves it."""
    if part in targets:
        return COLOURS.get(targets[part], COLOURS["joint"])
    return COLOURS[part.partition("/")[0]]


Action = Callable[[], "str | None"]
"""An action of a user; returns a message for the user, or None."""

MOST_WAITING: Final = 50


class EditMode:
    """Session and stage of the edit mode.

    A user may act faster than the simulator answers. Each action therefore waits until the result of the
    previous one has arrived, so that all actions apply, in order, to the scene that the user meant.

    Attributes:
        session: What is edited; it persists when another scene begins.
    """

    def __init__(
        self, server: Any, inbox: Inbox, picture: Picture, editing: Editing, say: Callable[[str], None]
    ) -> None:
        self._server, self._inbox, self._picture = server, inbox, picture
        self._say, self._editing = say, editing
        self.session = EditSession(editing.change)
        self._stage: EditStage | None = None
        self._drawn: object = None
        self._waiting: deque[Action] = deque()

    def build(self) -> None:
        """Rebuild the stage on an empty 3-D scene."""
        self._stage = EditStage(
            self._server.scene, self._inbox, self.session, self.attempt, lambda: self.is_behind
        )
        self._drawn = None
        self.show()

    def turn(self, on: bool) -> None:
        """Show the proposal in place of the running scene, or the running scene."""
        self.session.is_on = on
        if on:
            self.ask("begin")
        self.show()

    def ask(self, name: str) -> None:
        """Call an edit service of the simulator by name; a successful "apply" shows the running scene."""

        def done(end: Outcome) -> None:
            if end.success and name == "apply":
                self.turn(False)

        self.attempt(lambda: self._editing.ask(name, done))

    @property
    def is_behind(self) -> bool:
        """Whether the session's proposal is older than the last request."""
        return self._editing.is_behind or self._editing.proposal is not self.session.proposal

    def attempt(self, action: Action) -> None:
        """Queue a user's action; show the message that it returns or the reason of a refusal."""
        if len(self._waiting) >= MOST_WAITING:
            self._say(f"{MOST_WAITING} actions wait for the simulator's response; wait until it arrives")
        else:
            self._waiting.append(action)
            self._go_on()

    def _go_on(self) -> None:
        """Run waiting actions until one of them has to wait for the simulator's answer."""
        while self._waiting and not self.is_behind:
            try:
                message = self._waiting.popleft()()
            except SoftSimError as error:
                message = str(error)
            if message:
                self._say(message)

    def refresh(self) -> None:
        """Draw a proposal that has arrived since the last call."""
        proposal = self._editing.proposal
        if proposal is not None and proposal is not self.session.proposal:
            self.session.take(proposal)
            self.show()
        elif self._bodies is not self._drawn:
            self.show()
        self._go_on()

    @property
    def _bodies(self) -> object:
        """Bodies to draw at rest; None while the running scene is shown."""
        return self._picture.rest if self.session.is_on and self.session.robot is not None else None

    def show(self) -> None:
        """Draw the proposal instead of the running scene, or the running scene again."""
        assert self._stage is not None  # set by `build`
        bodies, (parts, points) = self._bodies, self._picture.rest
        self._picture.hide_scene(bodies is not None)
        with self._server.atomic():
            if bodies is not self._drawn:
                self._stage.show_bodies(() if bodies is None else parts, points)
                self._drawn = bodies
            self._stage.show()


NOTHING: Final = "(no part)"
MOST_PROBLEMS: Final = 6


class EditTab(Tab):
    """Controls of the edit mode."""

    def __init__(self, gui: Any, inbox: Inbox, mode: EditMode) -> None:
        session = mode.session
        self._gui, self._inbox, self._mode, self._session = gui, inbox, mode, session
        self._status = HtmlElement(gui.add_html(""))
        switch = gui.add_checkbox("Edit", session.is_on, hint="shows the scene at rest, as it is proposed")
        self._switch = inbox.on_change(switch, self._turn)
        for row in (("Undo", "Redo", "Discard"), ("Apply", "Save", "Copy")):
            actions = {name: partial(mode.ask, name.lower()) for name in row}
            inbox.on_press(gui.add_button_group("", row), actions)
        clicks = gui.add_dropdown("A click on a body does", CLICKS, initial_value=session.click)
        self._clicks = inbox.on_change(
            clicks, lambda click: mode.attempt(partial(session.choose_click, click))
        )
        self._folder = gui.add_folder("Part")
        self._content: list[Any] = []
        self._fields: list[tuple[Field, Any]] = []
        self._shown: object = None
        self._part: Control | None = None
        self.refresh()

    def refresh(self) -> None:
        """Show the newest proposal."""
        session, proposal = self._session, self._session.proposal
        self._switch.show(session.is_on)
        self._clicks.show(session.click)
        self._status.show(status(proposal) if session.is_on else "")
        fields = session.fields() if session.is_on else []
        labels = [field.label for field in fields]
        shown = (session.is_on, session.parts, session.part, session.point, session.point_names, labels)
        if shown != self._shown:
            self._shown = shown
            self._build(fields)
        pairs = zip(fields, self._fields, strict=True)
        self._fields = [(field, _follow(before, field, box)) for field, (before, box) in pairs]

    def _build(self, fields: list[Field]) -> None:
        """Rebuild the controls of the chosen part."""
        for handle in self._content:
            handle.remove()
        self._content, self._fields = [], []
        session, gui = self._session, self._gui
        if not session.is_on:
            return
        with self._folder:
            parts = (NOTHING, *session.parts)
            part = gui.add_dropdown("Chosen part", parts, initial_value=session.part or NOTHING)
            self._inbox.on_change(
                part, lambda name: self._choose(session.choose, "" if name == NOTHING else name)
            )
            self._content.append(part)
            if len(session.route):
                names = session.point_names
                at = gui.add_dropdown(
                    "Point of the cable", names, initial_value=names[session.point + session.first]
                )
                self._inbox.on_change(at, partial(self._choose, session.choose_point))
                self._content.append(at)
            for field in fields:
                handle = gui.add_text(field.label, field.text)
                self._fields.append((field, handle))
                self._content.append(handle)
            if self._fields:
                self._add_button("Set values", self._write)
            if (session.part and not session.part.startswith("bodies/")) or "#" in session.part:
                self._add_button("Remove part", session.remove)
            if len(session.route):
                self._add_button("Remove point", session.remove_point)
            if session.is_free:
                self._add_button("Make it the effector", session.make_effector)

    def _add_button(self, name: str, action: Callable[[], None]) -> None:
        button = self._gui.add_button(name)
        self._inbox.on_click(button, lambda: self._mode.attempt(action))
        self._content.append(button)

    # --- actions of the user --------------------------------------------------------------------------

    def _turn(self, on: bool) -> None:
        self._mode.turn(on)
        self.refresh()

    def _write(self) -> None:
        self._session.write([(field, box.value) for field, box in self._fields if box.value != field.text])

    def _choose(self, choose: Callable[[str], None], name: str) -> None:
        def choose_and_show() -> None:
            choose(name)
            self._mode.show()
            self.refresh()

        self._mode.attempt(choose_and_show)


def _follow(before: Field, field: Field, box: Any) -> Any:
    """Return the text box of a field, updated to its newest text unless the user has changed it."""
    if box.value == before.text != field.text:
        box.value = field.text
    return box


def status(proposal: Proposal | None) -> str:
    """Return the state of a proposal as HTML."""
    if proposal is None:
        return "waiting for the simulator ..."
    if proposal.robot is None:
        return html.escape(proposal.message)
    saved = "not saved" if proposal.is_changed else "saved"
    applied = "runs" if proposal.is_applied else "not applied"
    file, name = html.escape(proposal.file), html.escape(PurePath(proposal.file).name)
    lines = [
        f"<b title='{file}'>{name}</b>: {saved}, {applied}",
        f"{proposal.undoable} to undo, {proposal.redoable} to redo",
    ]
    if proposal.unsaved:
        lines.append(html.escape(proposal.unsaved))
    lines += [
        f"<span style='color:#c92a2a'>{html.escape(each)}</span>"
        for each in proposal.problems[:MOST_PROBLEMS]
    ]
    return '<div style="font-size:0.85em;padding:0 0.7em">' + "<br>".join(lines) + "</div>"
