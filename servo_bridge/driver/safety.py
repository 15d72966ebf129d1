"""The motion that the servos are commanded: limits, ramps, hold, rest and the software e-stop. No I/O.

All times are seconds of one steady clock that the caller reads; angles are radians, in packet order.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from servo_bridge.driver.servo import byte_to_angle, pulse_to_angle, within
from softsim_core.base import SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import BusServo, Servo


class EStop:
    """A latch that any thread sets and clears without waiting for another thread.

    Args:
        hurry: Called at each latching, so that the packet that carries the stop is sent at once.

    Attributes:
        count: Number of latchings; shows a latching that was cleared between two checks.
    """

    def __init__(self, hurry: Callable[[], None] = lambda: None) -> None:
        self.count = 0
        self._hurry = hurry
        self._numbers = itertools.count(1)
        self._latched, self._acknowledged = threading.Event(), threading.Event()

    @property
    def latched(self) -> bool:
        """Whether motion is blocked."""
        return self._latched.is_set()

    def latch(self) -> None:
        """Stop every servo with a packet that is sent at once, until `clear`."""
        self._acknowledged.clear()
        self.count = next(self._numbers)
        self._latched.set()
        self._hurry()

    def acknowledge(self) -> None:
        """Acknowledge the latch: the board was commanded to stop, or there is nothing to send."""
        self._acknowledged.set()

    def wait_acknowledged(self, timeout_s: float) -> bool:
        """Wait until the packet after `latch` was sent; return False if none is written within the time."""
        return self._acknowledged.wait(timeout_s)

    def clear(self) -> None:
        """Allow motion again; nothing moves before the next command."""
        self._latched.clear()


MotionMode: TypeAlias = Literal["track", "hold", "rest", "e_stop"]

# Top speed in [rad/s] of a servo whose joint sets none; a small hobby servo follows it under load
SERVO_SPEED = math.radians(200.0)

# Top acceleration in [rad/s^2] of a servo whose joint sets none: top speed after 0.1 s
SERVO_ACCELERATION = 10.0 * SERVO_SPEED


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSettings:
    """Timing of the motion.

    Attributes:
        hold_timeout_s: Time in [s] without a command after which the servos stop where they are.
        rest_timeout_s: Time in [s] without a command after which they move slowly to the rest pose.
        rest_speed: Speed of that slow move in [rad/s]; a joint's own limit applies as well.
        longest_step_s: Most time in [s] that one tick moves for: time lost between ticks is not caught up.
    """

    hold_timeout_s: float = 0.5
    rest_timeout_s: float = 2.0
    rest_speed: float = 0.5
    longest_step_s: float = 0.04


def servo_limits(servo: Servo, limits: JointLimits) -> JointLimits:
    """Return the joint's limits, narrowed to the angles that the servo's bytes or pulses can express.

    Speed and acceleration are finite: they are those of a small hobby servo if the joint sets none.

    Raises:
        SceneError: no angle is left, or the rest angle lies outside.
    """
    if isinstance(servo, BusServo):
        narrow = within(servo, limits)
        ends = sorted(pulse_to_angle(pulse, servo) for pulse in (narrow.pulse_min, narrow.pulse_max))
        return _finite(ends[0], ends[1], limits)
    ends = sorted(byte_to_angle(value, servo) for value in (servo.byte_min, servo.byte_max))
    lower, upper = max(limits.lower, ends[0]), min(limits.upper, ends[1])
    rest = rest_angle(servo)
    if not lower <= rest <= upper:
        raise SceneError(
            f"servo {servo.joint}: rest_byte {servo.rest_byte} is {rest:.4f} rad, outside what limits"
            f" and byte range allow, [{lower:.4f}, {upper:.4f}] rad; change rest_byte or the limits"
        )
    return _finite(lower, upper, limits)


def rest_angle(servo: Servo) -> float:
    """Return the joint angle in [rad] of a servo's rest byte or rest pulse."""
    if isinstance(servo, BusServo):
        return pulse_to_angle(servo.rest_pulse, servo)
    return byte_to_angle(servo.rest_byte, servo)


def _finite(lower: float, upper: float, limits: JointLimits) -> JointLimits:
    return JointLimits(
        lower,
        upper,
        SERVO_SPEED if math.isinf(limits.speed) else limits.speed,
        SERVO_ACCELERATION if math.isinf(limits.acceleration) else limits.acceleration,
    )


