"""ROS node `viewer`: the robot's topics in a web page, and the page's controls as topics and services."""

from __future__ import annotations

import json
import math
import os
import secrets
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import ok, try_shutdown
from sensor_msgs.msg import JointState, PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import String, UInt32MultiArray
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from softsim_core.arrays import Array
from softsim_core.errors import SoftSimError
from softsim_core.scene import load_scene
from softsim_core.scene.description import SceneDescription
from softsim_ros.environment import prepare_environment
from softsim_ros.messages import header, read_point_cloud
from softsim_ros.runtime import complain
from softsim_ros.teleop.commands import move_joint
from softsim_ros.teleop.decoder import KeyPress
from softsim_ros.teleop.goal import PublishGoal
from softsim_ros.teleop.loop import ready_callbacks
from softsim_ros.teleop.services import AsyncService
from softsim_ros.teleop.state import EffectorPose
from softsim_ros.teleop.teleop_node import Teleop
from softsim_ros.viewer.controls import Controls
from softsim_ros.viewer.guard import AccessRule, GuardedServer, is_loopback
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.parameters_link import ParametersLink
from softsim_ros.viewer.pull import REPEAT_PERIOD_S
from softsim_ros.viewer.requested import ViewerSettings, requested_settings
from softsim_ros.viewer.stage import Stage, reset_cameras
from softsim_ros.viewer.surface import MM, Part
from softsim_ros.viewer.tuning import Tunable

FRAME_S: Final = 1.0 / 30.0
TICK_PERIOD_S: Final = 0.1
PLOT_PERIOD_S: Final = 0.2
PULL_LIMIT_N: Final = 2.0
"""Largest force of the mouse in [N]."""

