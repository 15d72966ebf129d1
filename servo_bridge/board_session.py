"""A board while its port is open: the driver, the thread that ticks it, and what has become of that thread.

No ROS. One thread opens, starts, stops and closes; the thread that ticks takes no lock of it. Nobody waits
for a port that blocks.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from servo_bridge.driver import ServoDriver
from servo_bridge.errors import PortError, WriterError
from servo_bridge.ports import find_again, stable_name, usb_identity
from servo_bridge.wording import sentence
from servo_bridge.writer import HangWatch, PeriodFigures, PeriodicThread

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
