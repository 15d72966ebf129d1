"""Lifecycle node `servo_bridge`: configure opens the port, activate sends, exits end in the safe pose."""

from __future__ import annotations

import sys
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64MultiArray, String

from servo_bridge import parameters
from servo_bridge.assembly import assemble
from servo_bridge.diagnostics import bridge_status
from servo_bridge.driver import ServoDriver
from servo_bridge.e_stop import EStop
from servo_bridge.e_stop_services import EStopServices
from servo_bridge.errors import PortError
from servo_bridge.imu import imu_message
from servo_bridge.inputs import NamedCommand, command_values, joint_positions, named_command
from servo_bridge.lifecycle import GuardedLifecycleNode
from servo_bridge.parameters import BridgeSettings
from servo_bridge.ports import find_again, find_port, stable_name
from servo_bridge.protocols import TiltReading
from servo_bridge.recovery import Recovery
from servo_bridge.state_topics import StateTopics
from servo_bridge.wording import printable, sentence
from servo_bridge.writer import PeriodicThread
from softsim_core.errors import CommandError, SoftSimError
from softsim_core.scene.robot import RobotDescription
from softsim_node.frames import prefix_of
from softsim_node.help import Program
from softsim_node.parameters import LiveParameters
from softsim_node.process import run_node

Values = TypeVar("Values")

SUPERVISION_PERIOD_S = 0.1
SETTLING_MARGIN_S = 2.0
"""How much longer than `settle_timeout` the way to rest is waited for, braking and rest packets included."""

NAMED_DEPTH = 10
"""Commands by name that may wait: each may be for other joints."""

REFUSAL_LOG_PERIOD_S = 2.0
RETRY_JITTER = 0.2