_NEWEST_ONLY = QoSProfile(depth=1)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Viewer(Teleop):
    """A teleop whose keys and display are a web page; see `frame` for its loop.

    Topics in besides the teleop's: `scene/structure`, `mesh/topology`, `mesh/tetrahedra`, `mesh/points`,
    `mesh/nodes` (only while something is shown that needs it), `frames`, `cables`, `contacts`,
    `bodies/topology`, `bodies/poses`, `effector_goal`, `stage_statistics`; out: `external_wrench`.

    Args:
        robot: What is shown until the simulator tells its own scene.
        settings: Address and looks.
        **node_options: Passed on to rclpy's Node.

    Raises:
        ViewerError: the page cannot be served.
    """

    def __init__(self, robot: SceneDescription, settings: ViewerSettings, **node_options: Any) -> None:
        super().__init__(robot, "viewer", **node_options)
        self._settings = settings = settings.declare(self)
        self._inbox = Inbox()
        token = settings.token or (None if is_loopback(settings.host) else secrets.token_urlsafe(18))
        self._server = GuardedServer(AccessRule(settings.host, settings.port, token), robot.name)
        self.scene_name = robot.name
        self.efforts: Sequence[float] = ()
        self.stages: dict[str, dict[str, str]] = {}
        self.fault = ""
        self.e_stopped = False
        self.goal_error_mm = 0.0
        self.pull_stiffness = 30.0
        self.slider_at = -math.inf
        self._structure: dict[str, Any] = {}
        self._seen = ""
        self._rigid: MarkerArray | None = None
        self._topology: Mesh | None = None
        self._tetrahedra = np.zeros((0, 4), np.int64)
        self._points: PointCloud2 | None = None
        self._nodes: PointCloud2 | None = None
        self._frames: PoseArray | None = None
        self._goal: EffectorPose | None = None
        self._next_tick = self._next_plot = 0.0
        self._step = AsyncService(self, Trigger, "simulator/step")
        self._reload = AsyncService(self, Trigger, "simulator/reload", 60.0)
        self._e_stop = AsyncService(self, Trigger, "servo_bridge/e_stop")
        self._clear = AsyncService(self, Trigger, "servo_bridge/clear_e_stop")
        self._wrenches = self.create_publisher(WrenchStamped, "external_wrench", _NEWEST_ONLY)
        self._subscribe()
        self.parameters = ParametersLink(self, self._on_values, self.say)
        self._build_page()

    @property
    def address(self) -> str:
        """What a person opens in a browser."""
        return self._server.rule.address

    @property
    def is_orphan(self) -> bool:
        """Whether the program that started this one has ended, however."""
        return self._settings.parent not in (0, os.getppid())

    def close(self) -> None:
        """Close the page and end the node; a second call does nothing."""
        self._server.stop()
        super().close()

    def _subscribe(self) -> None:
        subscribe = self.create_subscription
        subscribe(String, "scene/structure", self._on_structure, _LATCHED)
        subscribe(Mesh, "mesh/topology", self._on_topology, _LATCHED)
        subscribe(UInt32MultiArray, "mesh/tetrahedra", self._on_tetrahedra, _LATCHED)
        subscribe(PointCloud2, "mesh/points", self._on_points, _NEWEST_ONLY)
        subscribe(PoseArray, "frames", self._on_frames, _NEWEST_ONLY)
        subscribe(PoseStamped, "effector_goal", self._on_goal, _NEWEST_ONLY)
        subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        subscribe(DiagnosticArray, "stage_statistics", self._on_stages, _NEWEST_ONLY)
        subscribe(MarkerArray, "cables", lambda message: self.stage.cables.update(message), _NEWEST_ONLY)
        subscribe(MarkerArray, "contacts", lambda message: self.stage.contacts.update(message), _NEWEST_ONLY)
        subscribe(MarkerArray, "bodies/topology", self._on_rigid, _LATCHED)
        subscribe(PoseArray, "bodies/poses", lambda message: self.stage.rigid.move(message), _NEWEST_ONLY)
        self._nodes_subscription: Any = None

    def _build_page(self) -> None:
        """Scene and panel for `self.robot`; the cameras stay where they are."""
        with self._server.atomic():
            self._server.gui.reset()
            self._server.scene.reset()
            self._server.gui.configure_theme(show_logo=False, show_share_button=False)
            frames = list(self._structure.get("frames", ()))
            self.stage = Stage(
                self._server, self._inbox, self.robot, frames, self._drag_goal, lite=self._settings.lite
            )
            self.controls = Controls(self._server, self._inbox, self, self.robot)
        self.parameters.names = self.controls.parameter_names
        self._show_surface()
        if self._rigid is not None:  # it may have come before the structure
            self.stage.show_rigid(self._rigid)

    # --- the loop -------------------------------------------------------------------------------------

    def frame(self, now: float) -> None:
        """Serve what browsers did, then show what arrived; about 30 times a second, `now` in [s]."""
        self.stage.now = now
        for action in self._inbox.take():
            action()
        with self._server.atomic():
            self._draw(now)
        if now >= self._next_tick:
            self._next_tick = now + TICK_PERIOD_S
            self.tick(now)
            with self._server.atomic():
                self.controls.refresh(now)
        if now >= self._next_plot:
            self._next_plot = now + PLOT_PERIOD_S
            self.controls.add_to_plots(now - self._started_at)
        self._send_pull(now)

    _started_at: float = time.monotonic()

    def tick(self, now: float) -> None:
        """Housekeeping: links, calls without an answer, the goal's distance."""
        super().tick(now)
        self.state = self._inverse.follow(self.state, now)
        self.parameters.poll(now)
        for service in (self._step, self._reload, self._e_stop, self._clear):
            service.expire(now)
        goal = self._goal if self.state.inverse else None
        effector = self.state.effector
        if goal is None and self.state.inverse:
            goal = effector
        self.stage.show_goal(goal, now)
        known = self._goal is not None and self.state.inverse and effector is not None
        self.goal_error_mm = (
            MM * math.dist(self._goal.position, effector.position)
            if known and self._goal is not None and effector is not None
            else 0.0
        )
        if not self.state.inverse:
            self._goal = None

    def _draw(self, now: float) -> None:
        message, self._points = self._points, None
        if message is not None:
            rows = read_point_cloud(message)
            self.stage.surface.update(rows[:, :3] * np.float32(MM), rows[:, 3], now)
            if self.stage.pull is not None:
                self.stage.draw_rope()
        frames, self._frames = self._frames, None
        if frames is not None:
            self.stage.inner.move_frames(_pose_rows(frames))
        nodes, self._nodes = self._nodes, None
        if nodes is not None:
            self.stage.inner.move_nodes(MM * read_point_cloud(nodes)[:, :3].astype(float))

    # --- what arrives ---------------------------------------------------------------------------------

    def _on_joint_states(self, message: JointState) -> None:
        super()._on_joint_states(message)
        order = self._joint_order[1]
        if order is not None and len(message.effort) == len(message.name):
            self.efforts = [message.effort[index] for index in order]

    def _on_rigid(self, message: MarkerArray) -> None:
        self._rigid = message
        self.stage.show_rigid(message)

    def _on_structure(self, message: String) -> None:
        """Another scene: its description is read anew from its file, and the page is made anew."""
        self._structure = json.loads(message.data)
        source = self._structure.get("source")
        robot = self.robot
        if source is not None:
            try:
                robot = load_scene(source)
            except SoftSimError as error:
                self.say(str(error))
        self._take_scene(robot)

    def _take_scene(self, robot: SceneDescription) -> None:
        self.scene_name, self.robot = robot.name, robot
        self._joint_order = ((), None)
        self.efforts = ()
        self.state = replace(self.state, measured=None, commanded=None, measured_at=-math.inf)
        self._build_page()

    def _on_topology(self, message: Mesh) -> None:
        self._topology = message
        self._show_surface()

    def _on_tetrahedra(self, message: UInt32MultiArray) -> None:
        self._tetrahedra = np.array(message.data, dtype=np.int64).reshape(-1, message.layout.dim[1].size)
        self._show_surface()

    def _show_surface(self) -> None:
        """Draw the bodies once surface and structure are those of one scene."""
        structure, message = self._structure, self._topology
        if message is None or not structure:
            return
        points = np.array([(p.x, p.y, p.z) for p in message.vertices]).reshape(-1, 3)
        triangles = np.array([t.vertex_indices for t in message.triangles], np.int64).reshape(-1, 3)
        bodies = structure["bodies"]
        if sum(b["points"][1] - b["points"][0] for b in bodies) != len(points):
            return  # the other half of the new scene has not come yet
        parts = [
            Part(
                body["name"],
                tuple(body["points"]),
                triangles[slice(*body["triangles"])],
                tuple(body["colour"]),
            )
            for body in bodies
        ]
        with self._server.atomic():
            self.stage.surface.show(parts, (points * MM).astype(np.float32))
            self.stage.inner.set_structure(self._tetrahedra, structure["zones"])
        if self._seen != structure["name"]:  # the same scene loaded anew keeps the view
            self._seen = structure["name"]
            self.reset_view()

    def _on_points(self, message: PointCloud2) -> None:
        self._points = message

    def _on_nodes(self, message: PointCloud2) -> None:
        self._nodes = message

    def _on_frames(self, message: PoseArray) -> None:
        self._frames = message

    def _on_goal(self, message: PoseStamped) -> None:
        place, turn = message.pose.position, message.pose.orientation
        self._goal = EffectorPose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        space = self.get_namespace().strip("/")
        for status in message.status:
            if status.name == f"{space}/simulator":
                self.fault = status.message if status.level == b"\x02" else ""
            elif status.name == f"{space}/servo_bridge: servo board":
                values = {pair.key: pair.value for pair in status.values}
                self.e_stopped = values.get("e_stop") == "True"

    def _on_stages(self, message: DiagnosticArray) -> None:
        self.stages = {s.name: {pair.key: pair.value for pair in s.values} for s in message.status}

    def _on_values(self, values: dict[str, Any]) -> None:
        self.controls.show_tuned(values)

    # --- what a person does ---------------------------------------------------------------------------

    def press_button(self, name: str) -> None:
        """A click on a key's button: it acts each time, as no key is held."""
        seen = {key: at for key, at in self.state.seen_at.items() if key != name}
        self.state = replace(self.state, seen_at=seen)
        self.handle_key(KeyPress(name), time.monotonic())

    def press_hotkey(self, name: str) -> None:
        """A key with Ctrl; one that is held down repeats, and is slowed down as in the teleop."""
        self.handle_key(KeyPress(name, ctrl=True), time.monotonic())

    def drive_joint(self, joint: str, position: float) -> None:
        """Ask a joint to a position in [rad] or [m]."""
        now = self.slider_at = time.monotonic()
        self.state, effects = move_joint(self.state, self.robot, joint, position, now)
        self.carry_out(effects, now)

    def toggle_pause(self) -> None:
        """Run or pause the simulation."""
        pause = self.state.simulator not in ("paused", "stopped")
        self._ask_pause(pause, lambda: self._on_paused(pause))

    def _ask_pause(self, pause: bool, done: Any) -> None:
        self._ask("simulator", self._pause, SetBool.Request(data=pause), time.monotonic(), done)

    def step_once(self) -> None:
        """One step; a running simulation is paused first."""
        if self.state.simulator in ("paused", "stopped"):
            self._ask("simulator", self._step, Trigger.Request(), time.monotonic(), lambda: None)
        else:
            self._ask_pause(True, self._step_when_paused)

    def _step_when_paused(self) -> None:
        self._on_paused(True)
        self.step_once()

    def reset(self) -> None:
        """Back to the start of the scene."""
        self._call("reset", time.monotonic())

    def reload(self) -> None:
        """Load the scene's files anew."""
        self._ask("simulator", self._reload, Trigger.Request(), time.monotonic(), lambda: None)

    def toggle_sending(self) -> None:
        """Start or stop sending to the board."""
        self._call("send", time.monotonic())

    def e_stop(self) -> None:
        """Hold the servos still, latched."""
        self._ask("servo bridge", self._e_stop, Trigger.Request(), time.monotonic(), lambda: None)

    def clear_e_stop(self) -> None:
        """Give the servos free again."""
        self._ask("servo bridge", self._clear, Trigger.Request(), time.monotonic(), lambda: None)

    def tune(self, tunable: Tunable, value: Any) -> None:
        """Set a parameter of the simulator."""
        self.parameters.set(tunable.name, tunable.si(value))

    def choose_scene(self, name: str) -> None:
        """Run another robot or scene in place of this one."""
        self.say(f"loading {name} ...")
        self.parameters.set("robot", name)

    def colour_by_stress(self, on: bool) -> None:
        """Colour the bodies by von Mises stress."""
        self.stage.surface.by_stress = on
        self.stage.surface.rebuild()

    def set_top_stress(self, kilopascal: float) -> None:
        """Stress of the last colour; 0 follows the largest."""
        self.stage.surface.top_stress = 1e3 * kilopascal

    def show_bodies(self, on: bool) -> None:
        """Show or hide the visible surfaces."""
        self.stage.surface.visible = on
        self.stage.surface.rebuild()

    def show_wireframe(self, on: bool) -> None:
        """Show the visible surfaces as wire frames."""
        self.stage.surface.wireframe = on
        self.stage.surface.rebuild()

    def show_inner(self, name: str, on: bool) -> None:
        """Show or hide something inside; nodes are asked for only while they are needed."""
        inner = self.stage.inner
        inner.switch(name, on)
        if inner.needs_nodes and self._nodes_subscription is None:
            self._nodes_subscription = self.create_subscription(
                PointCloud2, "mesh/nodes", self._on_nodes, _NEWEST_ONLY
            )
        elif not inner.needs_nodes and self._nodes_subscription is not None:
            self.destroy_subscription(self._nodes_subscription)
            self._nodes_subscription = None

    def set_pull_stiffness(self, stiffness: float) -> None:
        """Stiffness in [N/m] of the spring between the body and the mouse."""
        self.pull_stiffness = stiffness

    def reset_view(self) -> None:
        """Move every camera to where it started."""
        reset_cameras(self._server, self.stage.surface.points)

    def _drag_goal(self, goal: EffectorPose) -> None:
        if self.state.inverse:
            self._goal = goal
            self.state = replace(self.state, goal=goal)
            self.carry_out((PublishGoal(goal),), time.monotonic())

    def _send_pull(self, now: float) -> None:
        pull = self.stage.pull
        if pull is None or now - pull.sent_at < REPEAT_PERIOD_S:
            return
        pull.sent_at = now
        force = pull.force(self.stage.surface.points, self.pull_stiffness, PULL_LIMIT_N)
        message = WrenchStamped(header=header(self.get_clock().now().to_msg(), f"mesh_point/{pull.vertex}"))
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force.tolist()
        self._wrenches.publish(message)


