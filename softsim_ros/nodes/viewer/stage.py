"""The 3-D side of the page: bodies, markers, goal and base handles, pull; positions in mm."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from visualization_msgs.msg import MarkerArray

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.scene import RobotDescription, ViewSettings
from softsim_ros.client import EffectorPose, Simulator
from softsim_ros.nodes.viewer.inner_view import CollisionView, InnerView, NormalsView
from softsim_ros.nodes.viewer.marker_view import MarkerView, RigidView, TensionColours
from softsim_ros.nodes.viewer.panel import HOLD_S, Inbox
from softsim_ros.nodes.viewer.surface import MM, Lines, Part, Points, SurfaceView

MOST_POINTS: Final = 600
LEAST_STEP_MM: Final = 0.2
"""A position nearer than this to the last one is not added."""
COLOUR: Final = (240, 140, 0)


class Trail:
    """Path of the effector, drawn as a line."""

    def __init__(self, scene: Any) -> None:
        self._points: deque[tuple[float, ...]] = deque(maxlen=MOST_POINTS)
        self._line = Lines(scene, "/trail", COLOUR, 0.6)
        self._shown = False

    def switch(self, shown: bool) -> None:
        """Show or hide the line; positions are recorded while it is hidden, too."""
        self._shown = shown
        self._draw()

    def add(self, position: Sequence[float]) -> None:
        """Add a position of the effector in [m]."""
        point = tuple(MM * each for each in position)
        if self._points and np.linalg.norm(np.subtract(point, self._points[-1])) < LEAST_STEP_MM:
            return
        self._points.append(point)
        self._draw()

    def _draw(self) -> None:
        points = np.array(self._points if self._shown else (), np.float32).reshape(-1, 3)
        self._line.show(np.stack([points[:-1], points[1:]], axis=1))


CELLS: Final = 80
"""Pixels of the shadow image along each side."""
MARGIN: Final = 0.6
"""Margin of the image on each side, as a fraction of the bodies' extent at rest.

If their height is larger than that, the margin is their height.
"""
BLUR: Final = 2.2
"""Standard deviation of the blur in pixels."""
MOST_PARTS: Final = 6
"""Largest number of parts into which a triangle's edge is divided to find the pixels below it."""
PERIOD_S: Final = 0.2
DEPTH_MM: Final = 0.3
"""Distance of the shadow below the floor, so that the grid is visible on it."""


def find_covered_pixels(points: Points, middle: NDArray[np.float64], width: float) -> BoolArray:
    """Return which pixels lie below points, shape (CELLS, CELLS): rows along y, columns along x.

    Args:
        points: Points that cast the shadow in [mm], shape (p, 3).
        middle: Centre of the image, x and y in [mm], shape (2,).
        width: Width of the image in [mm].
    """
    cells = np.floor(((points[:, :2] - middle) / width + 0.5) * CELLS).astype(np.int64)
    inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
    pixels = np.zeros((CELLS, CELLS), bool)
    pixels[cells[inside, 1], cells[inside, 0]] = True
    return pixels


def shade(pixels: BoolArray) -> NDArray[np.float64]:
    """Return how dark each pixel is in 0..1 from a mask of the covered ones; both of shape (CELLS, CELLS)."""
    return np.asarray(np.clip(1.6 * gaussian_filter(pixels.astype(float), BLUR), 0.0, 1.0))


def spread_over(points: Points, triangles: IndexArray, pixel: float) -> Points:
    """Return barycentric weights of points spread over each triangle, shape (s, 3).

    The points are about a `pixel` in [mm] apart and include the centre. A mesh of many triangles has small
    ones, so it gets few points.
    """
    corners = points[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)
    parts = int(np.clip(np.ceil(longest / pixel), 1, MOST_PARTS))
    first, second = np.divmod(np.arange((parts + 1) ** 2), parts + 1)
    inside = first + second <= parts
    weights = np.stack([first, second, parts - first - second], axis=1)[inside] / parts
    return np.concatenate([weights, np.full((1, 3), 1.0 / 3.0)]).astype(np.float32)


