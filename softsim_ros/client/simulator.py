"""Client of the simulator: run, pause, reset, scenes, pulls, edits, parameters."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from softsim_core.base import SoftSimError
from softsim_core.scene.editing import Edit
from softsim_node import EVERY_ONE, LATCHED, NEWEST_ONLY, steady_timer
from softsim_ros import StateListener
from softsim_ros.client.control import Inverse
from softsim_ros.client.joints import INVERSE_OWNS, Joints
from softsim_ros.client.services import AsyncService, Done, Outcome, Request, Switch, ignore_outcome, report
from softsim_ros.client.state import RobotSnapshot
from softsim_ros.messages import Proposal, base_target, header, read_proposal, write_edits

POLL_PERIOD_S: Final = 1.0
ANSWER_WITHIN_S: Final = 20.0
"""Time limit in [s] of a set request; another scene may have to be built before the response."""

LIMITS: Final = "enforce_limits"
"""Parameter that is always followed, because commands depend on it."""


class Parameters:
    """Follows and sets parameters of `simulator` in the node's namespace."""

    def __init__(self, node: Node, snapshot: RobotSnapshot) -> None:
        self._snapshot = snapshot
        self._get = AsyncService(node, GetParameters, "simulator/get_parameters", 2.0)
        self._set = AsyncService(
            node, SetParametersAtomically, "simulator/set_parameters_atomically", ANSWER_WITHIN_S
        )
        self._owner = node.resolve_service_name("simulator")
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, EVERY_ONE)
        self._pending_values: dict[str, Any] = {}
        self._waiting: list[Done] = []
        self._next_poll = 0.0
        self._names: Sequence[str] = ()
        self._on_values: Callable[[dict[str, Any]], None] = lambda _: None

    def follow(self, names: Sequence[str], on_values: Callable[[dict[str, Any]], None]) -> None:
        """Call `on_values` with these parameters, in SI by name, whenever they arrive."""
        self._names, self._on_values = names, on_values

    def set(self, name: str, value: Any, done: Done = ignore_outcome) -> None:
        """Set a parameter; if requests follow quickly, only the newest value is sent."""
        self._pending_values[name] = value
        self._waiting.append(done)

    def poll(self, now: float) -> None:
        """Send pending values and request present ones periodically; `now` is a steady clock in [s]."""
        self._get.expire(now)
        self._set.expire(now)
        if self._pending_values and not self._set.is_busy:
            self._send(now)
        idle = not (self._set.is_busy or self._get.is_busy or self._pending_values)
        if idle and now >= self._next_poll and self._get.is_there:
            self._next_poll = now + POLL_PERIOD_S
            names = self._list_followed_names()
            request = GetParameters.Request(names=names)
            self._get.call(request, now, lambda answer: self._on_answer(names, answer))

    def _list_followed_names(self) -> list[str]:
        return list(dict.fromkeys((LIMITS, *self._names)))

    def _send(self, now: float) -> None:
        values, self._pending_values = self._pending_values, {}
        waiting, self._waiting = self._waiting, []
        if not self._set.is_there:
            self._end(Outcome(False, "the simulator is not running; nothing was set"), waiting)
            return
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]

        def on_answer(answer: Any) -> None:
            self._next_poll = 0.0
            if answer is None:
                self._end(Outcome(False, "the simulator did not answer"), waiting)
            elif not answer.result.successful:
                self._end(Outcome(False, f"refused: {answer.result.reason}"), waiting)
            else:
                self._end(Outcome(True, ""), waiting)

        self._set.call(SetParametersAtomically.Request(parameters=parameters), now, on_answer)

    def _end(self, end: Outcome, waiting: Sequence[Done]) -> None:
        if end.message:
            self._snapshot.say(end.message)
        for done in waiting:
            done(end)

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node == self._owner and not (self._set.is_busy or self._pending_values):
            followed = self._list_followed_names()
            changed = {parameter.name: parameter.value for parameter in event.changed_parameters}
            self._report_values({name: value for name, value in changed.items() if name in followed})

    def _on_answer(self, names: Sequence[str], answer: Any) -> None:
        if answer is not None and not self._set.is_busy and not self._pending_values:
            self._report_values(dict(zip(names, answer.values, strict=False)))

    def _report_values(self, values: Mapping[str, ParameterValue]) -> None:
        plain = {name: parameter_value_to_python(value) for name, value in values.items()}
        snapshot = {name: value for name, value in plain.items() if value is not None}
        enforced = snapshot.get(LIMITS)
        if enforced is not None and enforced != self._snapshot.state.enforce_limits:
            self._snapshot.change(enforce_limits=bool(enforced))
        self._on_values({name: value for name, value in snapshot.items() if name in self._names})


