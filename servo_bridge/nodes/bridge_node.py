"""Lifecycle node `servo_bridge`: configure opens the port, activate sends, exits end in the safe pose."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from servo_bridge import PortError
from servo_bridge.driver import BoardSession, EStop, Recovery, RequestedState, ServoDriver, find_port
from servo_bridge.nodes import parameters
from servo_bridge.nodes.bridge_services import EStopServices, GuardedLifecycleNode
from servo_bridge.nodes.commands import CommandInput
from servo_bridge.nodes.parameters import BridgeSettings, assemble
from servo_bridge.nodes.reports import Reports
from softsim_core.base import SoftSimError
from softsim_core.scene import RobotDescription
from softsim_node import LiveParameters, Program, StateTopics, error_text, prefix_of, run_node, steady_timer

SUPERVISION_PERIOD_S = 0.1
RETRY_JITTER = 0.2


class ServoBridge(GuardedLifecycleNode):
    """Lifecycle, parameters and timers of the bridge; the decisions are in safety, driver and board_session.

    Topics (relative): `joint_states`, `position_controller/commands` or `joint_commands` in,
    `applied_joint_states` out (the applied command, one message per packet), `imu` if the board has one,
    `/diagnostics` at 1 Hz; latched and on a change `~/state`, `~/connected`, `~/sending`, `~/e_stop_latched`,
    `~/commanded_by`. A thread of its own sends packets at a fixed rate, whatever the executor is busy with;
    it runs as long as the port is open, and checks the e-stop for each packet. Services: the lifecycle ones,
    and `~/e_stop`, `~/clear_e_stop` on an executor of their own.

    A `scene` is a robot that is already loaded; None loads the one of the parameter `robot` at configure.
    """

    def __init__(self, *, scene: RobotDescription | None = None, **node_kwargs: Any) -> None:
        super().__init__("servo_bridge", **node_kwargs)
        self._live = LiveParameters(
            self,
            BridgeSettings(frame_prefix=prefix_of(self.get_namespace())),
            check=self._check_parameters,
            apply=self._apply_parameters,
        )
        parameters.check(self._live.values)
        self._scene = scene
        self._lock = threading.RLock()  # in-process, close() may come from another thread than the callbacks
        self._session = BoardSession(lambda driver: self._reports.publish_applied(driver))
        self._e_stop = EStop(self._session.hurry)  # without that lock
        base_frame = f"{self.get_parameter('frame_prefix').value}base_link"
        self._reports = Reports(self, self._session, self._e_stop, base_frame)
        self._input: CommandInput | None = None
        self._closed = False
        self._recovery = Recovery(RETRY_JITTER)
        steady_timer(self, SUPERVISION_PERIOD_S, self._supervise)
        steady_timer(self, 1.0, self._publish_diagnostics)
        self._recovery.request(self._live.values.autostart, time.monotonic(), wait=False)
        self._state_topics = StateTopics(self, self._reports.facts())
        self._e_stop_services = EStopServices(
            self, self._e_stop, self._forget_commands, self._state_topics.refresh, self._reports.describe_stop
        )

    # Lifecycle: unconfigured -> (configure: port open) inactive -> (activate: sending) active

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the robot and open the port; a failure is reported and leaves the node unconfigured."""
        self._state_topics.refresh()
        with self._lock:
            try:
                self._configure()
            except SoftSimError as error:
                self._reports.report(str(error))
                return TransitionCallbackReturn.FAILURE
            except Exception as error:
                self._reports.report(f"configure failed ({type(error).__name__}: {error_text(error)})")
                return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send from the board's present pose; refused without a port and while the e-stop is latched."""
        with self._lock:
            driver, refusal = self._session.driver, ""
            if self._e_stop.latched:
                refusal = "activation refused: the e-stop is latched; call ~/clear_e_stop first"
            elif driver is None or not self._session.connected:
                why = self._reports.trouble or "configure first"
                refusal = f"activation refused: no port is open ({why})"
            if refusal or driver is None:
                self.get_logger().error(refusal)
                return TransitionCallbackReturn.FAILURE
            self._forget_commands()  # commands sent while the port was opened
            self._session.start()
            self._reports.trouble = ""
        self.get_logger().info(f"sending to {driver.port} at {1.0 / driver.period:g} Hz")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Move to the safe pose and stop sending; the port stays open."""
        self._state_topics.refresh()
        self._recovery.cancel()
        self._stop_sending()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the port; the last pose sent stays known."""
        self._state_topics.refresh()
        self._recovery.cancel()
        self._disconnect()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Move to the safe pose and close the port for good."""
        self._state_topics.refresh()
        self._recovery.cancel()
        self._disconnect()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to the safe pose, close the port and become unconfigured after an unexpected error."""
        self.get_logger().error("a transition failed unexpectedly; the bridge is unconfigured again")
        self._recovery.cancel()  # recovery would configure any board that is present
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
        """Move to the safe pose and close the port, in any state; a second call does nothing."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._recovery.cancel()
                self._disconnect()
                self._state_topics.refresh()

    def destroy_node(self) -> None:
        """Close, then destroy the node; the e-stop service runs until the port is closed."""
        self.close()
        self._e_stop_services.close()
        super().destroy_node()

    def _configure(self) -> None:
        settings = self._live.values
        before, reports = self._session.driver, self._reports
        driver, reports.calibration = assemble(settings, self._scene, self._e_stop, reports.publish_tilt)
        reports.imu_frame = settings.imu_frame or f"{settings.frame_prefix}effector"
        if before is not None and before.servo_joints == driver.servo_joints:
            driver.motion.resume_from(before.motion.positions)
        self._session.open(driver, find_port(settings.port), settings.open_wait_s)
        self._release_input()
        self._input = CommandInput(self, settings.source, self._active_driver)
        reports.source_topic, reports.trouble = self._input.topic, ""
        self.get_logger().info(
            f"port {driver.port} open, source {settings.source}, calibration {reports.calibration or 'none'};"
            " activate to send"
        )

    def _active_driver(self) -> ServoDriver | None:
        return self._session.driver if self._session.sending else None

    def _stop_sending(self) -> None:
        with self._lock:
            rests = self._session.stop(self._live.values.settle_timeout)
            if not (rests or self._e_stop.latched):
                self.get_logger().warning("the servos have not reached rest; they stay where they are")

    def _disconnect(self) -> None:
        with self._lock:
            self._stop_sending()
            self._session.close(relax=self._live.values.relax_at_end)
            if not self._closed:
                self._release_input()

    def _forget_commands(self) -> None:
        waiting = self._input
        if waiting is not None:
            waiting.forget()

    def _release_input(self) -> None:
        if self._input is not None:
            self._input.close()
        self._input = None

    # Timers

    def _supervise(self) -> None:
        with self._lock:
            if self._closed:
                return
            self._reports.log_events()
            fault = self._session.fault()
            if isinstance(fault, PortError):  # close the port, open it again, and continue as before
                requested: RequestedState = "activate" if self._session.sending else "configure"
                self._session.close()
                self._reports.report(f"{fault}; the bridge tries to open it again")
                self._leave_active()
                self._recovery.request(requested, time.monotonic(), wait=True)
            elif fault is not None:  # a dead thread: the servos hold until the bridge is activated again
                self._session.hold()
                self._reports.report(str(fault))
                self._leave_active()
                self._recovery.cancel()
            if self._recovery.due(time.monotonic()):
                if self._pursue():
                    self._recovery.record_success(time.monotonic())
                else:
                    self._recovery.record_failure(time.monotonic())

    def _leave_active(self) -> None:
        if self.lifecycle_state == "active":
            self.trigger_deactivate()

    def _pursue(self) -> bool:
        """Make one attempt to reach the state that recovery requests; return whether it is finished."""
        requested = self._recovery.requested_state
        if self.lifecycle_state == "unconfigured":
            if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
                return False
        elif self.lifecycle_state == "inactive" and not self._session.connected:
            settings = self._live.values
            try:
                self._session.open_again(settings.port, settings.open_wait_s)
            except PortError as error:
                self._reports.report(str(error))
                return False
            self._reports.reconnects += 1
            self._reports.trouble = ""
            self.get_logger().info(f"port {self._session.port} is open again")
        if requested == "activate" and self.lifecycle_state == "inactive":
            self.trigger_activate()
        return True

    def _publish_diagnostics(self) -> None:
        with self._lock:
            if not self._closed:
                self._reports.diagnose()

    # Parameters

    def _check_parameters(self, names: frozenset[str], settings: BridgeSettings) -> None:
        configured = self.lifecycle_state in ("inactive", "active")
        parameters.check(settings, names, configured=configured)

    def _apply_parameters(self, _: frozenset[str], settings: BridgeSettings) -> None:
        with self._lock:
            driver = self._session.driver
            if driver is not None:
                driver.avoid_byte_100 = settings.avoid_byte_100
                driver.set_timing(settings.motion)


PROGRAM = Program(
    name="servo_bridge",
    about="Writes a robot's joint angles as servo packets to a serial port, through limits and ramps.",
    settings=(BridgeSettings(),),
)


def main(args: Sequence[str] | None = None) -> int:
    """Run the bridge until a signal or the end of its parent process; the servos end in the safe pose.

    Its namespace is the robot's name unless `-r __ns:=/other` is given.

    Returns:
        Exit code: 0 after a normal end, 1 for a parameter that cannot be used, 2 for a wrong command line.
    """
    return run_node(PROGRAM, lambda _: ServoBridge(namespace=parameters.robot_namespace(PROGRAM.name)), args)


if __name__ == "__main__":
    sys.exit(main())
