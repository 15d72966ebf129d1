"""The simulator as a client sees it: start, pause, steps, reset, another scene, a pull on the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import MultiDOFJointState
from std_srvs.srv import Trigger

from softsim_ros.client.inverse import Inverse
from softsim_ros.client.joints import Joints
from softsim_ros.client.known import Known
from softsim_ros.client.parameters import Parameters
from softsim_ros.client.services import Done, Outcome, Request, Switch, unheeded
from softsim_ros.client.wishes import INVERSE_OWNS
from softsim_ros.messages import base_target, header
from softsim_ros.qos import NEWEST_ONLY
from softsim_ros.state_listener import StateListener

RELOAD_WITHIN_S: Final = 60.0
"""A scene is loaded anew within this time in [s]; its kernels may have to be compiled."""


class Simulator:
    """Drives `simulator` of the node's namespace; `external_wrench` and `base_target` out.

    Args:
        node: The node whose executor delivers the answers.
        known: Where its state is kept.
        joints: They are expected at the start pose after the start animation.
        inverse: Switched off before a reset: else it would drive the joints back.

    Attributes:
        parameters: Its parameters.
    """

    def __init__(self, node: Node, known: Known, joints: Joints, inverse: Inverse) -> None:
        self._known, self._joints, self._inverse, self._clock = known, joints, inverse, node.get_clock()
        self.parameters = Parameters(node, known)

        def request(name: str, within_s: float = 8.0) -> Request:
            return Request(node, Trigger, f"simulator/{name}", "simulator", known.say, within_s)

        self._start, self._reset, self._step = request("start"), request("reset"), request("step")
        self._pause = Switch(node, "simulator/pause", "simulator", known.say)
        self._reload = request("reload", RELOAD_WITHIN_S)
        self._services = (self._start, self._reset, self._pause, self._step, self._reload)
        self._bases = node.create_publisher(MultiDOFJointState, "base_target", NEWEST_ONLY)
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", NEWEST_ONLY)

        self._facts = [
            StateListener(node, topic, self._on_change)
            for topic in ("simulator/faulted", "simulator/paused", "replay/paused")
        ]

    @property
    def is_there(self) -> bool:
        """Whether it has been found."""
        return self._start.is_there

    @property
    def is_whole(self) -> bool:
        """Whether all its services have been found."""
        return all(each.is_there for each in self._services)

    # --- time -----------------------------------------------------------------------------------------

    def start(self, done: Done = unheeded) -> None:
        """Play the robot's start animation; refused while inverse control is on."""
        if self._known.state.inverse:
            self._known.say(INVERSE_OWNS)
            done(Outcome(False, INVERSE_OWNS))
            return

        def started() -> str:
            if self._known.robot.start is not None:
                self._joints.expect(self._known.robot.start.pose)
            return "start pose"

        self._start.ask(Trigger.Request(), done, started)

    def reset(self, done: Done = unheeded) -> None:
        """Back to the start of the scene."""

        def was_reset() -> str:
            self._known.change(commanded=None)
            return "simulation reset"

        def go_on(end: Outcome) -> None:
            if end.success:
                self._reset.ask(Trigger.Request(), done, was_reset)
            else:
                done(end)

        if self._known.state.inverse:
            self._inverse.enable(False, go_on)
        else:
            go_on(Outcome(True, ""))

    def pause(self, paused: bool, done: Done = unheeded) -> None:
        """Pause, or go on."""

        def changed() -> str:
            self._known.change(simulator="paused" if paused else "running")
            return "simulation paused" if paused else "simulation goes on"

        self._pause.set(paused, done, changed)

    def toggle_pause(self, done: Done = unheeded) -> None:
        """Pause a simulation that runs, run one that stands."""
        self.pause(self._pause.opposite(self._known.state.stands), done)

    def step(self, done: Done = unheeded) -> None:
        """One step; a running simulation is paused first."""

        def go_on(end: Outcome) -> None:
            if end.success:
                self._step.ask(Trigger.Request(), done)
            else:
                done(end)

        if self._known.state.stands:
            go_on(Outcome(True, ""))
        else:
            self.pause(True, go_on)

    # --- scene ----------------------------------------------------------------------------------------

    def reload(self, done: Done = unheeded) -> None:
        """Load the scene's files anew."""
        self._reload.ask(Trigger.Request(), done)

    def choose_scene(self, name: str, done: Done = unheeded) -> None:
        """Run another robot or scene in place of this one."""
        self._known.say(f"loading {name} ...")
        self.parameters.set("robot", name, done)

    # --- hands on the body ----------------------------------------------------------------------------

    def pull(self, frame: str, force: Sequence[float]) -> None:
        """Pull on the body; it is let go soon unless this is repeated.

        Args:
            frame: What is pulled: `mesh_point/INDEX`, a free frame or `ROBOT_effector`.
            force: In world axes in [N], shape (3,).
        """
        message = WrenchStamped(header=header(self._clock.now().to_msg(), frame))
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self._wrenches.publish(message)

    def move_base(self, joint: str, position: Sequence[float]) -> None:
        """Have the base of a joint go to a position (3,) in [m] in the world."""
        self._bases.publish(base_target(self._clock.now().to_msg(), joint, position))

    def poll(self, now: float) -> None:
        """Give up calls that have waited too long, ask for parameters; `now` is a steady clock in [s]."""
        self.parameters.poll(now)
        for service in self._services:
            service.expire(now)

    def _on_change(self, _: object) -> None:
        """The simulator's state in a word; a replay stands in for a simulator that does not run."""
        faulted, paused, replay = (fact.value for fact in self._facts)
        if paused is None:
            self._known.change(real_time_factor=None, enforce_limits=None, fault="", scene_error="")
        stands = replay if paused is None else paused
        word = "" if stands is None else "paused" if stands else "running"
        self._known.change(simulator="stopped" if faulted else word)