class GroundShadow:
    """A soft shadow of the bodies: a small image on the floor.

    The lights of viser cast no shadow here: shadows reach 20 units only, and the page's units are
    millimetres.

    Attributes:
        opacity: Opacity of the darkest place, 0..1.
    """

    opacity = 0.5

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._middle, self._width = np.zeros(2), 1.0
        self._drawn_at = -np.inf
        self._drawn: tuple[bytes, float] | None = None
        self._spread: Points | None = None
        self._picture: Any = None
        self._visible = True

    def begin(self, points: Points, height: float) -> None:
        """Restart with other bodies, by their points at rest (p, 3) in [mm].

        The floor is at `height` in [mm].
        """
        if self._picture is not None:
            self._picture.remove()
            self._picture = None
        if not len(points):
            return
        lower, upper = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
        self._middle = 0.5 * (lower + upper)[:2]
        across, along = float((upper - lower)[:2].max()), float((upper - lower)[2])
        self._width = max(across + 2.0 * max(MARGIN * across, along), 1.0)  # an upright body may bend over
        self._picture = self._scene.add_image(
            "/floor_shadow",
            np.zeros((CELLS, CELLS, 4), np.uint8),
            self._width,
            self._width,
            format="png",
            position=(*self._middle.tolist(), height - DEPTH_MM),
            cast_shadow=False,
            receive_shadow=False,
            visible=self._visible,
        )
        self._drawn_at, self._drawn, self._spread = -np.inf, None, None

    def switch(self, shown: bool) -> None:
        """Show or hide the shadow."""
        self._visible = shown
        if self._picture is not None:
            self._picture.visible = shown

    def follow(self, points: Points, triangles: IndexArray, now: float) -> None:
        """Draw the shadow of a surface at its current position, a few times per second.

        Args:
            points: Vertices in [mm], shape (p, 3).
            triangles: Their indices, shape (k, 3).
            now: Steady clock in [s].
        """
        if self._picture is None or not self._visible or now - self._drawn_at < PERIOD_S:
            return
        self._drawn_at = now
        if self._spread is None:
            self._spread = spread_over(points, triangles, self._width / CELLS)
        pixels = find_covered_pixels(
            (self._spread @ points[triangles]).reshape(-1, 3), self._middle, self._width
        )
        if self._drawn != (drawn := (pixels.tobytes(), self.opacity)):  # a scene at rest sends no image
            self._drawn = drawn
            picture = np.zeros((CELLS, CELLS, 4), np.uint8)
            picture[..., 3] = np.rint(255.0 * self.opacity * shade(pixels))
            self._picture.image = picture


class BaseHandle:
    """Three arrows at the base of the chosen joint.

    `on_move` is called with the joint and the position (3,) in [mm] to which its base is dragged.
    """

    def __init__(self, scene: Any, inbox: Inbox, on_move: Callable[[str, Array], None]) -> None:
        self._scene, self._inbox, self._on_move = scene, inbox, on_move
        self._arrows: Any = None
        self._dragged, self._moved_at = False, -np.inf
        self._shown: Array = np.zeros(3)
        self.joint: str | None = None

    def choose(self, joint: str | None) -> None:
        """Choose another joint, or none; its handle appears with the joint's next position."""
        self.joint, self._dragged, self._moved_at = joint, False, -np.inf
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None

    def follow(self, position: Array) -> None:
        """Move the handle to the base's position (3,) in [mm], unless it is being dragged."""
        if self._arrows is None:
            self._arrows = self._make(position)
        if not self._dragged and time.monotonic() - self._moved_at > HOLD_S:
            self._arrows.position = self._shown = position

    def _make(self, position: Array) -> Any:
        arrows = self._scene.add_transform_controls(
            "/base_handle", scale=30.0, disable_rotations=True, depth_test=False, position=position
        )

        async def on_move(event: Any) -> None:
            position, ends = np.array(event.target.position), event.phase == "end"
            self._inbox.put(lambda: self._drag(position, ends))

        arrows.on_update(on_move)
        return arrows

    def _drag(self, position: Array, ends: bool) -> None:
        self._dragged, self._moved_at = not ends, time.monotonic()
        moved, self._shown = not np.allclose(position, self._shown, atol=1e-6), position
        if self.joint is not None and moved:  # ignore a touch without motion
            self._on_move(self.joint, position)


REPEAT_PERIOD_S = 0.05
"""Period in [s] of force messages; the simulator releases the pull half a second after the last one."""

PULL_LIMIT_N = 2.0
"""Largest force of the mouse in [N]."""


