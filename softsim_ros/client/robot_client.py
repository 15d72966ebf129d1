"""`RobotClient`: one robot's topics and services without any user interface; a session for scripts."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

from rclpy.context import Context
from rclpy.node import Node

from softsim_core.base import SoftSimError, listing
from softsim_core.scene import RobotDescription, load_scene
from softsim_node import GuardedNode, error_message, prepare_environment, steady_timer
from softsim_ros import SpinThread
from softsim_ros.client.bridge import Bridge
from softsim_ros.client.control import ClosedLoop, Inverse
from softsim_ros.client.discovery import running_robot, running_robots
from softsim_ros.client.joints import Joints
from softsim_ros.client.services import Outcome
from softsim_ros.client.simulator import Simulator
from softsim_ros.client.state import Reports, RobotSnapshot, RobotState, Watcher

POLL_PERIOD_S: Final = 0.1


class RobotClient:
    """Client of the robot in a node's namespace; none of its methods waits or blocks.

    Every action takes a last argument `done`, which is called once with its `Outcome`. Outcomes and important
    changes are also reported to `say`. Methods must be called from the thread that spins the node; `done`,
    `say` and watchers are called from it (`connect` takes care of that for scripts).

    Args:
        node: The node whose executor delivers messages and responses; the client does not own it.

    Attributes:
        node: That node, for the user's own topics.
        joints: Commands and trajectories within the limits.
        simulator: Start, pause, steps, reset, scenes, parameters, pulls.
        bridge: Sending to the servo board, e-stop.
        inverse: Inverse control and its goal.
        closed_loop: The closed loop's reference.
    """

    def __init__(
        self, node: Node, robot: RobotDescription, say: Callable[[str], None] = lambda _: None
    ) -> None:
        self.node = node
        self._snapshot = snapshot = RobotSnapshot(robot, say)
        self.inverse = Inverse(node, snapshot)
        self.closed_loop = ClosedLoop(node, snapshot)
        self.joints = Joints(node, snapshot, lambda: self.simulator.is_there)
        self.simulator = Simulator(node, snapshot, self.joints, self.inverse)
        self.bridge = Bridge(node, snapshot)
        self._reports = Reports(node, snapshot, self.inverse.take_report)
        steady_timer(node, POLL_PERIOD_S, self._poll)

    @property
    def state(self) -> RobotState:
        """Present state of the robot; immutable, replaced at every change."""
        return self._snapshot.state

    @property
    def robot(self) -> RobotDescription:
        """Joints, limits and poses."""
        return self._snapshot.robot

    def watch(self, watcher: Watcher) -> None:
        """Call `watcher` with the state after every change, from the thread that spins the node."""
        self._snapshot.watchers.append(watcher)

    def begin(self, robot: RobotDescription) -> None:
        """Follow another robot or scene in the same namespace."""
        self._snapshot.robot = robot
        self.joints.forget()

    def _poll(self) -> None:
        """Expire unanswered calls, check for nodes without output, repeat the command where needed."""
        now = time.monotonic()
        for part in (self.joints, self.simulator, self.bridge, self.inverse):
            part.poll(now)


CONNECT_WITHIN_S: Final = 15.0
SIMULATOR_WITHIN_S: Final = 4.0
"""Time in [s] to find a complete simulator; after it the robot is taken to have none."""

LOOK_PERIOD_S: Final = 0.1
DONE_WITHIN_S: Final = 90.0
"""Longest duration of an action in [s]; the client itself gives up unanswered calls earlier."""

START_ONE: Final = "start one with `softsim up tripod` in another terminal"


class ClientError(SoftSimError):
    """The robot is not there, an action was refused, or something took too long."""


class RobotSession:
    """A RobotClient for a script; use it from any thread except the one that spins the node.

    Attributes:
        client: The client; run its actions with `do`.
    """

    def __init__(self, client: RobotClient, spinner: SpinThread) -> None:
        self.client, self._spinner = client, spinner
        self._changed = threading.Condition()
        client.watch(self._on_change)

    @property
    def state(self) -> RobotState:
        """Present state of the robot."""
        return self.client.state

    @property
    def is_running(self) -> bool:
        """Whether ROS still runs in this process, so no signal has ended it."""
        return bool(self._spinner.executor.context.ok())

    def do(self, action: Callable[..., None], *arguments: Any) -> str:
        """Run an action and wait for its outcome: `robot.do(robot.client.joints.go_to, "mid")`.

        Args:
            action: A method of a part of the client that takes `done` last.
            *arguments: Its other arguments.

        Returns:
            The message of its outcome.

        Raises:
            ClientError: it was refused, or has no outcome within DONE_WITHIN_S.
        """
        ends: list[Outcome] = []

        def store_outcome(end: Outcome) -> None:
            with self._changed:
                ends.append(end)
                self._changed.notify_all()

        def act() -> None:
            try:
                action(*arguments, store_outcome)
            except Exception as error:  # invalid arguments, such as a text for a position
                store_outcome(Outcome(False, f"{action.__qualname__} {error_message(error)}"))

        self._spinner.executor.create_task(act)
        with self._changed:
            self._changed.wait_for(lambda: ends, DONE_WITHIN_S)
        if not ends:
            raise ClientError(f"{action.__qualname__} has not ended within {DONE_WITHIN_S:g} s")
        if not ends[0].success:
            raise ClientError(ends[0].message)
        return ends[0].message

    def wait_until(
        self, condition: Callable[[RobotState], object], within_s: float = 10.0, what: str = "the condition"
    ) -> RobotState:
        """Wait until the state fulfils a condition; return that state.

        Args:
            condition: Checked after each change, and every LOOK_PERIOD_S.
            within_s: Longest wait in [s].
            what: Name of the condition, for the error.

        Raises:
            ClientError: it was not fulfilled in time.
        """
        end = time.monotonic() + within_s
        with self._changed:
            while not condition(self.state):
                left = end - time.monotonic()
                if left <= 0.0:
                    break
                self._changed.wait(min(left, LOOK_PERIOD_S))
            else:
                return self.state
        state = self.state
        joints = "none received"
        if state.measured is not None:
            joints = ", ".join(f"{each:.4f}" for each in state.measured)
        raise ClientError(
            f"{what} did not hold within {within_s:g} s; simulator {state.simulator or 'not received'}, "
            f"bridge {state.bridge}, joints {joints}"
        )

    def wait_until_there(self, within_s: float = 10.0) -> RobotState:
        """Wait until the joints have reached the newest command.

        Raises:
            ClientError: they do not in time.
        """
        return self.wait_until(lambda _: self.client.joints.are_there(), within_s, "joints at their commands")

    def _on_change(self, _: RobotState) -> None:
        with self._changed:
            self._changed.notify_all()


@contextmanager
def connect(
    robot: str | os.PathLike[str] | RobotDescription | None = None,
    *,
    namespace: str | None = None,
    domain: int | None = None,
    say: Callable[[str], None] = lambda _: None,
    within_s: float = CONNECT_WITHIN_S,
) -> Iterator[RobotSession]:
    """Connect a script to a running robot for the `with` block.

    Args:
        robot: Name or path of the robot, or the robot itself; None: the running one.
        namespace: Where it runs; None: the robot's own name.
        domain: ROS domain; None: that of the environment.
        say: Called with messages for the user; may be `print`.
        within_s: Longest wait for the robot in [s].

    Raises:
        SoftSimError: the robot is not known.
        RobotChoiceError: `robot` is None, and several run.
        ClientError: none runs, or no joint states arrived in time.
    """
    prepare_environment()
    if robot is None:
        found = running_robot(namespace, domain, within_s)
        if found is None:
            raise ClientError(f"no robot runs; {START_ONE}")
        robot, namespace = found
    scene = robot if isinstance(robot, RobotDescription) else load_scene(robot)
    context = Context()
    context.init(args=["--ros-args", "--disable-rosout-logs"], domain_id=domain)
    node = GuardedNode(
        f"client_{os.getpid()}",
        context=context,
        namespace=scene.namespace if namespace is None else namespace,
        use_global_arguments=False,
    )
    try:
        client = RobotClient(node, scene, say)
        with SpinThread([node], context) as spinner:
            session = RobotSession(client, spinner)
            _wait_for_robot(session, node, within_s)
            yield session
    finally:
        node.close()
        context.try_shutdown()


def _wait_for_robot(session: RobotSession, node: GuardedNode, within_s: float) -> None:
    """Wait for joint states and, if there is a simulator, until it can be commanded and called."""

    def is_whole(state: RobotState) -> bool:
        has_states = state.measured is not None and bool(state.simulator) and state.enforce_limits is not None
        return has_states and session.client.joints.are_commanded and session.client.simulator.is_whole

    first = min(within_s, SIMULATOR_WITHIN_S)
    with suppress(ClientError):
        session.wait_until(is_whole, first)
        return
    try:
        session.wait_until(lambda state: state.measured is not None, within_s - first)
    except ClientError as error:
        found = listing(running_robots(node))
        raise ClientError(
            f"no robot answers in {node.get_namespace()} within {within_s:g} s; running: {found}; {START_ONE}"
        ) from error
