"""A board while its port is open: the driver, its thread, recovery after a lost port.

No ROS. One thread opens, starts, stops and closes; the thread that ticks takes no lock of it. Nobody waits
for a port that blocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from random import Random
from typing import Literal, TypeAlias

from servo_bridge.driver.driver import ServoDriver
from servo_bridge.driver.ports import find_again, stable_name, usb_identity
from servo_bridge.driver.writer import HangWatch, PeriodFigures, PeriodicThread
from servo_bridge.errors import PortError, WriterError
from softsim_node.text import sentence

Wish: TypeAlias = Literal["none", "configure", "activate"]

DELAYS_S = (0.5, 1.0, 2.0, 4.0, 5.0)
"""Waiting times between tries in [s]; the last one repeats."""


PROVEN_S = 5.0
"""A state that lasted for so long in [s] counts as reached; one lost earlier goes on with the back-off."""


class Recovery:
    """A wished state and a back-off between the tries to reach it, on a steady clock that is passed in.

    Args:
        jitter: Each delay is longer or shorter by up to this fraction, so that several bridges part.
        random: Where the jitter comes from.
    """

    def __init__(self, jitter: float = 0.0, random: Random | None = None) -> None:
        self._jitter, self._random = jitter, random or Random()
        self.wish: Wish = "none"
        self.tries = 0
        self._next_try = 0.0
        self._reached: float | None = None

    def want(self, wish: Wish, now: float, *, wait: bool) -> None:
        """Set the wish; the first try is due at once, or after a delay.

        The delay is the first one, unless what was reached before was lost again before it had proven itself.
        """
        flapping = self._reached is not None and now - self._reached < PROVEN_S
        self.wish, self._reached = wish, None
        if not (wait and flapping):
            self.tries = 0
        self._next_try = now
        if wait:
            self.failed(now)

    def reached(self, now: float) -> None:
        """The wish came true."""
        self.wish, self._reached = "none", now

    def give_up(self) -> None:
        """Want nothing any more."""
        self.wish = "none"

    def due(self, now: float) -> bool:
        """Whether it is time to try."""
        return self.wish != "none" and now >= self._next_try

    def failed(self, now: float) -> None:
        """The try did not succeed: wait longer before the next."""
        self._next_try = now + self._delay(self.tries)
        self.tries += 1

    def _delay(self, tries: int) -> float:
        delay = DELAYS_S[min(tries, len(DELAYS_S) - 1)]
        return delay * (1.0 + self._jitter * self._random.uniform(-1.0, 1.0))


LOOK_PERIOD_S = 0.1
"""A thread that ended is noticed within this time in [s] by whoever waits for it."""

SETTLING_MARGIN_S = 2.0
"""How much longer than its time limit the way to rest is waited for, braking and rest packets included."""


class BoardSession:
    """Packets leave as long as a port is open, at the driver's rate.

    Args:
        sent: Called in the thread that ticks after each tick that told the board a pose.

    Attributes:
        driver: The newest driver, also after its port was closed: its last pose stays known; None at first.
        sending: Whether commands are to be followed, from `start` to `stop`.
    """

    def __init__(self, sent: Callable[[ServoDriver], None]) -> None:
        self.driver: ServoDriver | None = None
        self.sending = False
        self._sent = sent
        self._writer: PeriodicThread | None = None  # while the port is open
        self._watch: HangWatch | None = None  # of that thread
        self._stable_port = ""  # name of the board that outlives its number; empty: none
        self._usb = ""  # what the port's USB chip says of itself; empty: nothing

    @property
    def connected(self) -> bool:
        """Whether a port is open."""
        return self.driver is not None and self.driver.connected

    @property
    def port(self) -> str:
        """Name of the open port; empty without one."""
        return "" if self.driver is None else self.driver.port

    def fault(self) -> PortError | WriterError | None:
        """Why no packet leaves any more: the port was lost, or the thread is dead or hangs; None: it ticks.

        A hang is found by calling this several times a second.
        """
        if self._watch is not None and self._watch.look():
            return WriterError(
                f"the thread that sends packets hangs ({self.port} blocks, or the board's protocol does); the"
                " port was given up, and the servos hold or rest as their board does in silence; plug it in"
                " anew, cleanup and configure"
            )
        failure = None if self._writer is None else self._writer.failure
        if failure is None or isinstance(failure, PortError):
            return failure
        return WriterError(
            f"the thread that sends packets has ended ({type(failure).__name__}: {sentence(failure)});"
            " the servos hold; activate the bridge anew"
        )

    def open(self, driver: ServoDriver, port: str, open_wait_s: float) -> None:
        """Open a port, learn the name that outlives its number, and let the ticks stand by.

        Raises:
            PortError: it cannot be opened.
        """
        driver.connect(port, open_wait_s)
        self.driver = driver
        self._stable_port, self._usb = stable_name(port), usb_identity(port)
        self._stand_by(driver)

    def open_again(self, port: str, open_wait_s: float) -> None:
        """Open the port of the same board anew, whatever its number is now; without one nothing happens.

        No other board is driven: its USB chip has to say the same as before, and what the board said of
        itself it has to say again. A port without a USB chip, such as a pseudo-terminal, is not opened again
        once a board without a number was driven on it. Where that port was lost before a board was known or
        driven, only a board that says what it is is driven: silence is refused.

        Args:
            port: Name from the person; empty: the one board that is plugged in.
            open_wait_s: Quiet time after opening in [s].

        Raises:
            PortError: the board is not there, cannot be told from others, or its port cannot be opened.
        """
        driver = self.driver
        if driver is None:
            return
        met = driver.met
        known_port = bool(self._usb or self._stable_port)
        says_what_it_is = (driver.may_speak and not driver.moved) if met is None else bool(met.identity)
        if not (known_port or says_what_it_is):
            raise PortError(
                port,
                f"whether the board on {port} is still the one that was configured cannot be told (it has"
                " said no number, and its port has no USB identity), and it is told nothing; look, then"
                " cleanup and configure",
            )
        name = find_again(port, self._stable_port, self._usb)
        driver.connect(name, open_wait_s, again=True, silent_allowed=known_port)
        if usb_identity(name) != self._usb:
            driver.disconnect()
            raise PortError(name, f"another device is on {name}; plug in the one that was configured")
        self._stand_by(driver)

    def start(self) -> None:
        """Send from where the board stands; a thread that died is started anew."""
        if self.driver is None:
            return
        self.driver.start()
        self.sending = True
        if self._writer is None:
            self._start_writer(self.driver)

    def stop(self, settle_timeout_s: float) -> bool:
        """Let the servos go to rest, then only listen; an e-stop, a lost port or a lost thread ends the wait.

        Returns:
            Whether they rest, or were not to be moved at all; False: they stay where they are by then.
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
        """Without ticks: tell the board to stay where it is, if it can be; give up a port that blocks."""
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
        """Close the port; to be stopped before.

        Args:
            relax: Switch the pulses off first, where the board can and its servos were left at rest.
        """
        self.sending = False
        self._end_writer()
        if self.driver is not None:
            self.driver.disconnect(relax=relax)

    def hurry(self) -> None:
        """Let the next packet leave at once; from any thread."""
        writer = self._writer
        if writer is not None:
            writer.hurry()

    def figures(self) -> PeriodFigures | None:
        """How evenly packets are sent; None while none are."""
        return self._writer.figures() if self._writer is not None and self.sending else None

    def _stand_by(self, driver: ServoDriver) -> None:
        driver.stand_by()
        self._start_writer(driver)

    def _start_writer(self, driver: ServoDriver) -> None:
        self._end_writer()

        def tick() -> None:
            if driver.tick() is not None and driver.connected:  # it may come back from a port given up
                self._sent(driver)

        self._writer = PeriodicThread(tick, driver.period)
        self._watch = HangWatch(self._writer)

    def _end_writer(self) -> None:
        """End the thread, and forget one that hangs."""
        writer, self._writer, self._watch = self._writer, None, None
        if writer is not None:
            writer.stop()
            writer.join()
