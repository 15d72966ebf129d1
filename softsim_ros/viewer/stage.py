"""The 3-D side of the page: bodies, inside, markers, goal handle, pull; positions in mm, colours fixed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import MarkerArray

from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.view import ViewSettings
from softsim_ros.client.state import EffectorPose
from softsim_ros.viewer.collision_view import CollisionView
from softsim_ros.viewer.ground_shadow import GroundShadow
from softsim_ros.viewer.inner_view import InnerView
from softsim_ros.viewer.marker_view import MarkerView, RigidView
from softsim_ros.viewer.normals_view import NormalsView
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.pull import Pull
from softsim_ros.viewer.surface import MM, Part, SurfaceView
from softsim_ros.viewer.trail import Trail

CAMERA_DIRECTION: Final = (0.5, -0.72, 0.48)
CAMERA_FOV: Final = 0.7
"""Angle in [rad] that cameras see from bottom to top: little, so that near and far parts look alike."""
CAMERA_DISTANCE: Final = 1.65
"""Where the camera starts: this way from the middle of the bodies, so many times their diagonal away."""

NARROW_SHIFT: Final = 0.2
"""Share of the height of a narrow window by which what is looked at goes up."""


class Looks(NamedTuple):
    """Colours and light around the bodies, red, green, blue in 0..255."""

    background: tuple[int, int, int]
    cells: tuple[int, int, int]
    sections: tuple[int, int, int]
    studio: float
    shadow: float


BRIGHT: Final = Looks((226, 231, 237), (198, 205, 213), (168, 176, 186), 0.35, 0.42)
LAMP_DIRECTION: Final = (0.35, -0.45, 0.82)
"""From where the light comes."""
DARK: Final = Looks((24, 28, 33), (44, 50, 57), (66, 74, 84), 0.30, 0.75)
FLOOR_MM: Final = -20.0
"""Height of the grid; where bodies hang below z = 0, it lies as far below their lowest point at rest."""

HOLLOW_OFFSET_MM: Final = 0.2
"""Hollows are drawn so much larger, to hide the walls of the bodies around them."""

GOAL_HOLD_S: Final = 1.0
"""After it was dragged the goal handle stays this long, in [s], before it follows the goals of others."""


class Stage:
    """What a scene shows.

    Args:
        server: viser's server.
        inbox: Where the mouse's events go.
        robot: The scene.
        frames: Names of its frames in the order of their poses.
        on_goal: Called with a dragged goal, in [m].
        lite: Cheap light and no shadows, for machines without a graphics card.
        dark: Light on dark ground.
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
        self.chambers = MarkerView(
            scene, "chambers", part_of=lambda name, _: f"joints/{name}", offset=HOLLOW_OFFSET_MM
        )
        self.contacts = MarkerView(scene, "contacts")
        self.collisions = CollisionView(scene)
        self.rigid = RigidView(scene)
        self.trail = Trail(scene)
        self.pull: Pull | None = None
        self.pull_mode = False
        self._rope: Any = None
        self._goal: Any = None
        self._goal_moved_at = -np.inf
        self._goal_dragged = False
        self._goal_pose: tuple[float, ...] | None = None

    def paint(self, dark: bool) -> None:
        """Take the colours of a bright or a dark page."""
        scene, looks = self._server.scene, DARK if dark else BRIGHT
        if not self._lite:
            scene.configure_environment_map("studio", environment_intensity=looks.studio)
        scene.set_background_image(np.full((2, 2, 3), looks.background, np.uint8), format="png")
        self._floor.cell_color, self._floor.section_color = looks.cells, looks.sections
        self.shadow.opacity = looks.shadow

    def show_surface(self, parts: list[Part], points: NDArray[np.float32]) -> None:
        """Take bodies by their visible points at rest in [mm], shape (p, 3); the grid lies below."""
        self.surface.show(parts, points)
        height = floor_height(points)
        self._floor.position = (0.0, 0.0, height)
        self._axes.position = (-100.0, -100.0, height)
        self.shadow.begin(points, height)

    def show_rigid(self, message: MarkerArray) -> None:
        """Take other rigid bodies; the grid gives way to a floor of the scene's own."""
        self.rigid.show(message)
        self._floor.visible = not message.markers
        self.shadow.switch(self._floor.visible)

    def obey(self, view: ViewSettings) -> None:
        """Show what a view says; the camera stays."""
        self.surface.obey(view)
        self.normals.switch(view.normals and view.bodies)
        self.inner.obey(view)
        self.cables.switch(view.cables, view.hidden)
        self.chambers.switch(view.chambers, view.hidden)
        self.contacts.switch(view.contacts)
        self.collisions.obey(view)
        self.trail.switch(view.trail)
        self.rigid.switch(view.rigid, axes=view.frames, hidden=view.hidden)

    # --- goal -----------------------------------------------------------------------------------------

    def show_goal(self, pose: EffectorPose | None, now: float) -> None:
        """Place the handle of the goal; None hides it. A handle that is being dragged stays in the hand."""
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

        async def moved(event: Any) -> None:
            position, turn = np.array(event.target.position), np.array(event.target.wxyz)
            phase = event.phase
            self._inbox.put(lambda: self._drag_goal(phase, position, turn))

        self._goal.on_update(moved)

    def _drag_goal(self, phase: str, position: NDArray[Any], wxyz: NDArray[Any]) -> None:
        self._goal_dragged = phase != "end"
        self._goal_moved_at = self.now
        pose = (*position, *wxyz)
        if self._goal_pose is not None and np.allclose(pose, self._goal_pose, atol=1e-6):
            return  # the handle was touched, not moved
        self._goal_pose = pose
        x, y, z = (position / MM).tolist()
        w, i, j, k = wxyz.tolist()
        self._on_goal(EffectorPose((x, y, z), (i, j, k, w)))

    now: float = 0.0
    """Steady clock of the frame being served, in [s]; set by the node."""

    # --- pull -----------------------------------------------------------------------------------------

    def set_pull_mode(self, on: bool) -> None:
        """Let a plain drag pull, too, where there is no Shift key."""
        self.pull_mode = on
        self.surface.rebuild()

    def _on_mesh(self, mesh: Any) -> None:
        async def dragged(event: Any) -> None:
            start, end, phase = np.array(event.start_position), np.array(event.end_position), event.phase
            self._inbox.put(lambda: self._drag_body(phase, start, end))

        mesh.on_drag("left", modifier="shift")(dragged)
        if self.pull_mode:
            mesh.on_drag("left")(dragged)

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
        if self.pull is None:
            if self._rope is not None:
                self._rope.remove()
                self._rope = None
            return
        start = self.surface.points[self.pull.vertex] + self.pull.offset
        line = np.array([[start, self.pull.target]], dtype=np.float32)
        if self._rope is None:
            self._rope = self._server.scene.add_line_segments("/pull", line, (201, 42, 42), thickness=0.8)
        else:
            self._rope.points = line

    def let_go(self) -> None:
        """End a pull."""
        self.pull = None
        self.draw_rope()


