"""The Tripod's page together with what its robot says on its topics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from browser_page import BrowserPage
from diagnostic_msgs.msg import DiagnosticArray
from diagnostics import diagnostic_values
from geometry_msgs.msg import PoseStamped, WrenchStamped
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool

from softsim_node import STATE_QOS

BODY = "/bodies/silicone"
START, MID, HIGH = -1.4965, -1.0466666666666667, -0.785
WAIT_S = 120.0
HELD_MS = 800
"""A key pressed again later than this is not taken for one that is held down."""


class Driven:
    """The page together with what its robot says on its topics."""

    def __init__(self, page: BrowserPage, robot: Any, spin_until: Callable[..., bool]) -> None:
        self.page, self.robot, self._spin_until = page, robot, spin_until
        client = robot.client
        self.states = client.collect(JointState, "joint_states", 5)
        self.commands = client.collect(Float64MultiArray, "position_controller/commands", 50)
        self.goals = client.collect(PoseStamped, "effector_goal", 50)
        self.wrenches = client.collect(WrenchStamped, "external_wrench", 50)
        self.diagnostics = client.collect(DiagnosticArray, "/diagnostics", 50)
        self.pauses = client.collect(Bool, "simulator/paused", STATE_QOS)
        assert self.until(lambda: self.states and self.pauses)

    def until(self, condition: Callable[[], Any]) -> bool:
        return self._spin_until(condition, WAIT_S)

    def shows(self, text: str) -> bool:
        """Whether the page comes to show a text."""
        self.page.page.get_by_text(text).first.wait_for(state="visible")
        return True

    def await_page(self) -> None:
        """Wait until all that the page has sent has had its effect: pause the robot, and let it go on."""
        for _ in ("pause", "run"):
            before = self.pauses[-1].data
            self.page.click("Run / pause")
            assert self.until(lambda before=before: self.pauses[-1].data != before)

    def joints_at(self, *wanted: float) -> bool:
        """Whether the joints come to stand still at these positions."""

        def there() -> bool:
            state = self.states[-1]
            near = all(abs(a - b) < 0.01 for a, b in zip(state.position, wanted, strict=True))
            return near and max(map(abs, state.velocity)) < 0.01

        return self.until(there)

    def commanded(self, before: int, *wanted: float) -> bool:
        """Whether a command with these positions came after the first `before` ones."""

        def came() -> bool:
            return any(
                all(abs(a - b) < 0.02 for a, b in zip(command.data, wanted, strict=True))
                for command in self.commands[before:]
            )

        return self.until(came)

    def reported(self, node: str, key: str) -> str:
        """What a node says of itself in the newest diagnostics; empty: nothing."""
        for message in reversed(self.diagnostics):
            values = diagnostic_values(message, f"tripod/{node}")
            if key in values:
                return str(values[key])
        return ""

    def next_report(self, node: str) -> bool:
        """Whether a node reports once more."""

        def count() -> int:
            return sum(bool(diagnostic_values(each, f"tripod/{node}")) for each in self.diagnostics)

        before = count()
        return self.until(lambda: count() > before)

    def reports(self, node: str, key: str, value: str) -> bool:
        """Whether a node comes to say this of itself."""
        return self.until(lambda: self.reported(node, key) == value)

    def bridge_state(self) -> str:
        answer = self.robot.client.call(GetState, "servo_bridge/get_state")
        return str(answer.current_state.label)

    def to_start(self) -> None:
        """Running, at the start pose."""
        self.to_mid()
        assert self.robot.trigger("start")[0]
        assert self.joints_at(START, START, START), f"{self.states[-1]}\n{self.robot.process.output}"

    def to_mid(self) -> None:
        """Running, inverse control off, joints at the mid pose."""
        assert self.robot.pause(False)[0]
        off = self.robot.client.call(SetBool, "inverse_controller/enable", SetBool.Request(data=False))
        assert off.success, off.message
        assert self.shows("inverse off")
        self.robot.command([MID] * 3)
        assert self.joints_at(MID, MID, MID), self.robot.process.output