@dataclass
class Pull:
    """A pull in progress.

    Attributes:
        vertex: Index of the pulled vertex of the visible surface.
        offset: Vector from that vertex to the point that the mouse grabbed, in [mm], shape (3,).
        target: Position of the cursor in [mm], shape (3,).
        sent_at: Time of the last message in [s].
    """

    vertex: int
    offset: NDArray[np.float64]
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    sent_at: float = -1.0

    def force(self, points: Points, stiffness: float, limit: float) -> NDArray[np.float64]:
        """Return the force on the vertex in [N], shape (3,).

        Args:
            points: Current vertices of the surface in [mm], shape (p, 3).
            stiffness: Stiffness of the spring in [N/m].
            limit: Largest force in [N].
        """
        stretch = (self.target - self.offset - points[self.vertex]) / MM
        force = stiffness * stretch
        size = float(np.linalg.norm(force))
        return np.asarray(force if size <= limit else force * (limit / size))


class MousePull:
    """Sends the force of a pull to the simulator while the mouse button is down.

    Attributes:
        stiffness: Stiffness of the spring between the body and the mouse, in [N/m].
    """

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.stiffness = 30.0

    def set_stiffness(self, stiffness: float) -> None:
        """Set the stiffness of the spring in [N/m]."""
        self.stiffness = stiffness

    def send(self, pull: Pull | None, points: Points, now: float) -> None:
        """Send the force of a pull, if any, once its period is over; arguments as in `Pull.force`."""
        if pull is not None and now - pull.sent_at >= REPEAT_PERIOD_S:
            pull.sent_at = now
            force: Array = pull.force(points, self.stiffness, PULL_LIMIT_N)
            self._simulator.pull(f"mesh_point/{pull.vertex}", force.tolist())


CAMERA_DIRECTION: Final = (0.5, -0.72, 0.48)
CAMERA_FOV: Final = 0.7
"""Vertical field of view of cameras in [rad]; small, so that near and far parts appear at the same scale."""
CAMERA_DISTANCE: Final = 1.65
"""Initial distance of the camera from the centre of the bodies, in units of their diagonal.

The camera is in CAMERA_DIRECTION from there.
"""

NARROW_SHIFT: Final = 0.2
"""Upward shift of the target in a narrow window, as a fraction of the window's height."""


class Looks(NamedTuple):
    """Colours and light around the bodies; red, green, blue in 0..255."""

    background: tuple[int, int, int]
    cells: tuple[int, int, int]
    sections: tuple[int, int, int]
    studio: float
    shadow: float


BRIGHT: Final = Looks((226, 231, 237), (198, 205, 213), (168, 176, 186), 0.35, 0.42)
LAMP_DIRECTION: Final = (0.35, -0.45, 0.82)
"""Direction from which the light comes."""
DARK: Final = Looks((24, 28, 33), (44, 50, 57), (66, 74, 84), 0.30, 0.75)
FLOOR_MM: Final = -20.0
"""Height of the grid; if bodies reach below z = 0, its height above their lowest point at rest."""

HOLLOW_OFFSET_MM: Final = 0.2
"""Distance by which chamber cavities are enlarged in the picture, to hide the walls around them."""

GOAL_HOLD_S: Final = 1.0
"""Time in [s] for which a dragged goal handle stays in place before it follows goals of others."""