def floor_height(points: NDArray[np.float32]) -> float:
    """Height in [mm] of a grid below `points` (p, 3) in [mm]; what stands on z = 0 has it at FLOOR_MM."""
    return FLOOR_MM + float(points[:, 2].min(initial=0.0))


def camera_for(points: NDArray[np.float32]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position and target of a camera that sees `points` (p, 3) in [mm] beside the panel."""
    if not len(points):
        points = np.array([[-60.0, -60.0, 0.0], [60.0, 60.0, 30.0]], dtype=np.float32)
    lower, upper = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    diagonal = float(np.linalg.norm(upper - lower))
    below = 0.12 * float(np.linalg.norm((upper - lower)[:2]))  # room for the shadow
    target = 0.5 * (lower + upper) - (0.0, 0.0, below)
    position = target + CAMERA_DISTANCE * diagonal * np.array(CAMERA_DIRECTION)
    return tuple(position.tolist()), tuple(target.tolist())


def for_window(
    position: Sequence[float], target: Sequence[float], aspect: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The same view in a window of that width over height: a narrow one, as of a phone, is seen from farther.

    There the panel takes the lower half, so what is looked at goes up.
    """
    if aspect >= 1.0:
        return tuple(position), tuple(target)
    looked_at = np.array(target, float)
    way = (np.array(position, float) - looked_at) / max(aspect, 0.2)
    looked_at[2] -= 2.0 * NARROW_SHIFT * np.linalg.norm(way) * np.tan(0.5 * CAMERA_FOV)
    return tuple((looked_at + way).tolist()), tuple(looked_at.tolist())


def move_cameras(server: Any, position: Sequence[float], target: Sequence[float]) -> None:
    """Move the camera of every browser, and of those to come; in [mm]."""
    server.initial_camera.position, server.initial_camera.look_at = position, target
    for client in server.get_clients().values():
        move_camera(client, position, target)


def move_camera(client: Any, position: Sequence[float], target: Sequence[float]) -> None:
    """Move the camera of one browser; in [mm]."""
    client.camera.position, client.camera.look_at = for_window(position, target, client.camera.aspect)
    client.camera.up_direction = (0.0, 0.0, 1.0)
