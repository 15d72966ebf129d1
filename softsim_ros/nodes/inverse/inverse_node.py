"""The node `inverse_controller`: turns goals of the effector into joint commands while it is enabled."""

from __future__ import annotations

import dataclasses
import sys
import time
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool

from softsim_core import RobotDescription
from softsim_core.base import Array, SceneError
from softsim_core.control.inverse import InverseController
from softsim_core.physics.mechanics import Pose
from softsim_node import (
    LATCHED,
    MEASURED,
    NEWEST_ONLY,
    WORLD,
    LiveParameters,
    Program,
    StateTopics,
    answering,
    ending,
    run_node,
    steady_timer,
)
from softsim_ros import FrameSettings, JointReader, JointStates, RobotNode
from softsim_ros.messages import pose_stamped
from softsim_ros.nodes.inverse.control_thread import CommandsOut, ControlThread
from softsim_ros.nodes.inverse.inverse_switch import health
from softsim_ros.nodes.inverse.parameters import ControllerSettings
from softsim_ros.nodes.inverse.plant import (
    SILENT_AFTER_S,
    SimulatedRobot,
    checked_pose,
    unit_quaternion,
)
from softsim_ros.nodes.simulator import RateGate

NODE_NAME = "inverse_controller"
MODEL_POSE_PERIOD_S = 0.05


class InverseControl(RobotNode):
    """Moves one robot's effector to a goal; works with the simulator and with the real robot alike.

    Created as RobotNode describes.

    Raises:
        SoftSimError: the robot is not known or has no effector, or a parameter is not allowed.
    """

    node_name = NODE_NAME
    _control: ControlThread | None = None
    _closed = False

    def _begin(self, robot: RobotDescription) -> None:
        effector = robot.scene.effector
        if effector is None or not robot.joints:
            raise SceneError(
                f"scene {robot.name} has no {'joints' if effector else 'effector'}: inverse control "
                "needs both (keys `joints` and `effector` of its file)"
            )
        self._live = LiveParameters(
            self,
            ControllerSettings.of(robot, self.robot_parameter),
            check=lambda _, settings: settings.over(self._description.inverse),
            apply=self._retune,
        )
        start = self._live.values
        self._description = robot = dataclasses.replace(robot, inverse=start.over(robot.inverse))
        self.get_logger().info(f"building the model of {robot.name}")
        self._joint_reader = JointReader(robot.joints, self.refuse)
        self._model_gate = RateGate(MODEL_POSE_PERIOD_S)
        self._commands = CommandsOut(self, "inverse control", lambda: self._enabled, self.refuse)
        self._model_pose = self.create_publisher(PoseStamped, "~/model_pose", NEWEST_ONLY)
        self._control = ControlThread(
            ending.abandonable(lambda: InverseController(robot, robot.inverse)),
            robot.joints,
            robot.scene.dt,
            self._publish,
            self.refuse,
            self._report_end,
        )
        self._control.feedback = start.feedback
        JointStates(self, SILENT_AFTER_S, self._measure)
        self.create_subscription(Float64, "base_shift", self._on_base_shift, LATCHED)
        self.create_subscription(PoseStamped, "effector_pose", self._on_effector, MEASURED)
        self.create_subscription(Imu, "imu", self._on_imu, MEASURED)
        SimulatedRobot(self, self._on_other_robot, self.refuse)
        self.create_subscription(PoseStamped, "effector_goal", self._on_goal, NEWEST_ONLY)
        self.create_service(SetBool, "~/enable", answering(self.enable))
        steady_timer(self, 1.0, self._report)
        self._control.start()
        self._state_topics = StateTopics(
            self, {"inverse_controller/enabled": lambda: Bool(data=self._enabled)}
        )
        self.get_logger().info(f"ready to control {robot.name}; call ~/enable")

    def close(self) -> None:
        """Stop control, then destroy the node; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        if self._control is not None:
            self._control.close()
        self.destroy_node()

    @property
    def control(self) -> ControlThread:
        """The thread that owns the controller."""
        assert self._control is not None
        return self._control

    @property
    def _enabled(self) -> bool:
        return self.control.is_alive and self.control.status.mode != "off"

    # --- the robot ------------------------------------------------------------------------------------

    def _measure(self, message: JointState) -> None:
        where = self._joint_reader.read(message)
        if where is not None:
            self.control.plant = self.control.plant.with_joints(where, time.monotonic())

    def _on_base_shift(self, message: Float64) -> None:
        if np.isfinite(message.data):
            self.control.plant = dataclasses.replace(self.control.plant, base_shift=message.data)

    def _on_other_robot(self, message: str) -> None:
        was_on = self._enabled
        self.control.set_foreign(message)
        if not was_on:  # otherwise the end of control is reported
            self.get_logger().warning(message or "the simulator runs the robot of the model again")
        self._state_topics.refresh()

    def _on_effector(self, message: PoseStamped) -> None:
        pose = checked_pose(message, self.frames, "effector_pose")
        self.control.plant = self.control.plant.with_effector(pose, time.monotonic())

    def _on_imu(self, message: Imu) -> None:
        turn = unit_quaternion(message.orientation, "imu")
        self.control.plant = self.control.plant.with_imu(turn, time.monotonic())

    # --- goals and commands ---------------------------------------------------------------------------

    def _on_goal(self, message: PoseStamped) -> None:
        self.control.set_goal(checked_pose(message, self.frames, "goal"))

    def _publish(self, command: Array, model: Pose) -> None:
        """Publish a command and periodically the model's pose; called from the control thread."""
        if self._closed:
            return
        try:
            self._commands.publish(command)
            if self._model_gate.passes(time.monotonic()):
                stamp = self.get_clock().now().to_msg()
                self._model_pose.publish(pose_stamped(stamp, WORLD, model.position, model.quaternion_xyzw))
        except Exception:
            if self.context.ok():
                raise
            # Ctrl-C and SIGTERM invalidate the publishers before this thread can be stopped

    def enable(self, enabled: bool) -> str:
        """Control the effector from the next tick on, or release the command topic; return a message.

        Raises:
            SoftSimError: see ControlThread.enable.
        """
        try:
            if not enabled:
                self.control.disable()
                return "off: the command topic is free"
            self.control.enable(self._live.values.base_shift)
            return "on: the effector stays where it is until a goal comes"
        finally:
            self._state_topics.refresh()
            self._report()

    # --- parameters, diagnostics ----------------------------------------------------------------------

    def _retune(self, _: frozenset[str], settings: ControllerSettings) -> None:
        tuned = settings.over(self._description.inverse)
        if tuned != self.control.settings:
            self.control.tune(tuned)
        self.control.feedback = settings.feedback

    def _report_end(self, message: str) -> None:
        if self.context.ok() and not self._closed:
            self.get_logger().error(message)

    def _report(self) -> None:
        control = self.control
        level, message, values = health(
            control.status, control.is_alive, control.feedback, self._commands.foreign
        )
        self._publish_health(level, message, values)


PROGRAM = Program(
    name="inverse_controller",
    about="Brings a robot's effector to a goal.",
    settings=(ControllerSettings(), FrameSettings()),
)

main = partial(run_node, PROGRAM, lambda _: InverseControl())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