class Stage:
    """The 3-D objects of a scene.

    `frames` are their names in the order of their poses; `on_goal` is called with a dragged goal, in [m].
    """

    def __init__(
        self,
        server: Any,
        inbox: Inbox,
        robot: RobotDescription,
        frames: list[str],
        on_goal: Callable[[EffectorPose], None],
        *,
        lite: bool,
        dark: bool,
    ) -> None:
        self._server, self._inbox, self._on_goal = server, inbox, on_goal
        scene, self._lite = server.scene, lite
        if lite:
            scene.configure_environment_map(None)
            scene.configure_default_lights(cast_shadow=False)
            scene.add_light_hemisphere("/lights/sky", intensity=1.5)
        else:
            scene.configure_default_lights(enabled=False)
            scene.add_light_hemisphere("/lights/sky", ground_color=BRIGHT.sections, intensity=0.7)
            scene.add_light_directional("/lights/lamp", position=LAMP_DIRECTION, intensity=1.6)
        self._floor = scene.add_grid(
            "/floor",
            width=300.0,
            height=300.0,
            cell_size=10.0,
            section_size=50.0,
            fade_distance=2000.0,
            shadow_opacity=0.0,
            position=(0.0, 0.0, FLOOR_MM),
        )
        self._axes = scene.add_frame(
            "/axes", axes_length=20.0, axes_radius=0.6, position=(-100.0, -100.0, FLOOR_MM)
        )
        self.shadow = GroundShadow(scene)
        self.paint(dark)
        self.surface = SurfaceView(scene, self._on_mesh)
        self.normals = NormalsView(scene)
        self.inner = InnerView(scene, robot, frames)
        cables = dict(enumerate(joint.name for joint in robot.joints if not joint.moves_frame))
        self.cables = MarkerView(scene, "cables", part_of=lambda _, number: f"joints/{cables.get(number)}")
        self.tensions = TensionColours([joint.moves_frame for joint in robot.joints])
        self.chambers = MarkerView(
            scene, "chambers", part_of=lambda name, _: f"joints/{name}", offset=HOLLOW_OFFSET_MM
        )
        self.contacts = MarkerView(scene, "contacts")
        self.collisions = CollisionView(scene)
        self.rigid = RigidView(scene)
        self.trail = Trail(scene)
        self.pull: Pull | None = None
        self.pull_mode = False
        self._rope = Lines(scene, "/pull", (201, 42, 42), 0.8)
        self._goal: Any = None
        self._goal_moved_at = -np.inf
        self._goal_dragged = False
        self._goal_pose: tuple[float, ...] | None = None

    def paint(self, dark: bool) -> None:
        """Set the colours of a bright or a dark page."""
        scene, looks = self._server.scene, DARK if dark else BRIGHT
        if not self._lite:
            scene.configure_environment_map("studio", environment_intensity=looks.studio)
        scene.set_background_image(np.full((2, 2, 3), looks.background, np.uint8), format="png")
        self._floor.cell_color, self._floor.section_color = looks.cells, looks.sections
        self.shadow.opacity = looks.shadow

    def show_surface(self, parts: list[Part], points: Points) -> None:
        """Show other bodies, by their visible points at rest in [mm], shape (p, 3); the grid lies below."""
        self.surface.show(parts, points)
        height = floor_height(points)
        self._floor.position = (0.0, 0.0, height)
        self._axes.position = (-100.0, -100.0, height)
        self.shadow.begin(points, height)

    def show_rigid(self, message: MarkerArray) -> None:
        """Show other rigid bodies; the grid is hidden if there are any, since they may include a floor."""
        self.rigid.show(message)
        self._floor.visible = not message.markers
        self.shadow.switch(self._floor.visible)

    def apply_view(self, view: ViewSettings) -> None:
        """Apply view settings; the camera does not move."""
        self.surface.apply_view(view)
        self.normals.switch(view.normals and view.bodies)
        self.inner.apply_view(view)
        self.cables.switch(view.cables, view.hidden)
        self.cables.line_colours = self.tensions.colours if view.tensions else {}
        self.chambers.switch(view.chambers, view.hidden)
        self.contacts.switch(view.contacts)
        self.collisions.apply_view(view)
        self.trail.switch(view.trail)
        self.rigid.switch(view.rigid, axes=view.frames, hidden=view.hidden)

    # --- goal -----------------------------------------------------------------------------------------

    def show_goal(self, pose: EffectorPose | None, now: float) -> None:
        """Move the handle of the goal, unless it is being dragged; None hides it."""
        if pose is None:
            if self._goal is not None:
                self._goal.remove()
                self._goal, self._goal_dragged, self._goal_pose = None, False, None
            return
        if self._goal is not None and (self._goal_dragged or now - self._goal_moved_at < GOAL_HOLD_S):
            return
        x, y, z, w = pose.quaternion_xyzw
        shown = (*(np.array(pose.position) * MM), w, x, y, z)
        if self._goal is None:
            self._make_goal(shown)
        elif self._goal_pose is None or not np.allclose(shown, self._goal_pose, atol=1e-6):
            self._goal.position, self._goal.wxyz = shown[:3], shown[3:]
        else:
            return
        self._goal_pose = shown

    def _make_goal(self, pose: tuple[float, ...]) -> None:
        # A page may draw between two messages: a handle that is placed afterwards would flash at the origin.
        self._goal = self._server.scene.add_transform_controls(
            "/goal", scale=25.0, depth_test=False, position=pose[:3], wxyz=pose[3:]
        )
        self._server.scene.add_icosphere("/goal/ball", radius=2.0, color=(240, 62, 62))

        async def on_move(event: Any) -> None:
            position, turn = np.array(event.target.position), np.array(event.target.wxyz)
            phase = event.phase
            self._inbox.put(lambda: self._drag_goal(phase, position, turn))

        self._goal.on_update(on_move)

    def _drag_goal(self, phase: str, position: NDArray[Any], wxyz: NDArray[Any]) -> None:
        self._goal_dragged = phase != "end"
        self._goal_moved_at = self.now
        pose = (*position, *wxyz)
        if self._goal_pose is not None and np.allclose(pose, self._goal_pose, atol=1e-6):
            return  # ignore a touch without motion
        self._goal_pose = pose
        x, y, z = (position / MM).tolist()
        w, i, j, k = wxyz.tolist()
        self._on_goal(EffectorPose((x, y, z), (i, j, k, w)))

    now: float = 0.0
    """Steady clock of the frame being served, in [s]; set by the node."""

    # --- pull -----------------------------------------------------------------------------------------

    def set_pull_mode(self, on: bool) -> None:
        """Choose whether a plain drag pulls too, for devices without a Shift key."""
        self.pull_mode = on
        self.surface.rebuild()

    def _on_mesh(self, mesh: Any) -> None:
        async def on_drag(event: Any) -> None:
            start, end, phase = np.array(event.start_position), np.array(event.end_position), event.phase
            self._inbox.put(lambda: self._drag_body(phase, start, end))

        mesh.on_drag("left", modifier="shift")(on_drag)
        if self.pull_mode:
            mesh.on_drag("left")(on_drag)

    def _drag_body(self, phase: str, start: NDArray[Any], end: NDArray[Any]) -> None:
        if phase == "end":
            self.pull = None
        else:
            if self.pull is None:
                vertex = self.surface.nearest(start.astype(np.float32))
                self.pull = Pull(vertex, start - self.surface.points[vertex])
            self.pull.target = end
        self.draw_rope()

    def draw_rope(self) -> None:
        """Draw the line from the pulled vertex to the cursor."""
        pull = self.pull
        if pull is None:
            self._rope.show(None)
            return
        start = self.surface.points[pull.vertex] + pull.offset
        self._rope.show(np.array([[start, pull.target]], dtype=np.float32))


