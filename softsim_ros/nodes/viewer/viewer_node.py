"""The node `viewer`: shows the robot's topics in a web page and sends the page's inputs over ROS."""

from __future__ import annotations

import secrets
import sys
import threading
import time
from functools import partial
from typing import Any, Final

from rclpy.executors import SingleThreadedExecutor

from softsim_core.base import Array, SoftSimError, shorten
from softsim_core.scene import RobotDescription, SceneCatalog
from softsim_core.scene.io import without_contents
from softsim_node import GuardedNode, Program, declare, ending, ready_callbacks, run_node
from softsim_ros.client import Editing, RobotClient, RobotLog, Warnings
from softsim_ros.keys import Keyboard, KeySettings
from softsim_ros.nodes.viewer.edit_mode import EditMode
from softsim_ros.nodes.viewer.guard import AccessRule, GuardedServer, ViewerError, is_loopback
from softsim_ros.nodes.viewer.panel import Inbox, LastMessage
from softsim_ros.nodes.viewer.parameters import ViewerSettings, requested_settings
from softsim_ros.nodes.viewer.picture import Picture
from softsim_ros.nodes.viewer.profiler import StepStatistics
from softsim_ros.nodes.viewer.stage import CAMERA_FOV, MousePull
from softsim_ros.nodes.viewer.surface import MM
from softsim_ros.nodes.viewer.tabs import Controls, Hint, PageParts, have_same_controls

FRAME_S: Final = 1.0 / 30.0
REFRESH_PERIOD_S: Final = 0.1
PLOT_PERIOD_S: Final = 0.2
PANEL_WIDTH: Final = 440
"""Width of the panel in pixels; all tabs fit into one row."""
VIEW_DEPTH_MM: Final = (1.0, 100_000.0)
"""Near and far plane of cameras in [mm]; viser's default far plane would be at 1 m."""