def _pose_rows(message: PoseArray) -> Array:
    """Poses as rows: x, y, z in [mm], quaternion x, y, z, w, shape (f, 7)."""
    return np.array(
        [
            (
                MM * p.position.x,
                MM * p.position.y,
                MM * p.position.z,
                p.orientation.x,
                p.orientation.y,
                p.orientation.z,
                p.orientation.w,
            )
            for p in message.poses
        ]
    ).reshape(-1, 7)


def serve(node: Viewer) -> None:
    """Frames until the context shuts down; callbacks are taken once a frame, so old messages cost nothing."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    pause = threading.Event()
    due = time.monotonic()
    try:
        while node.context.ok() and not node.is_orphan:
            ready_callbacks(executor)
            now = time.monotonic()
            node.frame(now)
            due = max(due + FRAME_S, now)
            pause.wait(max(0.0, due - time.monotonic()))
    finally:
        executor.shutdown(timeout_sec=0)


def main(args: Sequence[str] | None = None) -> int:
    """Serve the page until Ctrl-C or SIGTERM. Returns 0, or 1 after an error, told in one sentence."""
    try:
        prepare_environment()
        rclpy.init(args=None if args is None else ["viewer", *args])
    except Exception as error:  # mixed ROS installations; wrong --ros-args (classes of rclpy's extension)
        return complain(str(error).splitlines()[0])
    node: Viewer | None = None
    code = 0
    try:
        robot, settings = requested_settings()
        node = Viewer(load_scene(robot), settings)
        sys.stdout.write(f"viewer: {node.address}\n")
        sys.stdout.flush()
        serve(node)
    except (KeyboardInterrupt, ExternalShutdownException, ShutdownException):
        pass
    except SoftSimError as error:
        code = complain(str(error))
    except Exception:
        if ok():
            raise
        # a signal shut the context down in the middle of a call: an ordinary end
    finally:
        with suppress(KeyboardInterrupt):
            if node is not None:
                node.close()
            try_shutdown()
    return code


if __name__ == "__main__":
    sys.exit(main())