def floor_height(points: Points) -> float:
    """Return the height in [mm] of the grid below `points` (p, 3) in [mm].

    It is FLOOR_MM for bodies that stand on z = 0.
    """
    return FLOOR_MM + float(points[:, 2].min(initial=0.0))


def camera_for(points: Points) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return position and target of a camera that sees `points` (p, 3) in [mm] beside the panel."""
    if not len(points):
        points = np.array([[-60.0, -60.0, 0.0], [60.0, 60.0, 30.0]], dtype=np.float32)
    lower, upper = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    diagonal = float(np.linalg.norm(upper - lower))
    below = 0.12 * float(np.linalg.norm((upper - lower)[:2]))  # space for the shadow
    target = 0.5 * (lower + upper) - (0.0, 0.0, below)
    position = target + CAMERA_DISTANCE * diagonal * np.array(CAMERA_DIRECTION)
    return tuple(position.tolist()), tuple(target.tolist())


def for_window(
    position: Sequence[float], target: Sequence[float], aspect: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the same view for a window with an aspect ratio of width over height.

    In a narrow window, such as a phone's, the camera is farther away. There the panel covers the lower half,
    so the target moves up.
    """
    if aspect >= 1.0:
        return tuple(position), tuple(target)
    looked_at = np.array(target, float)
    way = (np.array(position, float) - looked_at) / max(aspect, 0.2)
    looked_at[2] -= 2.0 * NARROW_SHIFT * np.linalg.norm(way) * np.tan(0.5 * CAMERA_FOV)
    return tuple((looked_at + way).tolist()), tuple(looked_at.tolist())


def move_cameras(server: Any, position: Sequence[float], target: Sequence[float]) -> None:
    """Move the camera of every present and future browser; in [mm]."""
    server.initial_camera.position, server.initial_camera.look_at = position, target
    for client in server.get_clients().values():
        move_camera(client, position, target)


def move_camera(client: Any, position: Sequence[float], target: Sequence[float]) -> None:
    """Move the camera of one browser; in [mm]."""
    client.camera.position, client.camera.look_at = for_window(position, target, client.camera.aspect)
    client.camera.up_direction = (0.0, 0.0, 1.0)