class ServoMotion:
    """Positions of the servos over time: from the last known pose, within limits, to the newest command.

    Modes: "track" follows a fresh command; "hold" stays; "rest" moves slowly to the rest pose and stays
    there; "e_stop" stays while the e-stop is latched, whatever is commanded. After an e-stop "hold" lasts
    until the first command given after the clearing.

    Args:
        names: Joint names, for messages.
        limits: Limits of each servo; see `servo_limits`.
        rest: Rest angle of each servo in [rad], within the limits; also the first pose.
        settings: Timing; may be replaced at any time.
        e_stop: The latch, checked with every step and command; None creates one.

    Attributes:
        top_speed: Speed limit of the board in [rad/s], which applies in addition to each joint's own.
        clipped: Number of commands beyond the limits. A repeated command counts once; a simulated robot
            before its start animation repeats joint states outside of them.
    """

    def __init__(
        self,
        names: Sequence[str],
        limits: Sequence[JointLimits],
        rest: Sequence[float],
        settings: MotionSettings | None = None,
        e_stop: EStop | None = None,
    ) -> None:
        self.names, self.limits, self.rest = tuple(names), tuple(limits), tuple(rest)
        self.settings = settings or MotionSettings()
        self.e_stop = e_stop or EStop()
        self.top_speed = math.inf
        self.positions: tuple[float, ...] = self.rest
        self.velocities: tuple[float, ...] = (0.0,) * len(self.rest)
        self.clipped = 0
        self._beyond: tuple[float, ...] | None = None  # newest command, if it was beyond the limits
        self._target: tuple[float, ...] | None = None
        self._command_time: float | None = None
        self._since = 0.0  # time of the last command, or of the start
        self._last_step: float | None = None  # None after a start: the first step moves nothing
        self._mode: MotionMode = "rest"
        self._stops_handled = self.e_stop.count
        self._parked = self.e_stop.latched  # after an e-stop: until the next command

    @property
    def mode(self) -> MotionMode:
        """What the last step did."""
        return "e_stop" if self.e_stop.latched else self._mode

    @property
    def at_rest(self) -> bool:
        """Whether every servo is exactly at its rest angle."""
        return self.positions == self.rest

    @property
    def standing(self) -> bool:
        """Whether no servo moved with the last step."""
        return not any(self.velocities)

    def goal(self, now: float) -> tuple[float, ...]:
        """Return the angles in [rad] that the servos move to; without a fresh command, where they are."""
        if self._target is None or now - self._since > self.settings.hold_timeout_s:
            return self.positions
        return self._target

    def command_age(self, now: float) -> float | None:
        """Return the time in [s] since the newest accepted command; None before the first."""
        return None if self._command_time is None else now - self._command_time

    def start(self, now: float) -> None:
        """Restart from the last known pose; earlier commands do not count, nor does an earlier e-stop."""
        self._check_e_stop()
        self.forget(now)
        self._parked = self.e_stop.latched

    def forget(self, now: float) -> None:
        """Stop at the last known pose; earlier commands do not count."""
        self._target, self._command_time = None, None
        self._since = now
        self._mode = "hold"
        self._stand()

    def resume_from(self, positions: Sequence[float]) -> None:
        """Take over a pose in [rad] that is known from elsewhere, clamped to the limits, and stop there."""
        self.positions = tuple(
            limits.clamp(position) for limits, position in zip(self.limits, positions, strict=True)
        )
        self._stand()

    def command(self, angles_rad: Sequence[float], now: float) -> None:
        """Set a new target of finite angles in [rad], clamped to the limits; only the newest counts.

        The caller has checked the angles. While the e-stop is latched the command is ignored.
        """
        values = tuple(angles_rad)
        target = tuple(limits.clamp(value) for limits, value in zip(self.limits, values, strict=True))
        if self._check_e_stop():
            return
        beyond = values if target != values else None
        self.clipped += beyond is not None and beyond != self._beyond
        self._beyond = beyond
        self._target, self._parked = target, False
        self._command_time = self._since = now

    def step(self, now: float) -> tuple[float, ...]:
        """Return the positions in [rad] to send at `now`; no servo exceeds its limits since the last step."""
        if self._check_e_stop():
            return self.positions
        settings, silence = self.settings, now - self._since
        if self._target is not None and silence <= settings.hold_timeout_s:
            self._mode = "track"
            return self._move(self._target, math.inf, now)
        if self._parked or silence <= max(settings.rest_timeout_s, settings.hold_timeout_s):
            self._mode = "hold"
            return self._brake(now)
        self._mode = "rest"
        return self._move(self.rest, settings.rest_speed, now)

    def step_to_rest(self, now: float) -> tuple[float, ...]:
        """Return positions like `step`, but towards the rest pose at the limits' speed; an e-stop holds."""
        if self._check_e_stop():
            return self.positions
        self._mode, self._target = "rest", None
        return self._move(self.rest, math.inf, now)

    def brake(self, now: float) -> tuple[float, ...]:
        """Return the positions in [rad] to send at `now` while braking at the limit of acceleration."""
        return self.positions if self._check_e_stop() else self._brake(now)

    def _check_e_stop(self) -> bool:
        """Return whether the e-stop is latched; a latching since the last check ends every motion."""
        latched = self.e_stop.latched
        if self.e_stop.count != self._stops_handled:
            self._stops_handled = self.e_stop.count
            self._target, self._command_time, self._parked = None, None, True
            self._stand()
        return latched

    def _move(self, target: Sequence[float], top_speed: float, now: float) -> tuple[float, ...]:
        dt = self._measure_step(now)
        return self._take(
            replace(limits, speed=min(limits.speed, top_speed, self.top_speed)).step(
                position, velocity, goal, dt
            )
            for limits, position, velocity, goal in zip(
                self.limits, self.positions, self.velocities, target, strict=True
            )
        )

    def _brake(self, now: float) -> tuple[float, ...]:
        dt = self._measure_step(now)
        return self._take(
            limits.brake(position, velocity, dt)
            for limits, position, velocity in zip(self.limits, self.positions, self.velocities, strict=True)
        )

    def _measure_step(self, now: float) -> float:
        passed = 0.0 if self._last_step is None else now - self._last_step
        self._last_step = now
        return min(max(passed, 0.0), self.settings.longest_step_s)  # time lost between ticks is not caught up

    def _take(self, states: Iterable[tuple[float, float]]) -> tuple[float, ...]:
        self.positions, self.velocities = zip(*states, strict=True)
        return self.positions

    def _stand(self) -> None:
        self.velocities, self._last_step = (0.0,) * len(self.rest), None
