"""From the bridge's settings to a driver: robot, calibration and protocol, or one sentence why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from servo_bridge.calibration_file import calibrated_robot, file_for
from servo_bridge.driver import ServoDriver
from servo_bridge.e_stop import EStop
from servo_bridge.named_files import load_robot, read_named
from servo_bridge.parameters import BridgeSettings
from servo_bridge.protocols import TiltReading
from softsim_core.scene.robot import RobotDescription


@dataclass(frozen=True, slots=True)
class Assembled:
    """A driver that is not connected yet.

    Attributes:
        driver: The driver.
        calibration: File of the servos' calibration; empty without one.
        imu_frame: Frame of the topic imu.
    """

    driver: ServoDriver
    calibration: str
    imu_frame: str


def assemble(
    settings: BridgeSettings,
    scene: RobotDescription | None,
    e_stop: EStop,
    on_tilt: Callable[[TiltReading], None],
) -> Assembled:
    """A driver as the settings say.

    Args:
        settings: The bridge's.
        scene: Robot already loaded; None loads the one of the settings.
        e_stop: The latch that the driver looks at.
        on_tilt: Called with every reading of a board's IMU.

    Raises:
        SoftSimError: robot or calibration cannot be read, or the robot has no board that can be driven so.
    """
    robot = load_robot(settings.robot) if scene is None else scene
    calibration = read_named(
        "calibration", settings.calibration, lambda: file_for(settings.calibration, robot.name)
    )
    if calibration is not None:
        file = calibration
        robot = read_named("calibration", str(file), lambda: calibrated_robot(robot, file))
    driver = ServoDriver(
        robot,
        settings=settings.motion,
        rate=settings.rate or None,
        avoid_byte_100=settings.avoid_byte_100,
        protocol=settings.protocol,
        baud_rate=settings.baud_rate or None,
        on_tilt=on_tilt,
        e_stop=e_stop,
    )
    return Assembled(driver, str(calibration or ""), settings.imu_frame or f"{settings.frame_prefix}effector")
