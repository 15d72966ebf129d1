"""The 3-D picture of the page: passes the drawing topics to the stage and applies the view settings."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import String, UInt32MultiArray
from visualization_msgs.msg import MarkerArray

from softsim_core.base import Array, IndexArray
from softsim_core.scene import Camera, RobotDescription, ViewSettings
from softsim_core.scene.io import Place, Steps, place_of
from softsim_node import LATCHED, NEWEST_ONLY
from softsim_ros.client import EffectorPose
from softsim_ros.messages import (
    SceneMessage,
    mesh_checksum,
    read_point_cloud,
    read_scene_message,
    read_tension_cloud,
)
from softsim_ros.nodes.viewer.panel import Inbox
from softsim_ros.nodes.viewer.stage import BaseHandle, Stage, camera_for, move_camera, move_cameras
from softsim_ros.nodes.viewer.surface import MM, Part

SURFACE, TETRAHEDRA, POINTS, NODES = "mesh/topology", "mesh/tetrahedra", "mesh/points", "mesh/nodes"
TENSIONS: Final = "cables/tensions"
FRAMES: Final = "frames"

ERROR_WIDTH: Final = 36
"""Characters per line of an error that is shown in place of the scene."""

_SWITCHES: Any = {each.name: False for each in fields(ViewSettings) if each.type == "bool"}
NOTHING: Final = ViewSettings(**_SWITCHES)
"""View of a scene with invalid files: nothing is shown."""


class Picture:
    """Subscribes to the drawing topics and updates a stage.

    Topics: `scene/structure`, `mesh/topology`, `mesh/tetrahedra`, `mesh/points`, `frames`, `cables`,
    `chambers`, `contacts`, `bodies/topology`, `bodies/poses`; `mesh/nodes`, `collisions` and
    `cables/tensions` only while a visible layer needs them.

    Args:
        on_scene: Called with a new scene; it calls `build`.
        on_goal: Called with a dragged goal, in [m].
        on_base: Called with a joint and the position in [mm] to which its base is dragged.
        lite: Cheap light and no shadows, for machines without a graphics card.

    Attributes:
        stage: The 3-D side of the page; replaced by each `build`.
        is_dark: Whether the page has a dark background.
        base: Handle of the chosen joint's base; replaced by each `build`.
        view: Present view: that of the scene, changed by users.
        robot: The scene that is shown.
        rest: Its bodies at rest: parts, and points in [mm], shape (p, 3).
    """

    robot: RobotDescription
    stage: Stage
    base: BaseHandle
    view: ViewSettings

    def __init__(
        self,
        node: Node,
        server: Any,
        inbox: Inbox,
        on_scene: Callable[[RobotDescription], None],
        on_goal: Callable[[EffectorPose], None],
        on_base: Callable[[str, Array], None],
        *,
        lite: bool,
    ) -> None:
        self._node, self._server, self._inbox = node, server, inbox
        self._on_scene, self._on_goal, self._on_base, self._lite = on_scene, on_goal, on_base, lite
        self._error = ""
        self._is_hidden = False
        self.is_dark = False
        self.rest: tuple[list[Part], NDArray[np.float32]] = ([], np.zeros((0, 3), np.float32))
        self._error_label: Any = None
        self._scene: SceneMessage | None = None
        self._viewed_robot = ""
        self._begun: tuple[str, ViewSettings] | None = None
        self._left: dict[bool, tuple[tuple[float, ...], tuple[float, ...]]] = {}
        self._rigid: MarkerArray | None = None
        self._surface: tuple[Array, IndexArray] | None = None
        self._tetrahedra: IndexArray = np.zeros((0, 4), np.int64)
        self._newest: dict[str, Any] = {}  # messages that the next frame draws, by topic
        self._on_demand: dict[str, Any] = {}
        self._pull_mode = False
        self._subscribe()

    def _subscribe(self) -> None:
        subscribe = self._node.create_subscription
        subscribe(String, "scene/structure", self._on_structure, LATCHED)
        subscribe(Mesh, SURFACE, self._on_topology, LATCHED)
        subscribe(UInt32MultiArray, TETRAHEDRA, self._on_tetrahedra, LATCHED)
        subscribe(PointCloud2, POINTS, partial(self._store, POINTS), NEWEST_ONLY)
        subscribe(PoseArray, FRAMES, partial(self._store, FRAMES), NEWEST_ONLY)
        for layer in ("cables", "chambers", "contacts"):
            subscribe(MarkerArray, layer, partial(self._update, layer), NEWEST_ONLY)
        subscribe(MarkerArray, "bodies/topology", self._on_rigid, LATCHED)
        subscribe(PoseArray, "bodies/poses", lambda message: self.stage.rigid.move(message), NEWEST_ONLY)

    # --- a scene --------------------------------------------------------------------------------------

    def build(self, robot: RobotDescription) -> None:
        """Build the stage of a scene on the server's empty 3-D scene; a reloaded scene keeps its view."""
        if self._begun != (robot.name, robot.view):
            self._begun, self.view = (robot.name, robot.view), robot.view
            self._viewed_robot = ""
            self._left.clear()
        self.robot = robot
        frames = [] if self._scene is None else list(self._scene.frames)
        self._error, self._error_label = "", None
        self.stage = Stage(
            self._server, self._inbox, robot, frames, self._on_goal, lite=self._lite, dark=self.is_dark
        )
        self.base = BaseHandle(self._server.scene, self._inbox, self._on_base)
        self.stage.set_pull_mode(self._pull_mode)
        self.show(self.view)

    @property
    def overrides(self) -> str:
        """Overrides of the scene's file, as YAML text."""
        return "" if self._scene is None else self._scene.overrides

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes that the simulator can load; empty until it has published them."""
        return () if self._scene is None else self._scene.scenes

    def place(self, steps: Steps) -> Place | None:
        """Return file and line of a part of the scene; None until the simulator has published them."""
        return None if self._scene is None else place_of(self._scene.places, steps)

    def show_arrived_meshes(self) -> None:
        """Draw surface and rigid bodies that arrived before the structure."""
        self._show_surface()
        self._show_rigid()

    def _on_structure(self, message: String) -> None:
        scene = read_scene_message(message.data)
        if self._scene is None or scene.generation != self._scene.generation:
            self._scene = scene
            self._newest.clear()  # positions of the previous scene
            self._on_scene(scene.robot)

    def _on_topology(self, message: Mesh) -> None:
        points = np.array([(p.x, p.y, p.z) for p in message.vertices]).reshape(-1, 3)
        triangles = np.array([t.vertex_indices for t in message.triangles], np.int64).reshape(-1, 3)
        self._surface = points, triangles
        self._show_surface()

    def _on_tetrahedra(self, message: UInt32MultiArray) -> None:
        self._tetrahedra = np.array(message.data, dtype=np.int64).reshape(-1, message.layout.dim[1].size)
        self._show_surface()

    def _on_rigid(self, message: MarkerArray) -> None:
        self._rigid = message
        self._show_rigid()

    def _show_rigid(self) -> None:
        """Draw the rigid bodies if they belong to the present scene."""
        if self._rigid is None:
            return
        named = [marker.ns for marker in self._rigid.markers]
        if self._scene is None or named == [body.name for body in self._scene.robot.scene.rigid_bodies]:
            self.stage.show_rigid(self._rigid)

    def _show_surface(self) -> None:
        """Draw the bodies once surface, elements and structure belong to one scene."""
        scene = self._scene
        if scene is None or self._surface is None or not self._are_of(scene, *self._surface):
            return  # other messages of the new scene are missing
        (points, triangles), bodies = self._surface, scene.bodies
        parts = [
            Part(
                body["name"],
                tuple(body["points"]),
                triangles[slice(*body["triangles"])],
                tuple(body["colour"]),
            )
            for body in bodies
        ]
        self.rest = parts, (points * MM).astype(np.float32)
        with self._server.atomic():
            self.stage.show_surface(*self.rest)
            self.stage.inner.set_structure(self._tetrahedra, scene.bodies, scene.regions)
        if self._viewed_robot != scene.robot.name:  # a reloaded scene keeps the view
            self._viewed_robot = scene.robot.name
            self.reset_view()

    def _are_of(self, scene: SceneMessage, points: Array, triangles: IndexArray) -> bool:
        """Return whether the newest surface and elements belong to a scene, by their sizes and checksums."""
        count = sum(body["points"][1] - body["points"][0] for body in scene.bodies)
        fits = count == len(points) and int(triangles.max(initial=-1)) < count
        surface, elements = mesh_checksum(triangles, points), mesh_checksum(self._tetrahedra)
        return fits and scene.owns(SURFACE, surface) and scene.owns(TETRAHEDRA, elements)

    # --- motion ---------------------------------------------------------------------------------------

    @property
    def has_news(self) -> bool:
        """Whether new vertex positions have arrived since the last frame."""
        return POINTS in self._newest

    def _store(self, topic: str, message: Any) -> None:
        """Store a message until the next frame draws it."""
        self._newest[topic] = message

    def _update(self, layer: str, message: MarkerArray) -> None:
        """Draw markers of the layer that has the name of their topic."""
        getattr(self.stage, layer).update(message)

    def draw(self, now: float) -> None:
        """Draw messages that have arrived since the last frame; `now` is a steady clock in [s]."""
        stage = self.stage
        if (message := self._newest.pop(POINTS, None)) is not None:
            vertices = read_point_cloud(message)
            stage.surface.update(vertices[:, :3] * np.float32(MM), vertices[:, 3], now)
            stage.normals.update(stage.surface.points, stage.surface.triangles, now)
            stage.shadow.follow(stage.surface.points, stage.surface.triangles, now)
            if stage.pull is not None:
                stage.draw_rope()
        if (frames := self._newest.pop(FRAMES, None)) is not None:
            pairs = [(pose.position, pose.orientation) for pose in frames.poses]
            rows = [(MM * at.x, MM * at.y, MM * at.z, turn.x, turn.y, turn.z, turn.w) for at, turn in pairs]
            poses, names = np.array(rows).reshape(-1, 7), () if self._scene is None else self._scene.frames
            stage.inner.move_frames(poses)
            if self.base.joint in names and len(poses) == len(names):
                self.base.follow(poses[names.index(self.base.joint), :3])
        if (nodes := self._newest.pop(NODES, None)) is not None:
            stage.inner.move_nodes(MM * read_point_cloud(nodes)[:, :3].astype(float))
        if (tensions := self._newest.pop(TENSIONS, None)) is not None:
            stage.tensions.update(read_tension_cloud(tensions))

    # --- the view -------------------------------------------------------------------------------------

    def show(self, view: ViewSettings) -> None:
        """Apply view settings, and subscribe to large messages only while needed. Cameras do not move."""
        self.view = view
        self.stage.apply_view(NOTHING if self._error or self._is_hidden else view)
        self._want(PointCloud2, NODES, partial(self._store, NODES), self.stage.inner.needs_nodes)
        collisions = view.collisions or view.search_boxes
        self._want(MarkerArray, "collisions", partial(self._update, "collisions"), collisions)
        self._want(PointCloud2, TENSIONS, partial(self._store, TENSIONS), view.tensions and view.cables)

    def hide_scene(self, hidden: bool) -> None:
        """Hide the running scene (`hidden` True), for example while a proposal is shown, or show it again."""
        if hidden != self._is_hidden:
            self._is_hidden = hidden
            self.show(self.view)

    def show_error(self, message: str) -> None:
        """Show a message instead of the scene; an empty one shows the scene again."""
        if message == self._error:
            return
        self._error = message
        if self._error_label is not None:
            self._error_label.remove()
            self._error_label = None
        self.show(self.view)
        if message:
            points = self.stage.surface.points
            self._error_label = self._server.scene.add_label(
                "/error",
                "\n".join(textwrap.wrap(message, ERROR_WIDTH)),
                position=points.mean(axis=0) if len(points) else (0.0, 0.0, 0.0),
                font_screen_scale=1.3,
                anchor="center-center",
            )

    def change(self, **values: Any) -> None:
        """Change some fields of the present view."""
        self.show(replace(self.view, **values))

    def set_dark(self, dark: bool) -> None:
        """Set the colours of a bright or a dark page."""
        self.is_dark = dark
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)
        self.stage.paint(dark)

    def set_pull_mode(self, on: bool) -> None:
        """Choose whether a plain drag pulls too, for devices without a Shift key."""
        self._pull_mode = on
        self.stage.set_pull_mode(on)

    def extent(self, axis: int) -> tuple[float, float]:
        """Return the range of the bodies at rest along an axis in [mm]; 0 and 0 without bodies."""
        along = self.rest[1][:, axis]
        return (float(along.min()), float(along.max())) if len(along) else (0.0, 0.0)

    def hide(self, part: str, hidden: bool) -> None:
        """Hide or show a part of the scene, such as "bodies/silicone"."""
        others = tuple(each for each in self.view.hidden if each != part)
        self.change(hidden=(*others, part) if hidden else others)

    def save_view(self, position: Sequence[float], target: Sequence[float]) -> None:
        """Set the camera of `reset_view`, in [mm]."""
        near, far = ([round(each / MM, 5) for each in point] for point in (position, target))
        self.change(camera=Camera(position=(near[0], near[1], near[2]), target=(far[0], far[1], far[2])))

    def reset_view(self) -> None:
        """Move every camera to that of the view, or to one that sees all bodies."""
        self._left.clear()
        camera = self.view.camera
        if camera is None:
            points = np.concatenate([self.stage.surface.points, MM * landmarks(self.robot)])
            position, target = camera_for(points)
        else:
            position = tuple(MM * each for each in camera.position)
            target = tuple(MM * each for each in camera.target)
        move_cameras(self._server, position, target)

    def welcome(self, client: Any) -> None:
        """Place the camera of a new browser.

        It gets the camera of the last browser that left a window of that shape, else the initial one, farther
        away for a narrow window.
        """
        camera, is_narrow = self._server.initial_camera, client.camera.aspect < 1.0
        if is_narrow in self._left:
            client.camera.position, client.camera.look_at = self._left[is_narrow]
            client.camera.up_direction = (0.0, 0.0, 1.0)
        elif is_narrow:
            move_camera(client, camera.position.tolist(), camera.look_at.tolist())

    def leave(self, client: Any) -> None:
        """Store the camera of a leaving browser for the next one with a window as wide or as narrow."""
        position, target = client.camera.position.tolist(), client.camera.look_at.tolist()
        self._left[client.camera.aspect < 1.0] = tuple(position), tuple(target)

    def _want(self, kind: Any, topic: str, callback: Callable[[Any], None], is_needed: bool) -> None:
        """Subscribe to a topic if its messages are needed, else unsubscribe."""
        if is_needed and topic not in self._on_demand:
            self._on_demand[topic] = self._node.create_subscription(kind, topic, callback, NEWEST_ONLY)
        elif not is_needed and topic in self._on_demand:
            self._node.destroy_subscription(self._on_demand.pop(topic))


def landmarks(robot: RobotDescription) -> NDArray[np.float32]:
    """Return positions that a first view includes besides the bodies, in [m], shape (k, 3).

    These are servos, pull points of cables, and loads.
    """
    scene = robot.scene
    places = [joint.base.translation for joint in scene.joints if joint.horn_length > 0.0]
    pulls = [getattr(joint.actuator, "pull_point", None) for joint in scene.joints]
    loads = [body.pose.translation for body in scene.rigid_bodies if body.mass is not None]
    return np.array([*places, *filter(None, pulls), *loads], np.float32).reshape(-1, 3)