EXPIRE_PERIOD_S: Final = 1.0
APPLIED_WITHIN_S: Final = 60.0
"""Time limit in [s] for building a proposal, since its kernels may have to be compiled."""

PROPOSAL_WITHIN_S: Final = 8.0
"""Time in [s] within which the proposal after an edit must arrive; after it the edit counts as lost."""

ACTIONS: Final = ("begin", "undo", "redo", "discard", "apply", "save", "copy")
"""Names of the requests, see docs/edit.md."""


class Editing:
    """Edits the scene of `simulator` in the node's namespace.

    Attributes:
        proposal: The newest proposal received; None if there is none.
    """

    def __init__(self, node: Node, say: Callable[[str], None]) -> None:
        self._say = say
        self._edits = node.create_publisher(String, "scene/edit", EVERY_ONE)
        node.create_subscription(String, "scene/proposal", self._on_proposal, LATCHED)
        self._requests = {
            name: Request(node, Trigger, f"simulator/edit/{name}", "simulator", say, APPLIED_WITHIN_S)
            for name in ACTIONS
        }
        self.proposal: Proposal | None = None
        self._awaiting_since: float | None = None
        steady_timer(node, EXPIRE_PERIOD_S, self._expire)

    @property
    def is_behind(self) -> bool:
        """Whether the outcome of a request is unknown yet; an edit made now would refer to an old scene."""
        return self._awaiting_since is not None or any(each.is_busy for each in self._requests.values())

    def change(self, edits: Sequence[Edit], stroke: str = "") -> None:
        """Propose edits, which are undone together, as are consecutive edits with the same stroke."""
        self._edits.publish(String(data=write_edits(edits, stroke)))
        self._awaiting_since = time.monotonic()

    def ask(self, name: str, done: Done = ignore_outcome) -> None:
        """Send one of the requests in ACTIONS."""
        self._requests[name].ask(Trigger.Request(), done)

    def _expire(self) -> None:
        """Abort requests that have waited too long."""
        now = time.monotonic()
        for request in self._requests.values():
            request.expire(now)
        if self._awaiting_since is not None and now - self._awaiting_since > PROPOSAL_WITHIN_S:
            self._awaiting_since = None

    def _on_proposal(self, message: String) -> None:
        self._awaiting_since = None
        try:
            proposal = read_proposal(message.data)
        except SoftSimError as error:
            self._say(str(error))
            return
        if self.proposal is None or proposal.revision > self.proposal.revision:
            self.proposal = proposal
            if proposal.message:
                self._say(proposal.message)


RELOAD_WITHIN_S: Final = 60.0
"""Time limit in [s] for reloading a scene, since its kernels may have to be compiled."""


