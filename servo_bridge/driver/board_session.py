"""A board while its port is open: the driver, its thread, and recovery after a lost port. No ROS.

One thread opens, starts, stops and closes; the thread that ticks takes none of its locks. No call waits for a
port that blocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from random import Random
from typing import Literal, TypeAlias

from servo_bridge import PortError, WriterError
from servo_bridge.driver.driver import ServoDriver
from servo_bridge.driver.ports import find_same_device, stable_name, usb_identity
from servo_bridge.driver.writer import HangDetector, PeriodFigures, PeriodicThread
from softsim_node import error_text

RequestedState: TypeAlias = Literal["none", "configure", "activate"]
DELAYS_S = (0.5, 1.0, 2.0, 4.0, 5.0)  # delays between attempts in [s]; the last one repeats

# Time in [s] after which a reached state counts as stable; a state lost earlier continues the back-off
PROVEN_S = 5.0


class Recovery:
    """A requested state, and a back-off between the attempts to reach it; the time is passed in.

    Args:
        jitter: Each delay is longer or shorter by up to this fraction, so that several bridges do not retry
            in step.
        random: Source of the jitter.
    """

    def __init__(self, jitter: float = 0.0, random: Random | None = None) -> None:
        self._jitter, self._random = jitter, random or Random()
        self.requested_state: RequestedState = "none"
        self.tries = 0
        self._next_try = 0.0
        self._reached: float | None = None

    def request(self, state: RequestedState, now: float, *, wait: bool) -> None:
        """Request a state; the first attempt is due at once, or after a delay.

        The delay is the first of DELAYS_S. If the state reached before was lost within PROVEN_S, the back-off
        continues instead.
        """
        flapping = self._reached is not None and now - self._reached < PROVEN_S
        self.requested_state, self._reached = state, None
        if not (wait and flapping):
            self.tries = 0
        self._next_try = now
        if wait:
            self.record_failure(now)

    def record_success(self, now: float) -> None:
        """Record that the requested state was reached at `now`."""
        self.requested_state, self._reached = "none", now

    def cancel(self) -> None:
        """Withdraw the request."""
        self.requested_state = "none"

    def due(self, now: float) -> bool:
        """Return whether an attempt is due."""
        return self.requested_state != "none" and now >= self._next_try

    def record_failure(self, now: float) -> None:
        """Record a failed attempt and lengthen the delay before the next one."""
        delay = DELAYS_S[min(self.tries, len(DELAYS_S) - 1)]
        self._next_try = now + delay * (1.0 + self._jitter * self._random.uniform(-1.0, 1.0))
        self.tries += 1


LOOK_PERIOD_S = 0.1  # interval in [s] at which a waiting call checks whether the thread has ended
# Time in [s] beyond its limit that settling is waited for; covers braking and the rest packets
SETTLING_MARGIN_S = 2.0


class BoardSession:
    """Sends packets at the driver's rate as long as a port is open.

    Args:
        sent: Called in the thread that ticks, after each tick that commanded a pose.

    Attributes:
        driver: The newest driver, also after its port was closed, since its last pose stays known; None at
            first.
        sending: Whether commands are followed; true from `start` to `stop`.
    """

    def __init__(self, sent: Callable[[ServoDriver], None]) -> None:
        self.driver: ServoDriver | None = None
        self.sending = False
        self._sent = sent
        self._writer: PeriodicThread | None = None  # while the port is open
        self._watch: HangDetector | None = None  # of that thread
        self._stable_port = ""  # link to the device that survives a new port number; empty: none
        self._usb = ""  # identity that the port's USB chip reports; empty: none

    @property
    def connected(self) -> bool:
        """Whether a port is open."""
        return self.driver is not None and self.driver.connected

    @property
    def port(self) -> str:
        """Name of the open port; empty without one."""
        return "" if self.driver is None else self.driver.port

    def fault(self) -> PortError | WriterError | None:
        """Return why packets are no longer sent: a lost port, or a dead or hanging thread; None if they are.

        A hang is only found if this is called several times per second.
        """
        if self._watch is not None and self._watch.look():
            return WriterError(
                f"the thread that sends packets hangs ({self.port} blocks, or the board's protocol does); the"
                " port was abandoned, and the servos hold or rest as their board does in silence; plug it in"
                " again, cleanup and configure"
            )
        failure = None if self._writer is None else self._writer.failure
        if failure is None or isinstance(failure, PortError):
            return failure
        return WriterError(
            f"the thread that sends packets has ended ({type(failure).__name__}: {error_text(failure)});"
            " the servos hold; activate the bridge again"
        )

    def open(self, driver: ServoDriver, port: str, open_wait_s: float) -> None:
        """Open a port, store the device names that survive a renumbering, and start ticks that only listen.

        Raises:
            PortError: it cannot be opened.
        """
        driver.connect(port, open_wait_s)
        self.driver = driver
        self._stable_port, self._usb = stable_name(port), usb_identity(port)
        driver.stand_by()
        self._start_writer(driver)

    def open_again(self, port: str, open_wait_s: float) -> None:
        """Open the port of the same board again, whatever its number is now.

        Before the first `open` nothing happens. No other board is driven: the USB chip has to report the same
        identity as before, and the board has to report the identity that it reported before. A port without a
        USB chip, such as a pseudo-terminal, is not opened again once a board without a number was driven on
        it. If such a port was lost before a board was identified or driven, only a board that identifies
        itself is driven; silence is refused.

        Args:
            port: Name from the user; empty selects the one board that is plugged in.
            open_wait_s: Quiet time after opening in [s].

        Raises:
            PortError: the board is missing or cannot be distinguished from others, or its port cannot be
                opened.
        """
        driver = self.driver
        if driver is None:
            return
        met = driver.met
        has_port_identity = bool(self._usb or self._stable_port)
        has_identity = (driver.may_speak and not driver.moved) if met is None else bool(met.identity)
        if not (has_port_identity or has_identity):
            raise PortError(
                port,
                f"whether the board on {port} is still the one that was configured is unknown (it has"
                " reported no number, and its port has no USB identity), so it is not commanded; check it,"
                " then cleanup and configure",
            )
        name = find_same_device(port, self._stable_port, self._usb)
        driver.connect(name, open_wait_s, again=True, silent_allowed=has_port_identity)
        if usb_identity(name) != self._usb:
            driver.disconnect()
            raise PortError(name, f"another device is on {name}; plug in the one that was configured")
        driver.stand_by()
        self._start_writer(driver)

    def start(self) -> None:
        """Start to send from the board's present pose; a thread that died is replaced."""
        if self.driver is None:
            return
        self.driver.start()
        self.sending = True
        if self._writer is None:
            self._start_writer(self.driver)

    def stop(self, settle_timeout_s: float) -> bool:
        """Settle the servos at rest, then only listen; an e-stop, a lost port or a dead thread ends the wait.

        Returns:
            True if the servos are at rest, or were not to be moved at all; False if they stopped on the way.
        """
        driver, writer = self.driver, self._writer
        if not self.sending or driver is None:
            return True
        self.sending = False
        if writer is None or not driver.begin_settling(settle_timeout_s):
            driver.stand_by()
            return True
        end = time.monotonic() + settle_timeout_s + SETTLING_MARGIN_S
        while not driver.settled.wait(LOOK_PERIOD_S):
            if self.fault() is not None or time.monotonic() > end:
                driver.stand_by()
        return driver.arrived

    def hold(self) -> None:
        """Stop the ticks and command the board to hold, if it has that ability; close a port that blocks."""
        self.sending = False
        hangs = self._watch is not None and self._watch.hangs
        self._end_writer()
        if self.driver is None:
            return
        if hangs:
            self.driver.disconnect()
        else:
            self.driver.stand_by()
            self.driver.hold_board()

    def close(self, *, relax: bool = False) -> None:
        """Close the port; call `stop` before. `relax`: switch the pulses off first, as `disconnect` does."""
        self.sending = False
        self._end_writer()
        if self.driver is not None:
            self.driver.disconnect(relax=relax)

    def hurry(self) -> None:
        """Send the next packet at once; callable from any thread."""
        writer = self._writer
        if writer is not None:
            writer.hurry()

    def figures(self) -> PeriodFigures | None:
        """Return how regularly packets are sent; None while none are."""
        return self._writer.figures() if self._writer is not None and self.sending else None

    def _start_writer(self, driver: ServoDriver) -> None:
        self._end_writer()

        def tick() -> None:
            if driver.tick() is not None and driver.connected:  # it may return late, from an abandoned port
                self._sent(driver)

        self._writer = PeriodicThread(tick, driver.period)
        self._watch = HangDetector(self._writer)

    def _end_writer(self) -> None:
        """End the thread; a thread that hangs is abandoned."""
        writer, self._writer, self._watch = self._writer, None, None
        if writer is not None:
            writer.stop()
            writer.join()