class Viewer(GuardedNode):
    """Serves the page of one robot; see `frame` for its loop.

    Args:
        robot: Scene to show until the simulator publishes its own.
        settings: Address and appearance.
        token: Secret that browsers send; empty: a new one is generated.
        **node_options: Passed on to rclpy's Node; without a namespace there, the robot's name is used.

    Attributes:
        parts: Client, keyboard, picture and the other objects behind the page.

    Raises:
        ViewerError: the page cannot be served.
    """

    controls: Controls

    def __init__(
        self, robot: RobotDescription, settings: ViewerSettings, token: str = "", **node_options: Any
    ) -> None:
        super().__init__("viewer", **{"namespace": robot.name, **node_options})
        self._settings = settings = declare(self, settings)
        secret = None if settings.no_token else token or secrets.token_urlsafe(18)
        self._server = GuardedServer(AccessRule(settings.host, settings.port, secret), robot.name)
        self._server.scene.set_up_direction("+z")  # called once, since it resets the cameras
        self._server.initial_camera.near, self._server.initial_camera.far = VIEW_DEPTH_MM
        self._server.initial_camera.fov = CAMERA_FOV
        self._inbox = Inbox()
        self.parts = self._make_parts(robot, settings)
        self._warnings = Warnings(self, self.parts.page_message.say)
        self._next_refresh = self._next_plot = 0.0
        self._controlled: RobotDescription | None = None
        self._build_page()
        self._server.on_client_connect(self._on_client)
        self._server.on_client_disconnect(self._on_client_gone)

    async def _on_client(self, client: Any) -> None:
        self._inbox.put(lambda: self.parts.picture.welcome(client))

    async def _on_client_gone(self, client: Any) -> None:
        self._inbox.put(lambda: self.parts.picture.leave(client))

    def _make_parts(self, robot: RobotDescription, settings: ViewerSettings) -> PageParts:
        page_message = LastMessage()
        client = RobotClient(self, robot, page_message.say)
        simulator = client.simulator

        def move_base(joint: str, position_mm: Array) -> None:
            simulator.move_base(joint, (position_mm / MM).tolist())

        picture = Picture(
            self,
            self._server,
            self._inbox,
            self._on_scene,
            client.inverse.give_goal,
            move_base,
            lite=settings.lite,
        )
        return PageParts(
            client=client,
            keyboard=Keyboard(self, client, page_message.say),
            page_message=page_message,
            picture=picture,
            mouse=MousePull(simulator),
            statistics=StepStatistics(self),
            log=RobotLog(self),
            edit=EditMode(
                self._server, self._inbox, picture, Editing(self, page_message.say), page_message.say
            ),
            hint=Hint(),
            is_local=is_loopback(settings.host),
        )

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return self._server.rule.address

    def close(self) -> None:
        """Close the page and destroy the node; a second call does nothing."""
        self._server.stop()
        super().close()

    # --- a scene --------------------------------------------------------------------------------------

    def _build_page(self) -> None:
        """Rebuild picture and panel for the robot; the cameras and controls that still fit stay."""
        robot, picture, gui = self.parts.client.robot, self.parts.picture, self._server.gui
        with self._server.atomic():
            self._server.scene.reset()
            picture.build(robot)
            self.parts.edit.build()
            if self._controlled is not None and have_same_controls(self._controlled, robot):
                self.controls.show_scene(robot)
            else:
                self._inbox.turn_page()
                gui.reset()
                picture.set_dark(picture.is_dark)
                gui.main_panel.dock_right()
                gui.main_panel.set_width(PANEL_WIDTH)
                self.controls = Controls(gui, self._inbox, self.parts, self.get_namespace())
            self._controlled = robot
        picture.show_arrived_meshes()

    def _on_scene(self, robot: RobotDescription) -> None:
        """Rebuild the page for another scene that the simulator has published."""
        self.parts.client.begin(robot)
        self._build_page()

    # --- the loop -------------------------------------------------------------------------------------

    def frame(self, now: float) -> None:
        """Run the actions of browsers, then show new messages; `now` in [s].

        Called about 30 times per second.
        """
        picture = self.parts.picture
        picture.stage.now = now
        for action in self._inbox.take():
            with self.refusing("action on the page"):
                action()
        with self._server.atomic(), self.refusing("picture"):
            picture.draw(now)
        if now >= self._next_refresh:
            self._next_refresh = now + REFRESH_PERIOD_S
            with self._server.atomic(), self.refusing("state"):
                self._show_state(now)
        if now >= self._next_plot:
            self._next_plot = now + PLOT_PERIOD_S
            with self.refusing("plot"):
                self.controls.sample(now)
        with self.refusing("pull"):
            self.parts.mouse.send(picture.stage.pull, picture.stage.surface.points, now)

    def _show_state(self, now: float) -> None:
        picture, state = self.parts.picture, self.parts.client.state
        picture.stage.show_goal((state.heard_goal or state.effector) if state.inverse else None, now)
        if state.effector is not None:
            picture.stage.trail.add(state.effector.position)
        picture.show_error(state.scene_error)
        self.parts.edit.refresh()
        self.controls.refresh()


def serve(node: Viewer) -> None:
    """Run frames until the process is to end.

    Callbacks run once per frame, so outdated messages cost nothing.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    pause = threading.Event()
    due = time.monotonic()
    try:
        while node.context.ok() and not ending.asked:
            ready_callbacks(executor, lambda: node.parts.picture.has_news)
            now = time.monotonic()
            node.frame(now)
            due = max(due + FRAME_S, now)
            pause.wait(max(0.0, due - time.monotonic()))
    finally:
        executor.shutdown(timeout_sec=0)


def robot_by_name(name: str) -> RobotDescription:
    """Return what to show until the simulator publishes its scene.

    This is the robot of a known YAML file, or else an empty scene of that name.

    Raises:
        ViewerError: the name cannot be a robot's.
    """
    scenes = SceneCatalog()
    file = scenes.scenes().get(name)
    if file is not None and file.suffix != ".py":
        return scenes.load(name)
    try:
        return without_contents(name)
    except SoftSimError as error:
        raise ViewerError(
            f"viewer: robot {shorten(name)!r} is no robot's name; give the name of the robot that runs, "
            "which is its namespace, such as tripod (the viewer reads no files)"
        ) from error


def announced_viewer() -> Viewer:
    """Return the viewer that the parameters of this process ask for; print its address."""
    robot, settings, token = requested_settings()
    node = Viewer(robot_by_name(robot), settings, token)
    sys.stdout.write(f"viewer: {node.address}\n")
    sys.stdout.flush()
    return node


PROGRAM = Program(
    name="viewer",
    about="Shows a robot in a web page, and drives it from there.",
    settings=(KeySettings(), ViewerSettings()),
)

main = partial(run_node, PROGRAM, lambda _: announced_viewer(), serve=serve)
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
