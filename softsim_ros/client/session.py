"""A client that a script can wait with: its node spins in a thread, its calls block until their end."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

from rclpy.context import Context

from softsim_core.errors import SoftSimError, listing
from softsim_core.scene import RobotDescription, load_scene
from softsim_node.environment import prepare_environment
from softsim_node.sentences import sentence_of
from softsim_ros.client.discovery import running_robot, running_robots
from softsim_ros.client.robot_client import RobotClient
from softsim_ros.client.services import Outcome
from softsim_ros.client.state import RobotState
from softsim_ros.runtime import ClosableNode, SpinThread

CONNECT_WITHIN_S: Final = 15.0
SIMULATOR_WITHIN_S: Final = 4.0
"""A simulator that was not found whole within this time in [s] is taken for none: robots need none."""

LOOK_PERIOD_S: Final = 0.1
DONE_WITHIN_S: Final = 90.0
"""An action ends within this time in [s]; the client itself gives up calls without an answer earlier."""

START_ONE: Final = "start one with `softsim up tripod` in another terminal"


class ClientError(SoftSimError):
    """The robot is not there, an action was refused, or something did not come in time."""


class RobotSession:
    """A RobotClient for a script, from any thread but the one that spins the node.

    Args:
        client: The client.
        spinner: The thread that serves its node.

    Attributes:
        client: Its actions are done with `do`.
    """

    def __init__(self, client: RobotClient, spinner: SpinThread) -> None:
        self.client, self._spinner = client, spinner
        self._changed = threading.Condition()
        client.watch(self._on_change)

    @property
    def state(self) -> RobotState:
        """Everything known of the robot now."""
        return self.client.state

    @property
    def is_running(self) -> bool:
        """Whether ROS still runs in this process: no signal has ended it."""
        return bool(self._spinner.executor.context.ok())

    def do(self, action: Callable[..., None], *arguments: Any) -> str:
        """Do something and wait for its end: `robot.do(robot.client.joints.go_to, "mid")`.

        Args:
            action: A method of a part of the client that takes `done` last.
            *arguments: What it takes before that.

        Returns:
            The sentence of its outcome.

        Raises:
            ClientError: it was refused, or has no end within DONE_WITHIN_S.
        """
        ends: list[Outcome] = []

        def keep(end: Outcome) -> None:
            with self._changed:
                ends.append(end)
                self._changed.notify_all()

        def act() -> None:
            try:
                action(*arguments, keep)
            except Exception as error:  # what no action takes, such as a text for a position
                keep(Outcome(False, f"{action.__qualname__} {sentence_of(error)}"))

        self._spinner.executor.create_task(act)
        with self._changed:
            self._changed.wait_for(lambda: ends, DONE_WITHIN_S)
        if not ends:
            raise ClientError(f"{action.__qualname__} has not ended within {DONE_WITHIN_S:g} s")
        if not ends[0].success:
            raise ClientError(ends[0].sentence)
        return ends[0].sentence

    def wait_until(
        self, condition: Callable[[RobotState], object], within_s: float = 10.0, what: str = "the condition"
    ) -> RobotState:
        """Wait until the state fulfils a condition; returns that state.

        Args:
            condition: Looked at after each change, and every LOOK_PERIOD_S.
            within_s: Longest wait in [s].
            what: What is waited for, in words, for the error.

        Raises:
            ClientError: it did not in time.
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
        raise ClientError(f"{what} did not hold within {within_s:g} s; {_words(self.state)}")

    def wait_until_there(self, within_s: float = 10.0) -> RobotState:
        """Wait until the joints stand at the newest command.

        Raises:
            ClientError: they do not in time.
        """
        return self.wait_until(lambda _: self.client.joints.are_there(), within_s, "joints at their commands")

    def _on_change(self, _: RobotState) -> None:
        with self._changed:
            self._changed.notify_all()


def _words(state: RobotState) -> str:
    joints = "none heard" if state.measured is None else ", ".join(f"{each:.4f}" for each in state.measured)
    return f"simulator {state.simulator or 'not heard'}, bridge {state.bridge}, joints {joints}"


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
        robot: Name or path of the robot, or the robot itself; None: the one that runs.
        namespace: Where it runs; None: the robot's own name.
        domain: ROS domain; None: that of the environment.
        say: Called with sentences for the person, such as `print`.
        within_s: Longest wait for the robot in [s].

    Raises:
        SoftSimError: the robot is not known.
        RobotChoiceError: `robot` is None, and several run.
        ClientError: none runs, or no joints of it were heard in time.
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
    node = ClosableNode(
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


def _wait_for_robot(session: RobotSession, node: ClosableNode, within_s: float) -> None:
    """Wait until joints are heard, and the simulator's state, services and limits, where there is one."""

    def is_whole(state: RobotState) -> bool:
        known = state.measured is not None and bool(state.simulator) and state.enforce_limits is not None
        return known and session.client.simulator.is_whole

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
