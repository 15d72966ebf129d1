"""Publications of a bridge: applied poses, tilts of the board, state topics, the status in /diagnostics."""

from __future__ import annotations

import math
from array import array
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, String

from servo_bridge import PortError
from servo_bridge.driver import BoardLink, BoardSession, EStop, ServoDriver
from servo_bridge.nodes.bridge_services import GuardedLifecycleNode
from servo_bridge.protocols import Ability, TiltReading
from softsim_node import Facts

# Variance in [rad^2] of a tilt: about one degree, as small IMUs with sensor fusion specify
TILT_VARIANCE = math.radians(1.0) ** 2
HEADING_VARIANCE = math.pi**2  # variance in [rad^2] of the heading, which is not measured


def _link_values(driver: ServoDriver) -> dict[str, object]:
    """Return the protocol, the abilities and the newest values of the board, by name."""
    link = driver.link
    if link is None:
        return {"link": "closed"}
    values: dict[str, object] = {"link": driver.link_state}
    try:
        with link.speaking() as board:
            abilities, said = board.abilities, dict(board.values())
    except PortError as error:
        return values | {"link fault": str(error)}
    values["board can"] = " ".join(str(each.name).lower() for each in Ability if each in abilities) or "none"
    age = driver.telemetry_age
    if age is not None:
        values |= {"telemetry age [s]": f"{age:.3f}", "board starts": driver.counts.restarts}
    tilt_age = link.tilt_age(driver.clock())
    if tilt_age is not None or Ability.IMU in abilities:
        values |= {
            "imu age [s]": "none" if tilt_age is None else f"{tilt_age:.3f}",
            "imu readings": link.tilts,
        }
    return values | said