class ServoBridge(GuardedLifecycleNode):
    """Thin: parameters, topics, services and timers; decisions live in safety, driver and recovery.

    Topics (relative): `joint_states`, `position_controller/commands` or `joint_commands` in,
    `applied_joint_states` out (what was really sent, one message a packet), `imu` where the board has one,
    `/diagnostics` at 1 Hz; latched and on a change `~/state`, `~/connected`, `~/sending`, `~/e_stop_latched`,
    `~/commanded_by`. Packets leave from a thread of their own, at a fixed rate whatever the executor is busy
    with; it runs as long as the port is open, and looks at the e-stop for each packet. Services: the
    lifecycle ones, and `~/e_stop`, `~/clear_e_stop` on an executor of their own.

    Args:
        scene: Robot already loaded; None loads the parameter `robot` at configure.
        node_name: Name of the node.
        **node_kwargs: Passed on to rclpy's Node (namespace, parameter_overrides, context, ...).
    """

    def __init__(
        self, *, scene: RobotDescription | None = None, node_name: str = "servo_bridge", **node_kwargs: Any
    ) -> None:
        super().__init__(node_name, **node_kwargs)
        self._live = LiveParameters(
            self,
            BridgeSettings(frame_prefix=prefix_of(self.get_namespace())),
            check=self._check_parameters,
            apply=self._apply_parameters,
        )
        parameters.check(self._live.values)
        self._scene = scene
        self._lock = threading.RLock()  # in-process, close() may come from another thread than the callbacks
        self._e_stop = EStop(self._hurry_writer)  # outside that lock
        self._driver: ServoDriver | None = None
        self._sending = False
        self._closed = False
        self._trouble = ""
        self._reconnects = 0
        self._recovery = Recovery(RETRY_JITTER)
        self._writer: PeriodicThread | None = None  # while the port is open
        self._lost: PortError | None = None  # told by the writer, handled by the executor
        self._stable_port = ""  # name of the configured board that outlives its number; empty: none
        self._calibration = ""
        self._imu_frame = ""
        self._base_frame = f"{self.get_parameter('frame_prefix').value}base_link"
        self._source_subscription: Subscription | None = None
        self._source_topic = ""
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._applied: Publisher = self.create_publisher(
            JointState, "applied_joint_states", QoSProfile(depth=10)
        )
        self._diagnostics: Publisher = self.create_publisher(
            DiagnosticArray, "/diagnostics", QoSProfile(depth=10)
        )
        self._imu: Publisher = self.create_publisher(Imu, "imu", QoSProfile(depth=10))
        self.create_timer(SUPERVISION_PERIOD_S, self._supervise, clock=self._steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=self._steady)
        self._recovery.want(self._live.values.autostart, time.monotonic(), wait=False)
        self._state_topics = StateTopics(
            self,
            {
                "~/state": (State, self.state_message),
                "~/connected": (Bool, lambda: self._of_driver(lambda driver: driver.connected)),
                "~/sending": (Bool, lambda: self._of_driver(lambda driver: driver.sending)),
                "~/e_stop_latched": (Bool, lambda: Bool(data=self._e_stop.latched)),
                "~/commanded_by": (String, lambda: String(data=self._commanded_by())),
            },
        )
        self._e_stop_services = EStopServices(self, self._e_stop, self._state_topics.refresh)

    # Lifecycle: unconfigured -> (configure: port open) inactive -> (activate: sending) active

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the robot and open the port; failure leaves the node unconfigured, with a sentence."""
        self._state_topics.refresh()
        with self._lock:
            try:
                self._configure()
            except SoftSimError as error:
                self._report(str(error))
                return TransitionCallbackReturn.FAILURE
            except Exception as error:
                self._report(f"configure failed ({type(error).__name__}: {sentence(error)})")
                return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send from where the board stands; refused without a port and while the e-stop is latched."""
        with self._lock:
            refusal = self._activation_refusal()
            if refusal or self._driver is None:
                self.get_logger().error(refusal)
                return TransitionCallbackReturn.FAILURE
            self._driver.start()
            self._sending = True
            self._trouble = ""
            if self._writer is None:  # it died, and was not started anew by itself
                self._start_writer()
        self.get_logger().info(f"sending to {self._driver.port} at {1.0 / self._driver.period:g} Hz")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to the safe pose and stop sending; the port stays open."""
        self._state_topics.refresh()
        self._recovery.give_up()
        self._stop_sending()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the port; the last pose sent stays known."""
        self._state_topics.refresh()
        self._recovery.give_up()
        self._disconnect()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to the safe pose and close the port, for good."""
        self._state_topics.refresh()
        self._recovery.give_up()
        self._disconnect()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After an unforeseen error: safe pose, port closed, unconfigured."""
        self.get_logger().error("a transition failed unexpectedly; the bridge is unconfigured again")
        self._disconnect()
        return super().on_error(state)

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return super()._on_change_state(request, response)
        finally:
            self._state_topics.refresh()

    def close(self) -> None:
        """Reach the safe pose and close the port, in whatever state; a second call does nothing."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._recovery.give_up()
                self._disconnect()
                self._state_topics.refresh()

    def destroy_node(self) -> None:
        """Close, then destroy the node; the e-stop is served until the port is closed."""
        self.close()
        self._e_stop_services.close()
        super().destroy_node()

    def _configure(self) -> None:
        settings = self._live.values
        assembled = assemble(settings, self._scene, self._e_stop, self._on_tilt)
        driver = assembled.driver
        self._imu_frame, self._calibration = assembled.imu_frame, assembled.calibration
        if self._driver is not None and self._driver.servo_joints == driver.servo_joints:
            driver.motion.resume_from(self._driver.motion.positions)
        self._open(driver, find_port(settings.port), settings.open_wait_s)
        self._release_topics()
        message_type, topic, callback, depth = {
            "joint_states": (JointState, "joint_states", self._on_joint_states, 1),
            "commands": (Float64MultiArray, "position_controller/commands", self._on_command, 1),
            "joint_commands": (JointState, "joint_commands", self._on_joint_commands, NAMED_DEPTH),
        }[settings.source]
        self._source_subscription = self.create_subscription(
            message_type, topic, callback, QoSProfile(depth=depth), raw=True
        )
        self._source_topic = str(self._source_subscription.topic_name)
        self._trouble = ""
        self.get_logger().info(
            f"port {driver.port} open, source {settings.source}, calibration {self._calibration or 'none'};"
            " activate to send"
        )

    def _open(self, driver: ServoDriver, port: str, open_wait_s: float) -> None:
        """Open a port, learn the name that outlives its number, and let the writer stand by."""
        driver.connect(port, open_wait_s)
        driver.stand_by()
        self._driver = driver
        self._stable_port = stable_name(port)
        self._start_writer()

    def _activation_refusal(self) -> str:
        if self._e_stop.latched:
            return "activation refused: the e-stop is latched; call ~/clear_e_stop first"
        if self._driver is None or not self._driver.connected:
            return f"activation refused: no port is open ({self._trouble or 'configure first'})"
        return ""

    def _stop_sending(self) -> None:
        """Let the writer go to rest and stand by; an e-stop, a lost port or a dead writer ends the wait."""
        with self._lock:
            driver, writer = self._driver, self._writer
            if not self._sending or driver is None:
                return
            self._sending = False
            timeout_s = self._live.values.settle_timeout
            if writer is None or not driver.begin_settling(timeout_s):
                driver.stand_by()
                return
            end = time.monotonic() + timeout_s + SETTLING_MARGIN_S
            while not driver.settled.wait(SUPERVISION_PERIOD_S):
                ended = writer.failure is not None or self._lost is not None
                if ended or time.monotonic() > end:
                    driver.stand_by()
            if not (driver.arrived or self._e_stop.latched):
                self.get_logger().warning("the servos have not reached rest; they stay where they are")

    def _disconnect(self) -> None:
        with self._lock:
            self._stop_sending()
            self._stop_writer()
            if self._driver is not None:
                self._driver.disconnect(relax=self._live.values.relax_at_end)
            if not self._closed:
                self._release_topics()

    def _start_writer(self) -> None:
        self._stop_writer()
        self._lost = None  # of the port before; what this writer will find is kept, also while activating
        if self._driver is not None:
            self._writer = PeriodicThread(self._tick, self._driver.period)

    def _hurry_writer(self) -> None:
        writer = self._writer
        if writer is not None:
            writer.hurry()

    def _stop_writer(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.stop()
            writer.join()

    def _release_topics(self) -> None:
        if self._source_subscription is not None:
            self.destroy_subscription(self._source_subscription)
        self._source_subscription = None

    # Commands

    def _on_command(self, data: bytes) -> None:
        self._obey("position_controller/commands", data, command_values, ServoDriver.command)

    def _on_joint_states(self, data: bytes) -> None:
        self._obey("joint_states", data, joint_positions, ServoDriver.command_named)

    def _on_joint_commands(self, data: bytes) -> None:
        def unpack(data: bytes) -> NamedCommand:
            return named_command(data, 1e-9 * self.get_clock().now().nanoseconds)

        self._obey("joint_commands", data, unpack, lambda driver, each: driver.command_some(*each))

    def _obey(
        self,
        topic: str,
        data: bytes,
        unpack: Callable[[bytes], Values],
        command: Callable[[ServoDriver, Values], None],
    ) -> None:
        driver = self._driver
        if not self._sending or driver is None:
            return
        try:
            try:
                values = unpack(data)
            except CommandError as error:
                driver.refuse(error)
                raise
            command(driver, values)
        except CommandError as error:
            text = f"{topic}: {sentence(error)}"
            self.get_logger().warning(text, throttle_duration_sec=REFUSAL_LOG_PERIOD_S)

    def _of_driver(self, fact: Callable[[ServoDriver], bool]) -> Bool:
        driver = self._driver
        return Bool(data=driver is not None and fact(driver))

    def _commanded_by(self) -> str:
        """The topic whose commands the servos follow now; empty: they hold, rest or are stopped."""
        driver = self._driver
        follows = driver is not None and driver.sending and driver.motion.mode == "track"
        return self._source_topic if follows else ""

    # The writer's thread, which takes no lock of the node

    def _tick(self) -> None:
        driver, writer = self._driver, self._writer
        if driver is None:
            return
        try:
            sent = driver.tick()
        except PortError as error:
            self._lost = error
            if writer is not None:
                writer.stop()
            return
        if sent is not None:
            self._publish_applied(driver)

    # Timers

    def _supervise(self) -> None:
        with self._lock:
            if self._closed:
                return
            self._tell_news()
            if self._writer is not None and self._writer.failure is not None:
                self._lose_writer(self._writer.failure)
            if self._lost is not None:
                self._lose_port(self._lost)
            now = time.monotonic()
            if self._recovery.due(now):
                if self._pursue():
                    self._recovery.reached(time.monotonic())
                else:
                    self._recovery.failed(time.monotonic())

    def _tell_news(self) -> None:
        news = () if self._driver is None else self._driver.takeover.news
        while news:
            self.get_logger().warning(news.popleft())

    def _lose_writer(self, failure: Exception) -> None:
        """The thread that sends is dead: the servos hold, the bridge is inactive until it is activated."""
        self._stop_writer()
        if self._driver is not None:
            self._driver.stand_by()
            self._driver.hold_board()
        self._report(
            f"the thread that sends packets has ended"
            f" ({type(failure).__name__}: {sentence(failure)});"
            " the servos hold; activate the bridge anew"
        )
        self._leave_active()
        self._recovery.give_up()

    def _lose_port(self, error: PortError) -> None:
        """The port vanished: inactive, port closed, trying to open it again and then to go on as before."""
        was_sending, self._lost = self._sending, None
        self._stop_writer()
        if self._driver is not None:
            self._driver.disconnect()
        self._report(f"{error}; the bridge tries to open it again")
        self._leave_active()
        self._recovery.want("activate" if was_sending else "configure", time.monotonic(), wait=True)

    def _leave_active(self) -> None:
        if self.lifecycle_state == "active":
            self.trigger_deactivate()

    def _pursue(self) -> bool:
        """One try to reach what recovery wishes; True when there is no more to try."""
        wish = self._recovery.wish
        if self.lifecycle_state == "unconfigured":
            if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
                return False
        elif self.lifecycle_state == "inactive" and self._driver is not None and not self._driver.connected:
            settings = self._live.values
            try:
                port = find_again(settings.port, self._stable_port)
                self._open(self._driver, port, settings.open_wait_s)
            except PortError as error:
                self._report(str(error))
                return False
            self._reconnects += 1
            self._trouble = ""
            self.get_logger().info(f"port {self._driver.port} is open again")
        if wish == "activate" and self.lifecycle_state == "inactive":
            self.trigger_activate()
        return True

    # Reports

    def _report(self, problem: str) -> None:
        """Log an error once, and show it in the diagnostics until it is over."""
        text = printable(problem)
        if text != self._trouble:
            self._trouble = text
            self.get_logger().error(text)

    def _publish_applied(self, driver: ServoDriver) -> None:
        if not self.context.ok():
            return
        message = JointState(name=list(driver.servo_joints))
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self._base_frame
        message.position = array("d", driver.applied_angles())
        self._publish(self._applied, message)

    def _on_tilt(self, reading: TiltReading) -> None:
        """A reading of the board's IMU, in the reading thread."""
        stamp = self.get_clock().now().to_msg()
        self._publish(self._imu, imu_message(reading, self._imu_frame, stamp))

    def _publish(self, publisher: Publisher, message: Any) -> None:
        try:
            if self.context.ok():
                publisher.publish(message)
        except Exception:
            if self.context.ok():  # else the context went down under the call, at a signal: no fault
                raise

    def _publish_diagnostics(self) -> None:
        with self._lock:
            if self._closed or not self.context.ok():
                return
            status = bridge_status(
                self.get_fully_qualified_name(),
                self.lifecycle_state,
                self._driver,
                e_stopped=self._e_stop.latched,
                trouble=self._trouble,
                reconnects=self._reconnects,
                calibration=self._calibration,
                period=self._writer.figures() if self._writer is not None and self._sending else None,
            )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._publish(self._diagnostics, message)

    # Parameters

    def _check_parameters(self, names: frozenset[str], settings: BridgeSettings) -> None:
        configured = self.lifecycle_state in ("inactive", "active")
        parameters.check(settings, names, configured=configured)

    def _apply_parameters(self, _: frozenset[str], settings: BridgeSettings) -> None:
        with self._lock:
            if self._driver is not None:
                self._driver.avoid_byte_100 = settings.avoid_byte_100
                self._driver.set_timing(settings.motion)


PROGRAM = Program(
    name="servo_bridge",
    about="Writes a robot's joint angles as servo packets to a serial port, through limits and ramps.",
    settings=(BridgeSettings(),),
)


def main(args: Sequence[str] | None = None) -> int:
    """Run the bridge until a signal or the end of its parent; the servos end in the safe pose.

    Its namespace is the robot's name unless `-r __ns:=/other` says otherwise.

    Returns:
        Exit code: 0 after a normal end, 1 for a parameter that cannot be used, 2 for a wrong command line.
    """
    return run_node(PROGRAM, lambda _: ServoBridge(namespace=parameters.robot_namespace(PROGRAM.name)), args)


if __name__ == "__main__":
    sys.exit(main())
