"""ROS node `viewer`: the robot's topics in a web page, and the page's controls as topics and services."""

from __future__ import annotations

import math
import secrets
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from softsim_core.errors import SoftSimError
from softsim_core.scene import known_scenes, load_yaml
from softsim_core.scene.catalog import shortened
from softsim_core.scene.portable import without_contents
from softsim_core.scene.robot import RobotDescription
from softsim_node.ending import ending
from softsim_node.help import Program
from softsim_node.parameters import declare
from softsim_node.process import run_node
from softsim_ros.teleop.loop import ready_callbacks
from softsim_ros.teleop.parameters import TeleopSettings
from softsim_ros.viewer.controls import Controls, have_same_controls
from softsim_ros.viewer.diagnostics_link import DiagnosticsLink
from softsim_ros.viewer.guard import AccessRule, GuardedServer, ViewerError, is_loopback
from softsim_ros.viewer.page_node import PageNode
from softsim_ros.viewer.panel import Inbox
from softsim_ros.viewer.picture import Picture
from softsim_ros.viewer.requested import ViewerSettings, requested_settings

FRAME_S: Final = 1.0 / 30.0
TICK_PERIOD_S: Final = 0.1
PLOT_PERIOD_S: Final = 0.2


class Viewer(PageNode):
    """A teleop whose keys and display are a web page; see `frame` for its loop.

    Topics in besides the commander's: those of Picture and DiagnosticsLink.

    Args:
        robot: What is shown until the simulator tells its own scene.
        settings: Address and looks.
        **node_options: Passed on to rclpy's Node.

    Raises:
        ViewerError: the page cannot be served.
    """

    controls: Controls

    def __init__(self, robot: RobotDescription, settings: ViewerSettings, **node_options: Any) -> None:
        super().__init__(robot, "viewer", lambda values: self.controls.tune.show(values), **node_options)
        self._settings = settings = declare(self, settings)
        token = None if settings.no_token else settings.token or secrets.token_urlsafe(18)
        self._server = GuardedServer(AccessRule(settings.host, settings.port, token), robot.name)
        self._server.scene.set_up_direction("+z")  # once: it puts the cameras back to where they began
        self._inbox = Inbox()
        self.scene_name, self.efforts = robot.name, ()
        self.is_local = is_loopback(settings.host)
        self.diagnostics = DiagnosticsLink(self)
        self.picture = Picture(
            self,
            self._server,
            self._inbox,
            self._on_scene,
            self.drag_goal,
            self.move_base,
            lite=settings.lite,
        )
        self._started_at = time.monotonic()
        self._next_tick = self._next_plot = 0.0
        self._controlled: RobotDescription | None = None
        self._build_page()

    @property
    def address(self) -> str:
        """What a person opens in a browser."""
        return self._server.rule.address

    def close(self) -> None:
        """Close the page and end the node; a second call does nothing."""
        self._server.stop()
        super().close()

    # --- a scene --------------------------------------------------------------------------------------

    def _build_page(self) -> None:
        """Scene and panel for `self.robot`; the cameras stay where they are, and so do controls that fit."""
        with self._server.atomic():
            self._server.scene.reset()
            self.picture.build(self.robot)
            if self._controlled is not None and have_same_controls(self._controlled, self.robot):
                self.controls.scene.show(self.robot)
            else:
                self._inbox.turn_page()
                self._server.gui.reset()
                self._server.gui.configure_theme(show_logo=False, show_share_button=False)
                self.controls = Controls(self._server.gui, self._inbox, self, self.robot)
            self._controlled = self.robot
        self.parameters.names = self.controls.tune.names
        self.picture.show_known()

    def _on_scene(self, robot: RobotDescription) -> None:
        """Another scene, as the simulator tells it: the page is made anew."""
        self.robot = robot
        self.scene_name = self.robot.name
        self._joint_order = ((), None)
        self.efforts = ()
        self.state = replace(self.state, measured=None, commanded=None, measured_at=-math.inf)
        self._build_page()

    def _on_joint_states(self, message: JointState) -> None:
        super()._on_joint_states(message)
        order = self._joint_order[1]
        if order is not None and len(message.effort) == len(message.name):
            self.efforts = [message.effort[index] for index in order]

    # --- the loop -------------------------------------------------------------------------------------

    def frame(self, now: float) -> None:
        """Serve what browsers did, then show what arrived; about 30 times per second, `now` in [s]."""
        stage = self.picture.stage
        stage.now = now
        for action in self._inbox.take():
            with self.refusing("action on the page"):
                action()
        with self._server.atomic(), self.refusing("picture"):
            self.picture.draw(now)
        if now >= self._next_tick:
            self._next_tick = now + TICK_PERIOD_S
            with self._server.atomic(), self.refusing("state"):
                self._show_state(now)
        if now >= self._next_plot:
            self._next_plot = now + PLOT_PERIOD_S
            with self.refusing("plot"):
                self.controls.plots.add(now - self._started_at)
        with self.refusing("pull"):
            self.send_pull(stage.pull, stage.surface.points, now)

    def _show_state(self, now: float) -> None:
        self.tick(now)
        goal = (self.goal or self.state.effector) if self.state.inverse else None
        self.picture.stage.show_goal(goal, now)
        self.picture.show_error(self.diagnostics.scene_error)
        self.controls.refresh()


def serve(node: Viewer) -> None:
    """Frames until the process shall end; callbacks are taken once a frame, so old messages cost nothing."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    pause = threading.Event()
    due = time.monotonic()
    try:
        while node.context.ok() and not ending.asked:
            ready_callbacks(executor)
            now = time.monotonic()
            node.frame(now)
            due = max(due + FRAME_S, now)
            pause.wait(max(0.0, due - time.monotonic()))
    finally:
        executor.shutdown(timeout_sec=0)


def robot_by_name(name: str) -> RobotDescription:
    """What is shown until the simulator tells: the robot of a known YAML file, else nothing but its name.

    Raises:
        ViewerError: the name cannot be a robot's.
    """
    file = known_scenes().get(name)
    if file is not None and file.suffix != ".py":
        return load_yaml(file)
    try:
        return without_contents(name)
    except SoftSimError as error:
        raise ViewerError(
            f"viewer: robot {shortened(name)!r} is no robot's name; give the name of the robot that runs, "
            "which is its namespace, such as tripod (the viewer reads no files)"
        ) from error


def announced_viewer() -> Viewer:
    """The viewer that this process's parameters ask for; its address goes to standard output."""
    robot, settings = requested_settings()
    node = Viewer(robot_by_name(robot), settings)
    sys.stdout.write(f"viewer: {node.address}\n")
    sys.stdout.flush()
    return node


PROGRAM = Program(
    name="viewer",
    about="Shows a robot in a web page, and drives it from there.",
    settings=(TeleopSettings(), ViewerSettings()),
)


def main(args: Sequence[str] | None = None) -> int:
    """Serve the page until Ctrl-C or SIGTERM; returns the exit code."""
    return run_node(PROGRAM, lambda _: announced_viewer(), args, serve)


if __name__ == "__main__":
    sys.exit(main())
