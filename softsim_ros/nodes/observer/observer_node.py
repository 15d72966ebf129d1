"""The node `observer`: estimates shape, effector pose and contacts from joint states and sensors."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped, WrenchStamped
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float32MultiArray, Float64, String
from std_srvs.srv import Trigger

from softsim_core import RobotDescription
from softsim_core.base import Array, ConfigError, SolverDivergedError
from softsim_core.control.observer import (
    Estimate,
    Observer,
    ObserverSettings,
    Sensor,
    effector_sensor,
    marker_sensors,
)
from softsim_core.physics.mechanics import Pose
from softsim_core.simulation import Simulation
from softsim_node import (
    LATCHED,
    MEASURED,
    NEWEST_ONLY,
    WORLD,
    Program,
    RobotFrames,
    StateTopics,
    answering,
    declare,
    ending,
    parameter,
    run_node,
    steady_timer,
)
from softsim_ros import FrameSettings, JointReader, JointStates, RobotNode, RobotSettings
from softsim_ros.messages import OK, WARN, header, message_array, pose_stamped
from softsim_ros.nodes.inverse import FARTHEST_M, check_frame, checked_pose, unit_quaternion
from softsim_ros.nodes.simulator import Publications

EFFECTOR: Final = "effector"
IMU: Final = "imu"
MARKER: Final = "marker_"

_OWN: Final = ObserverSettings()


@dataclass(frozen=True, kw_only=True)
class ObserverParameters(RobotSettings):
    """Values of the parameters; those of `ObserverSettings` have the same names."""

    pose_topic: str = parameter("effector_pose", "Measured pose of the effector; empty: none", fixed=True)
    marker_topic: str = parameter("markers", "Measured places of markers, in their order", fixed=True)
    imu_topic: str = parameter("imu", "Measured tilt of the effector; empty: none", fixed=True)
    marker_places: str = parameter(
        "", "Where the markers sit on the robot at rest, as x y z; x y z and so on", unit="m", fixed=True
    )
    position_noise: float = parameter(
        1e-4, "Noise of measured places along an axis", unit="m", within=(1e-6, 0.1), fixed=True
    )
    rotation_noise: float = parameter(
        5e-3, "Noise of measured rotations about an axis", unit="rad", within=(1e-5, 1.0), fixed=True
    )
    base_shift: float = parameter(
        0.0,
        "Shift of the joint bases if no simulator publishes base_shift: how the robot is mounted",
        unit="m",
        within=(-1.0, 1.0),
        fixed=True,
    )
    mesh_rate: float = parameter(
        30.0, "Messages per second on mesh/points", unit="Hz", within=(0.0, 100.0), fixed=True
    )
    joint_offset: float = parameter(
        _OWN.joint_offset, "How far zeros of joints may be off", unit="rad", within=(0.0, 1.0), fixed=True
    )
    load_share: float = parameter(
        _OWN.load_share, "Share by which weight, or softness, may be off", within=(0.0, 10.0), fixed=True
    )
    push: float = parameter(
        _OWN.push,
        "Steady force on the effector, such as of a tool",
        unit="N",
        within=(0.0, 100.0),
        fixed=True,
    )
    sensor_offset: float = parameter(
        _OWN.sensor_offset,
        "How far sensors may be from where they are said to be",
        unit="m",
        within=(0.0, 0.1),
        fixed=True,
    )
    sensor_turn: float = parameter(
        _OWN.sensor_turn, "How far they may be turned", unit="rad", within=(0.0, 1.0), fixed=True
    )
    latency: float = parameter(
        _OWN.latency, "How late or early sensors may be", unit="s", within=(0.0, 1.0), fixed=True
    )
    false_contacts: float = parameter(
        _OWN.false_contacts, "Expected false contacts per hour", unit="1/h", within=(1e-9, 3600.0), fixed=True
    )

    @property
    def settings(self) -> ObserverSettings:
        """Assumed errors of the model.

        Raises:
            SoftSimError: a value is not allowed.
        """
        names = {field.name for field in dataclasses.fields(ObserverSettings)}
        own = [field.name for field in dataclasses.fields(self) if field.name in names]
        return ObserverSettings(**{name: getattr(self, name) for name in own})

    @property
    def places(self) -> Array:
        """Positions of the markers in [m], shape (k, 3).

        Raises:
            ConfigError: the text does not have three numbers for each.
        """
        rows = [row.split() for row in self.marker_places.split(";") if row.strip()]
        try:
            places = np.array(rows, dtype=float).reshape(-1, 3)
        except ValueError:
            places = np.full((1, 3), np.nan)
        if not np.isfinite(places).all():
            raise ConfigError(
                "observer",
                "parameter marker_places",
                f"{self.marker_places!r} is no list of places; give three numbers in m for each, such as "
                "0.01 0 0.03; 0 0 0.03",
            )
        return places

    def sensors(self, model: Simulation) -> Sequence[Sensor]:
        """Return the sensors, named EFFECTOR, IMU and MARKER with a number; only markers without an effector.

        Raises:
            SoftSimError: no body is at a marker's position.
        """
        sensors: list[Sensor] = []
        if model.scene.effector is not None:
            where, turn = self.position_noise, self.rotation_noise
            sensors.append(effector_sensor(model, EFFECTOR, where, turn))
            sensors.append(effector_sensor(model, IMU, np.inf, turn, tilt_only=True))
        return [*sensors, *marker_sensors(model, self.places, self.position_noise)]


NODE_NAME: Final = "observer"
SILENT_AFTER_S: Final = 1.0
"""Time in [s] without joint states after which the observer stops and waits."""

REPORT_S: Final = 1.0


class ObserverNode(RobotNode):
    """A model that runs beside a robot and is corrected by its sensors; created as RobotNode describes.

    Raises:
        SoftSimError: the robot is not known, or a parameter is not allowed.
    """

    node_name = NODE_NAME

    def _begin(self, robot: RobotDescription) -> None:
        values = declare(self, ObserverParameters(robot=self.robot_parameter, base_shift=robot.start_shift))
        self.get_logger().info(f"building the model of {robot.name}")
        self._observer = ending.abandonable(lambda: Observer(robot, values.sensors, values.settings))
        self._markers = len(values.places)
        self._base_shift = values.base_shift
        self._joints: Array | None = None
        self._joints_at = -np.inf
        self._running, self._message = False, "waits for joint states"
        self._measured: dict[str, object] = {}
        self._estimate: Estimate | None = None
        self._tick_ms = 0.0
        self._reader = JointReader(robot.joints, self.refuse)
        frames = RobotFrames(self.frames.of(f"{NODE_NAME}/"))
        self._publications = Publications(
            self, self._observer.model, frames, mesh_rate=values.mesh_rate, below="~/"
        )
        self._believed = self.create_publisher(
            PoseWithCovarianceStamped, "~/effector_pose_with_covariance", 5
        )
        self._wrench = self.create_publisher(WrenchStamped, "~/contact_wrench", 5)
        self._deviation = self.create_publisher(Float32MultiArray, "~/mesh/deviation", NEWEST_ONLY)
        self._subscribe(values)
        self.create_service(Trigger, "~/forget", answering(self._forget))
        steady_timer(self, self._observer.dt, self._tick)
        steady_timer(self, REPORT_S, self._report)
        self._state_topics = StateTopics(
            self,
            {
                "observer/touched": lambda: Bool(data=self._touched),
                "observer/verdict": lambda: String(data=self._verdict),
            },
        )

    def _subscribe(self, values: ObserverParameters) -> None:
        def listen(kind: type, topic: str, callback: object) -> None:
            if topic:
                self.create_subscription(kind, topic, callback, MEASURED)

        topics = "applied_joint_states", "joint_states"  # simulated ones only where no bridge reports any
        JointStates(self, SILENT_AFTER_S, self._take_joints, topics)
        self.create_subscription(Float64, "base_shift", self._on_base_shift, LATCHED)
        if self._observer.unknowns.touch.start < self._observer.unknowns.acting:
            listen(PoseStamped, values.pose_topic, self._on_pose)
            listen(Imu, values.imu_topic, self._on_imu)
        if self._markers:
            listen(PoseArray, values.marker_topic, self._on_markers)

    @property
    def _touched(self) -> bool:
        return self._running and self._estimate is not None and self._estimate.touch is not None

    @property
    def _verdict(self) -> str:
        return self._estimate.verdict if self._running and self._estimate is not None else "waiting"

    # --- messages -------------------------------------------------------------------------------------

    def _take_joints(self, message: JointState) -> None:
        joints = self._reader.read(message)
        if joints is not None and np.isfinite(joints).all():
            self._joints, self._joints_at = joints, time.monotonic()

    def _on_base_shift(self, message: Float64) -> None:
        if np.isfinite(message.data):
            self._base_shift = message.data

    def _on_pose(self, message: PoseStamped) -> None:
        self._measured[EFFECTOR] = checked_pose(message, self.frames, "measured pose")

    def _on_imu(self, message: Imu) -> None:
        if message.orientation_covariance[0] == -1.0:
            self.refuse("imu refused: it has no orientation (its first covariance is -1)")
            return
        self._measured[IMU] = Pose(np.full(3, np.nan), unit_quaternion(message.orientation, "imu"))

    def _on_markers(self, message: PoseArray) -> None:
        check_frame("markers", message.header.frame_id, self.frames)
        if len(message.poses) != self._markers:
            self.refuse(
                f"markers refused: {len(message.poses)} places for {self._markers} markers (parameter "
                "marker_places); give NaN for those that are not seen"
            )
            return
        for number, pose in enumerate(message.poses):
            place = np.array([pose.position.x, pose.position.y, pose.position.z])
            if (np.abs(place) <= FARTHEST_M).all():  # otherwise the marker is not visible
                self._measured[f"{MARKER}{number}"] = place

    def _forget(self) -> str:
        self._running = False
        return "what was learned is forgotten; the observer restarts"

    # --- time -----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        begun = time.monotonic()
        if self._joints is None or begun - self._joints_at > SILENT_AFTER_S:
            self._stop("waits for joint states")
            return
        measured, self._measured = self._measured, {}
        try:
            if not self._running:
                self._observer.start(self._joints, self._base_shift)
                self._running = True
            estimate = self._observer.step(self._joints, measured, self._base_shift)
        except SolverDivergedError as error:
            self._stop(f"restarts: {error}")
            return
        if estimate.message and estimate.message != self._message:
            self.get_logger().warning(estimate.message, throttle_duration_sec=10.0)
        self._estimate, self._message = estimate, estimate.message
        self._state_topics.refresh()
        self._publish(estimate)
        self._tick_ms += 0.05 * (1e3 * (time.monotonic() - begun) - self._tick_ms)

    def _stop(self, message: str) -> None:
        self._running, self._message = False, message
        self._measured.clear()

    def _publish(self, estimate: Estimate) -> None:
        self._publications.publish(self._observer.model, whole=False)
        stamp = self.get_clock().now().to_msg()
        if estimate.effector is not None:
            message = PoseWithCovarianceStamped(header=header(stamp, WORLD))
            pose = estimate.effector
            message.pose.pose = pose_stamped(stamp, WORLD, pose.position, pose.quaternion_xyzw).pose
            message.pose.covariance = estimate.effector_covariance.ravel()
            self._believed.publish(message)
        if estimate.touch is not None:
            wrench = WrenchStamped(header=header(stamp, WORLD))
            force, moment = wrench.wrench.force, wrench.wrench.torque
            force.x, force.y, force.z = map(float, estimate.touch.force)
            moment.x, moment.y, moment.z = map(float, estimate.touch.moment)
            self._wrench.publish(wrench)

    def _report(self) -> None:
        estimate = self._estimate
        if self._running and self._deviation.get_subscription_count():
            values = self._observer.model.visual_values(self._observer.deviation())
            self._deviation.publish(Float32MultiArray(data=message_array(values, "f")))
        details: dict[str, object] = {"verdict": self._verdict, "tick_ms": round(self._tick_ms, 2)}
        if self._running and estimate is not None:
            details |= {
                "consistency": round(estimate.consistency, 3),
                "coordinates_used": estimate.used,
                "left_out": ", ".join(estimate.left_out),
                "touched": self._touched,
            }
            offsets = self._observer.state_estimate.mean[self._observer.unknowns.offsets]
            names = self._observer.model.joint_names
            details |= {f"offset_{name}": float(x) for name, x in zip(names, offsets, strict=True)}
        well = self._verdict in ("good", "learning")
        self._publish_health(OK if well else WARN, self._message or self._verdict, details)


PROGRAM = Program(
    name="observer",
    about="Says from sensors what shape a robot has, whether its model is right, and what touches it.",
    settings=(ObserverParameters(), FrameSettings()),
)

main = partial(run_node, PROGRAM, lambda _: ObserverNode())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