class Reports:
    """Publishers of a bridge; any thread may call the methods.

    Attributes:
        trouble: Message about the problem that stops the bridge; empty without one.
        reconnects: Number of times that a lost port was opened again.
        calibration: File of the servos' calibration; empty without one.
        imu_frame: Frame of the topic imu.
        source_topic: Full name of the topic with commands; empty before the first configure.
    """

    def __init__(
        self, node: GuardedLifecycleNode, session: BoardSession, e_stop: EStop, base_frame: str
    ) -> None:
        self._node, self._session, self._e_stop = node, session, e_stop
        self._base_frame = base_frame
        self.trouble = self.calibration = self.imu_frame = self.source_topic = ""
        self.reconnects = 0
        self._logged_link: BoardLink | None = None  # link whose abilities were logged
        depth = QoSProfile(depth=10)
        self._applied: Publisher = node.create_publisher(JointState, "applied_joint_states", depth)
        self._diagnostics: Publisher = node.create_publisher(DiagnosticArray, "/diagnostics", depth)
        self._imu: Publisher = node.create_publisher(Imu, "imu", depth)

    def facts(self) -> Facts:
        """Return the state topics with their readers."""
        return {
            "servo_bridge/state": self._node.state_message,
            "servo_bridge/connected": lambda: Bool(data=self._session.connected),
            "servo_bridge/sending": lambda: Bool(data=self._sending()),
            "servo_bridge/e_stop_latched": lambda: Bool(data=self._e_stop.latched),
            "servo_bridge/commanded_by": lambda: String(data=self._commanded_by()),
        }

    def report(self, problem: str) -> None:
        """Log an error once, and show it in the diagnostics until it is over."""
        if problem != self.trouble:
            self.trouble = problem
            self._node.get_logger().error(problem)

    def publish_applied(self, driver: ServoDriver) -> None:
        """Publish the pose that was sent to the servos last."""
        if not self._node.context.ok():
            return
        message = JointState(name=list(driver.servo_joints))
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = self._base_frame
        message.position = array("d", driver.applied_angles())
        self._publish(self._applied, message)

    def publish_tilt(self, reading: TiltReading) -> None:
        """Publish a reading of the board's IMU; it has no rates and accelerations (first covariance -1)."""
        message = Imu()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = self.imu_frame
        orientation = message.orientation
        orientation.x, orientation.y, orientation.z, orientation.w = reading.quaternion_xyzw()
        variances = (TILT_VARIANCE, TILT_VARIANCE, HEADING_VARIANCE)
        message.orientation_covariance = [variances[i] if i == j else 0.0 for i in range(3) for j in range(3)]
        message.angular_velocity_covariance = [-1.0, *[0.0] * 8]
        message.linear_acceleration_covariance = [-1.0, *[0.0] * 8]
        self._publish(self._imu, message)

    def log_events(self) -> None:
        """Log the events between bridge and board, and once per port that the board cannot hold."""
        driver = self._session.driver
        if driver is None:
            return
        while driver.takeover.news:
            self._node.get_logger().warning(driver.takeover.news.popleft())
        if driver.link is not self._logged_link and driver.holds is not None:
            self._logged_link = driver.link
            if not driver.holds:
                self._node.get_logger().warning(f"{driver.port}: {self._no_hold(driver)}")

    def describe_stop(self, acknowledged: bool) -> str:
        """Return what an e-stop has sent to the board, as part of a message.

        `acknowledged` says whether the thread that writes packets has acknowledged the latch.
        """
        driver = self._session.driver
        if driver is None or not driver.connected:
            return "no port is open, and nothing is sent before ~/clear_e_stop"
        if not acknowledged:
            return "but no packet could leave; cut the servos' supply"
        if driver.holds is None:
            return "the board has not started yet, and receives no pose before ~/clear_e_stop"
        message = "the servos hold until ~/clear_e_stop"
        return message if driver.holds else f"{message}; {self._no_hold(driver)}"

    @staticmethod
    def _no_hold(driver: ServoDriver) -> str:
        return (
            f"the {driver.link_state} protocol has no packet that stops the servos: at an e-stop the bridge"
            " sends their present pose while it is active, and without packets the board's firmware decides"
        )

    def diagnose(self) -> None:
        """Publish the status of the bridge."""
        if not self._node.context.ok():
            return
        message = DiagnosticArray(status=[self._status()])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publish(self._diagnostics, message)

    def _status(self) -> DiagnosticStatus:
        state, driver, latched = self._node.lifecycle_state, self._session.driver, self._e_stop.latched
        level, message = DiagnosticStatus.OK, state
        values: dict[str, object] = {"state": state, "e_stop": latched, "reconnects": self.reconnects}
        if driver is not None:
            age, counts = driver.command_age, driver.counts
            if state == "active":
                if driver.waiting:
                    message = "active, waiting for the board to start"
                else:
                    message = f"active, {driver.motion.mode}"
                    level = DiagnosticStatus.OK if driver.motion.mode == "track" else DiagnosticStatus.WARN
                if driver.takeover.pending and not driver.waiting:
                    why = driver.takeover.reason or "sending has begun"
                    message, level = f"active, requesting the board's pose: {why}", DiagnosticStatus.ERROR
            values |= {
                "port": driver.port or "none",
                "mode": driver.motion.mode,
                "packets sent": counts.packets,
                "servo bytes": " ".join(map(str, driver.sent_bytes or ())) or "none",
                "command age [s]": "none" if age is None else f"{age:.3f}",
                "takeovers": driver.takeover.count,
                "commands clipped": driver.motion.clipped,
                "commands refused": counts.refused,
                "last refusal": counts.last_refusal or "none",
                "byte 100 replaced": counts.avoided,
                "calibration": self.calibration or "none",
            }
            values |= _link_values(driver)
        period = self._session.figures()
        if period is not None:
            values |= {
                "send period [ms]": f"{period.mean_s * 1e3:.2f}",
                "send period off by [ms]": f"{period.worst_s * 1e3:.2f}",
                "packets left out": period.missed,
            }
        if latched:
            level, message = DiagnosticStatus.WARN, f"{state}, e-stop latched"
        if self.trouble:
            level, message = DiagnosticStatus.ERROR, self.trouble
        return DiagnosticStatus(
            level=level,
            name=f"{self._node.get_fully_qualified_name().lstrip('/')}: servo board",
            message=message,
            hardware_id="" if driver is None else driver.port,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def _sending(self) -> bool:
        driver = self._session.driver
        return driver is not None and driver.sending

    def _commanded_by(self) -> str:
        """Return the topic that the servos follow now; empty while they hold, rest or are stopped."""
        driver = self._session.driver
        follows = driver is not None and driver.sending and driver.motion.mode == "track"
        return self.source_topic if follows else ""

    def _publish(self, publisher: Publisher, message: Any) -> None:
        try:
            if self._node.context.ok():
                publisher.publish(message)
        except Exception:
            if self._node.context.ok():  # else a signal shut the context down during the call
                raise