class Simulator:
    """Controls `simulator` of the node's namespace; publishes `external_wrench` and `base_target`.

    Args:
        joints: They are expected at the start pose after the start animation.
        inverse: Switched off before a reset; otherwise it would drive the joints back.

    Attributes:
        parameters: Its parameters.
    """

    def __init__(self, node: Node, snapshot: RobotSnapshot, joints: Joints, inverse: Inverse) -> None:
        self._snapshot, self._joints, self._inverse, self._clock = snapshot, joints, inverse, node.get_clock()
        self.parameters = Parameters(node, snapshot)

        def request(name: str, within_s: float = 8.0) -> Request:
            return Request(node, Trigger, f"simulator/{name}", "simulator", snapshot.say, within_s)

        self._start, self._reset, self._step = request("start"), request("reset"), request("step")
        self._pause = Switch(node, "simulator/pause", "simulator", snapshot.say)
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
        """Whether the simulator has been found."""
        return self._start.is_there

    @property
    def is_whole(self) -> bool:
        """Whether all its services have been found."""
        return all(each.is_there for each in self._services)

    # --- time -----------------------------------------------------------------------------------------

    def start(self, done: Done = ignore_outcome) -> None:
        """Play the robot's start animation; refused while inverse control is on."""
        if self._snapshot.state.inverse:
            report(Outcome(False, INVERSE_OWNS), self._snapshot.say, done)
            return

        def record_start() -> str:
            if (start := self._snapshot.robot.start) is not None:
                self._joints.expect(start.pose)
            return "start pose"

        self._start.ask(Trigger.Request(), done, record_start)

    def reset(self, done: Done = ignore_outcome) -> None:
        """Reset the simulation to the start of the scene."""

        def record_reset() -> str:
            self._snapshot.change(commanded=None)
            return "simulation reset"

        def reset() -> None:
            self._reset.ask(Trigger.Request(), done, record_reset)

        if self._snapshot.state.inverse:
            self._inverse.enable(False, lambda end: reset() if end.success else done(end))
        else:
            reset()

    def pause(self, paused: bool, done: Done = ignore_outcome) -> None:
        """Pause the simulation, or continue it."""

        def record_pause() -> str:
            self._snapshot.change(simulator="paused" if paused else "running")
            return "simulation paused" if paused else "simulation continues"

        self._pause.set(paused, done, record_pause)

    def toggle_pause(self, done: Done = ignore_outcome) -> None:
        """Pause a running simulation, continue a paused one."""
        self.pause(self._pause.opposite(self._snapshot.state.stands), done)

    def step(self, done: Done = ignore_outcome) -> None:
        """Advance by one step; a running simulation is paused first."""

        def step() -> None:
            self._step.ask(Trigger.Request(), done)

        if self._snapshot.state.stands:
            step()
        else:
            self.pause(True, lambda end: step() if end.success else done(end))

    # --- scene ----------------------------------------------------------------------------------------

    def reload(self, done: Done = ignore_outcome) -> None:
        """Reload the scene's files."""
        self._reload.ask(Trigger.Request(), done)

    def choose_scene(self, name: str, done: Done = ignore_outcome) -> None:
        """Run another robot or scene instead of this one."""
        self._snapshot.say(f"loading {name} ...")
        self.parameters.set("robot", name, done)

    # --- pulls and bases ------------------------------------------------------------------------------

    def pull(self, frame: str, force: Sequence[float]) -> None:
        """Pull on the body; the pull ends soon unless it is repeated.

        Args:
            frame: Place of the pull: `mesh_point/INDEX`, a free frame or `ROBOT_effector`.
            force: In world axes in [N], shape (3,).
        """
        message = WrenchStamped(header=header(self._clock.now().to_msg(), frame))
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self._wrenches.publish(message)

    def move_base(self, joint: str, position: Sequence[float]) -> None:
        """Move the base of a joint to a position (3,) in [m] in the world."""
        self._bases.publish(base_target(self._clock.now().to_msg(), joint, position))

    def poll(self, now: float) -> None:
        """Give up calls that have waited too long, request parameters; `now` is a steady clock in [s]."""
        self.parameters.poll(now)
        for service in self._services:
            service.expire(now)

    def _on_change(self, _: object) -> None:
        """Update the simulator's state; without a simulator, it is that of a replay."""
        faulted, paused, replay = (fact.value for fact in self._facts)
        if paused is None:
            self._snapshot.change(real_time_factor=None, enforce_limits=None, fault="", scene_error="")
        stands = replay if paused is None else paused
        word = "" if stands is None else "paused" if stands else "running"
        self._snapshot.change(simulator="stopped" if faulted else word)
