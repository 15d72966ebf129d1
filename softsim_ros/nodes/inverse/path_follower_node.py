"""The node `path_follower`: plays a path from a file or a topic as goals of the inverse controller."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal, TypeAlias

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import SetBool, Trigger

from softsim_core import RobotDescription
from softsim_core.base import MOST_NAMES, Array, CommandError, SoftSimError, names_up_to, shorten
from softsim_core.control.inverse import (
    EffectorPath,
    PathRefusedError,
    find_path,
    is_known_path,
    known_path,
    known_paths,
    read_path,
)
from softsim_core.physics.mechanics import Pose
from softsim_node import (
    MEASURED,
    WORLD,
    LiveParameters,
    Program,
    RobotFrames,
    StateTopics,
    answering,
    parameter,
    run_node,
    steady_timer,
)
from softsim_ros import FrameSettings, RobotNode, RobotSettings
from softsim_ros.messages import OK, WARN, pose_stamped
from softsim_ros.nodes.inverse.inverse_switch import InverseSwitch
from softsim_ros.nodes.inverse.parameters import TASKS
from softsim_ros.nodes.inverse.plant import FARTHEST_M, check_frame, effector_rest

STARTS: Final = ("rest", "measured")
AUTO: Final = "auto"
LEAVE: Final = "leave"


@dataclass(frozen=True, kw_only=True)
class FollowerSettings(RobotSettings):
    """Values of the parameters."""

    file: str = parameter(
        "",
        "Path: a maze plan (.json) or timed poses (.csv); a name in configs/paths, at the start also a file",
    )
    start_from: str = parameter(
        STARTS[0],
        "Where a maze plan begins: at the effector's place on the robot at rest, or where it is measured",
        choices=STARTS,
        fixed=True,
    )
    task: str = parameter(
        AUTO,
        "What of a goal the inverse controller follows from the start of a path on; auto: height_tilt for "
        "a maze plan, else what the robot's file says",
        choices=(AUTO, LEAVE, *TASKS),
        fixed=True,
    )
    loop: bool = parameter(False, "Begin again at the end")
    speed: float = parameter(1.0, "Seconds of the path per second", within=(0.0, 100.0))
    autostart: bool = parameter(False, "Start as soon as the node runs, or a path arrives")
    enable_inverse: bool = parameter(True, "Switch the inverse controller on at the start of a path")
    start_with_inverse: bool = parameter(False, "Start when the inverse controller is switched on (key I)")


MOST_POSES = 100_000
"""Largest number of poses of a path."""


def effector_path(message: PathMessage, frames: RobotFrames) -> EffectorPath:
    """Return the path of a message; the stamps of its poses, counted from the first one, are the times.

    Args:
        message: Poses in `world` (or the robot's base, which is the same); a pose's own frame may be empty.
        frames: Names of the robot's frames.

    Raises:
        CommandError: unknown frame, no poses, stamps that do not increase, or a number that is not finite.
    """
    if len(message.poses) > MOST_POSES:
        raise PathRefusedError(f"it has {len(message.poses)} poses; send at most {MOST_POSES}")
    check_frame("path", message.header.frame_id, frames)
    for pose in message.poses:
        if pose.header.frame_id:
            check_frame("path", pose.header.frame_id, frames)
    if not message.poses:
        raise PathRefusedError("it has no poses")
    stamps = [(pose.header.stamp.sec, pose.header.stamp.nanosec) for pose in message.poses]
    first = stamps[0]
    times = [float(sec - first[0]) + 1e-9 * (nanosec - first[1]) for sec, nanosec in stamps]
    places = [pose.pose.position for pose in message.poses]
    if not all(abs(each) <= FARTHEST_M for place in places for each in (place.x, place.y, place.z)):
        raise PathRefusedError(f"a position is not finite or further than {FARTHEST_M:g} m away")
    turns = [pose.pose.orientation for pose in message.poses]
    return EffectorPath(
        times,
        np.array([(place.x, place.y, place.z) for place in places]),
        np.array([(turn.x, turn.y, turn.z, turn.w) for turn in turns]),
    )


PlayerState: TypeAlias = Literal["idle", "running", "paused", "ended"]


class PathPlayer:
    """Plays one path at a time.

    Attributes:
        state: idle (not started, or stopped), running, paused, or ended (the last pose was returned).
        path: The path that was started last; None before the first.
        time: Path time in [s].
        rounds: How often a looped path has restarted.
    """

    def __init__(self) -> None:
        self.state: PlayerState = "idle"
        self.path: EffectorPath | None = None
        self.time = 0.0
        self.rounds = 0

    @property
    def percent(self) -> float:
        """Completed part of the path, 0..100."""
        if self.path is None or self.path.duration == 0.0:
            return 100.0 if self.state == "ended" else 0.0
        return 100.0 * min(self.time / self.path.duration, 1.0)

    def start(self, path: EffectorPath) -> None:
        """Play a path from its beginning, in place of a previous one."""
        self.path, self.time, self.rounds, self.state = path, 0.0, 0, "running"

    def stop(self) -> None:
        """Stop; no further poses are returned."""
        self.state = "idle"

    def pause(self, paused: bool) -> None:
        """Pause the path, or continue it.

        Raises:
            CommandError: nothing is being played.
        """
        if self.state not in ("running", "paused"):
            raise CommandError(f"no path is running (it is {self.state}); call start first")
        self.state = "paused" if paused else "running"

    def advance(self, elapsed: float, *, loop: bool = False) -> Pose | None:
        """Advance path time by `elapsed` seconds and return the pose; None if no path is running.

        The last pose of a path that is not looped is returned once; then the path has ended.
        """
        if self.state != "running" or self.path is None:
            return None
        self.time += elapsed
        duration = self.path.duration
        if self.path.is_over(self.time):
            if loop and duration > 0.0:
                self.rounds += int(self.time // duration)
                self.time %= duration
            else:
                self.time, self.state = duration, "ended"
        return self.path.sample(self.time)


NODE_NAME: Final = "path_follower"
GOAL_PERIOD_S: Final = 0.02
"""Period of goals in [s] while a path runs."""

PROGRESS_PERIOD_S: Final = 0.1
DISCOVERY_S: Final = 5.0
"""Longest time in [s] that a start waits for other nodes.

This includes the inverse controller's first joint states.
"""

RETRY_PERIOD_S: Final = 0.25


class PathFollower(RobotNode):
    """Sends timed goals to the inverse controller of its namespace; created as RobotNode describes.

    Raises:
        SoftSimError: robot or file are not known, or a parameter is not allowed.
    """

    node_name = NODE_NAME

    def _begin(self, robot: RobotDescription) -> None:
        self._rest = effector_rest(robot)
        defaults = FollowerSettings(robot=self.robot_parameter)
        self._live = LiveParameters(self, defaults, check=self._check_path, apply=self._take_path)
        self._own_task = robot.inverse.task
        self._file = self._start_file = self._live.values.file
        self._player = PathPlayer()
        self._received: EffectorPath | None = None
        self._measured: Array | None = None
        self._enabled = True
        self._problem = ""
        # An automatic start is due once the other nodes are found, at the latest at this time.
        self._start_by: float | None = None
        # State of the path when the inverse controller fell silent; None while it is alive.
        self._before_silence: PlayerState | None = None
        # A path whose inverse controller refused to switch on: time of the next attempt and of the last one.
        self._refused: tuple[EffectorPath, float, float] | None = None
        simulated = bool(self.get_parameter("use_sim_time").value)
        self._path_clock = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._ticked_at = self._now()
        self._inverse = InverseSwitch(self, self._on_inverse, self._warn)
        self._goals = self.create_publisher(PoseStamped, "effector_goal", 1)
        self._progress = self.create_publisher(Float64, "~/progress", 1)
        self.create_subscription(PathMessage, "path", self._on_path, 1)
        self.create_subscription(PoseStamped, "effector_pose", self._on_effector, MEASURED)
        self._state_topics = StateTopics(
            self,
            {
                "path_follower/enabled": lambda: Bool(data=self._enabled),
                "path_follower/playing": lambda: Bool(data=self._player.state == "running"),
                "path_follower/paused": lambda: Bool(data=self._player.state == "paused"),
                "path_follower/file": lambda: String(data=self._file if self._received is None else ""),
            },
        )
        self.create_service(Trigger, "~/start", answering(self.start))
        self.create_service(SetBool, "~/pause", answering(self.pause))
        self.create_service(SetBool, "~/enable", answering(self.enable))
        self.create_timer(GOAL_PERIOD_S, self._tick, clock=self._path_clock)
        steady_timer(self, PROGRESS_PERIOD_S, self._publish_progress)
        steady_timer(self, 1.0, self._publish_diagnostics)
        if self._file:
            path = read_path(self._file, self._rest)
            self.get_logger().info(f"path {self._file}: {path.duration:g} s; call {NODE_NAME}/start")
        else:
            self.get_logger().info("no file is named: waiting for a message on the topic path")
        if self._live.values.autostart and self._file:
            self._start_by = time.monotonic() + DISCOVERY_S

    # --- services -------------------------------------------------------------------------------------

    def start(self) -> str:
        """Play the path from its beginning; return a message.

        Raises:
            SoftSimError: disabled, no path, or an invalid one.
        """
        self._check_enabled()
        self._path()
        if not self._can_start() and self._start_by is None:
            self._start_by = time.monotonic() + DISCOVERY_S
            return f"the path starts as soon as {self._inverse.service} is found"
        return self._play()

    def _play(self) -> str:
        self._start_by = self._refused = None
        self._check_enabled()
        path = self._path()
        self._problem = ""
        if not self._inverse.is_there and not self._inverse.is_on:
            self._begin_path(path)
            if self._live.values.enable_inverse:
                self._warn(f"no node serves {self._inverse.service}: the goals are sent all the same")
            return _describe_start(path)
        if task := self._task():
            self._inverse.follow(task)
        if self._inverse.is_on or not self._live.values.enable_inverse:
            self._begin_path(path)
        else:
            self._switch_on(path, time.monotonic() + DISCOVERY_S)
        return _describe_start(path)

    def _switch_on(self, path: EffectorPath, give_up_at: float) -> None:
        """Switch the inverse controller on, then start; retry until `give_up_at` in [s]."""

        def on_answer(reason: str) -> None:
            if not self._enabled:
                return
            if not reason:
                self._problem = ""
                self._begin_path(path)
                return
            trouble = f"the inverse controller cannot be switched on: {reason}"
            now = time.monotonic()
            if now < give_up_at:
                self._problem = f"waiting: {trouble}"
                self._refused = (path, now + RETRY_PERIOD_S, give_up_at)
            else:
                self._warn(f"not started: {trouble}")

        self._inverse.enable(on_answer)

    def _task(self) -> str:
        """Return the task to set on the inverse controller; an empty string leaves it unchanged."""
        task = self._live.values.task
        if task != AUTO:
            return "" if task == LEAVE else task
        is_plan = self._received is None and self._find_file(self._file).suffix == ".json"
        return "height_tilt" if is_plan else self._own_task

    def _begin_path(self, path: EffectorPath) -> None:
        self._player.start(path)
        self._before_silence = None
        self._ticked_at = self._now()
        self._state_topics.refresh()

    def _check_enabled(self) -> None:
        if not self._enabled:
            raise CommandError(f"the path follower is off; call {NODE_NAME}/enable with true first")

    def pause(self, paused: bool) -> str:
        """Pause the path, or continue it; return a message.

        Raises:
            CommandError: no path runs.
        """
        self._player.pause(paused)
        if self._before_silence is not None:  # a request during the silence applies after it
            self._before_silence = "paused" if paused else "running"
        self._ticked_at = self._now()
        self._state_topics.refresh()
        return f"{'paused' if paused else 'running'} at {self._player.time:.2f} s"

    def enable(self, enabled: bool) -> str:
        """Allow paths to run, or stop the running one and refuse others; return a message."""
        self._enabled = enabled
        if not enabled:
            self._start_by = self._refused = None
            self._player.stop()
        self._state_topics.refresh()
        return "ready" if enabled else "off: no goals are given"

    def _path(self) -> EffectorPath:
        if self._received is not None:
            return self._received
        if not self._file:
            raise CommandError("there is no path; set the parameter file, or send one on the topic path")
        start = self._rest
        if self._live.values.start_from == "measured" and self._find_file(self._file).suffix == ".json":
            if self._measured is None:
                raise CommandError(
                    "no effector_pose has arrived yet; start the simulator, or set start_from to rest"
                )
            start = self._measured
        return read_path(self._find_file(self._file), start)

    def _on_inverse(self, is_on: bool) -> None:
        """Handle that the inverse controller went on or off, or is silent."""
        before, self._before_silence = self._before_silence, None
        if is_on and before is not None:
            self._problem = ""
            if before == "running" and self._player.state == "paused":
                self.pause(False)
        elif not is_on and self._inverse.is_silent and self._player.state in ("running", "paused"):
            before = self._player.state
            self.pause(True)
            self._before_silence = before
            self._warn("waiting: the inverse controller is silent")
        elif is_on and self._player.state != "running" and self._live.values.start_with_inverse:
            self._attempt_start()
        elif not is_on and self._player.state in ("running", "paused"):
            self._player.stop()
            self._warn("stopped: the inverse controller was switched off, or has ended")

    # --- messages -------------------------------------------------------------------------------------

    def _on_path(self, message: PathMessage) -> None:
        try:
            self._received = effector_path(message, self.frames)
            self.get_logger().info(
                f"path received: {len(message.poses)} poses, {self._received.duration:g} s"
            )
            if self._player.state == "running" or self._live.values.autostart:
                self.start()
        except SoftSimError as error:
            self._warn(str(error))

    def _on_effector(self, message: PoseStamped) -> None:
        place = message.pose.position
        self._measured = np.array([place.x, place.y, place.z])

    def _can_start(self) -> bool:
        """Return whether the nodes on which a start depends have been found."""
        needs_place = self._live.values.start_from == "measured" and self._measured is None
        switches = self._live.values.enable_inverse and not self._inverse.is_on
        return not needs_place and (self._inverse.is_there or not switches)

    def _attempt_start(self) -> None:
        try:
            self.get_logger().info(self._play())
        except SoftSimError as error:
            self._warn(str(error))

    def _find_file(self, name: str) -> Path:
        """Return the file of a path that may be requested at run time.

        This is a known path, or the file that the start command named.

        Raises:
            CommandError: it is another file.
        """
        if name == self._start_file:
            return find_path(name)
        if is_known_path(name):
            return known_path(name)
        raise CommandError(
            f"file {shorten(name)!r} is refused: at run time it is a name in configs/paths, or that of "
            f"the start command; known paths: {names_up_to(MOST_NAMES, known_paths())}"
        )

    def _check_path(self, names: frozenset[str], settings: FollowerSettings) -> None:
        if "file" in names and settings.file:
            read_path(self._find_file(settings.file), self._rest)

    def _take_path(self, names: frozenset[str], settings: FollowerSettings) -> None:
        if "file" in names:
            self._file, self._received = settings.file, None

    # --- time -----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        now = self._now()
        elapsed, self._ticked_at = max(now - self._ticked_at, 0.0), now
        self._inverse.expire()
        if self._start_by is not None and (self._can_start() or time.monotonic() > self._start_by):
            self._attempt_start()
        if self._refused is not None and time.monotonic() > self._refused[1]:
            (path, _, give_up_at), self._refused = self._refused, None
            self._switch_on(path, give_up_at)
        speed, loop = self._live.values.speed, self._live.values.loop
        pose = self._player.advance(speed * elapsed, loop=loop)
        if pose is None:
            return
        stamp = self.get_clock().now().to_msg()
        self._goals.publish(pose_stamped(stamp, WORLD, pose.position, pose.quaternion_xyzw))
        if self._player.state == "ended":
            self._publish_progress(last=True)
            self.get_logger().info("the path has ended; its last goal is held")

    def _publish_progress(self, last: bool = False) -> None:
        if last or self._player.state == "running":
            self._progress.publish(Float64(data=self._player.percent))

    def _publish_diagnostics(self) -> None:
        if self._before_silence is not None and not self._inverse.is_silent:
            self._on_inverse(is_on=False)  # it has ended while it was silent
        player = self._player
        values: dict[str, object] = {
            "state": player.state if self._enabled else "off",
            "path": "topic" if self._received is not None else self._file or "none",
            "time_s": player.time,
            "duration_s": player.path.duration if player.path is not None else 0.0,
            "percent": player.percent,
            "rounds": player.rounds,
            "inverse": "on" if self._inverse.is_on else "off or unknown",
        }
        level, message = (WARN, self._problem) if self._problem else (OK, str(values["state"]))
        self._publish_health(level, message, values)

    def _now(self) -> float:
        return float(self._path_clock.now().nanoseconds) * 1e-9

    def _warn(self, message: str) -> None:
        self._problem = message
        self.get_logger().warning(message)


def _describe_start(path: EffectorPath) -> str:
    return f"path started: {path.duration:g} s"


PROGRAM = Program(
    name="path_follower",
    about="Plays a path as goals of the inverse controller.",
    settings=(FollowerSettings(), FrameSettings()),
)

main = partial(run_node, PROGRAM, lambda _: PathFollower())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
