"""What is known of the board at the other end: its protocol, its telemetry, and whether it still lives.

Detection is passive: nothing is written to an unknown board. A banner or telemetry within the quiet time
after opening makes it a board of the extended protocol; silence makes it a legacy board. Times are seconds of
one steady clock that the caller reads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from servo_bridge.ascii_codec import LineParser, TiltReading
from servo_bridge.errors import PortError
from servo_bridge.frames import (
    PROTOCOL_VERSION,
    SEQUENCES,
    Banner,
    Frame,
    FrameParser,
    FrameType,
    Telemetry,
    read_banner,
    read_telemetry,
)

ProtocolChoice: TypeAlias = Literal["auto", "legacy", "extended", "ascii_imu"]
"""What the person asks for; auto finds out whether the board speaks the extended protocol."""

LinkState: TypeAlias = Literal["waiting", "legacy", "extended", "ascii_imu"]

TELEMETRY_TIMEOUT_S = 0.5
"""Without telemetry for this long a board that sent some is lost."""

BANNER_GRACE_S = 1.0
"""Longer than the quiet time that a board has to answer where the extended protocol is demanded."""

RESET_CAUSES = {1: "power-on", 2: "external (port opened, or button)", 4: "brown-out", 8: "watchdog"}


def reset_cause_text(cause: int) -> str:
    """The bits of a banner's reset cause in words."""
    return ", ".join(text for bit, text in RESET_CAUSES.items() if cause & bit) or f"unknown ({cause})"


@dataclass(slots=True)
class LinkCounts:
    """What came from the board since the port was opened.

    Attributes:
        telemetry: Telemetry frames.
        banners: Banners: starts of the board.
        most_unacknowledged: Largest number of frames that a telemetry had not acknowledged yet.
        tilts: Readings of the IMU.
    """

    telemetry: int = 0
    banners: int = 0
    most_unacknowledged: int = 0
    tilts: int = 0


class BoardLink:
    """State of one opened port; safe to use from a reading and a writing thread.

    Args:
        port: Name of the port, for messages.
        protocol: What the person asked for.
        quiet_s: Time in [s] after opening in which nothing is written, unless the board has spoken.
        now: Time of the opening.
    """

    def __init__(self, port: str, protocol: ProtocolChoice, quiet_s: float, now: float) -> None:
        self.port, self.protocol = port, protocol
        self.counts = LinkCounts()
        self.banner: Banner | None = None
        self.telemetry: Telemetry | None = None
        self.unacknowledged = 0
        self._lock = threading.Lock()
        self._frames, self._lines = FrameParser(), LineParser()
        self._quiet_s, self._quiet_until = quiet_s, now + quiet_s
        self._heard: float | None = None  # newest frame of the board
        self._looked = now  # newest look at the port, whether it had something or not
        self._tilt_time: float | None = None
        self._restarted = False
        self._sent_seq: int | None = None
        self._fault: PortError | None = None

    # What the reading side tells

    def receive(self, data: bytes, now: float) -> list[TiltReading]:
        """Take what the port gave at `now`, which may be nothing.

        Returns:
            Readings of an IMU among it.
        """
        with self._lock:
            self._looked = now
            for frame in self._frames.feed(data):
                self._take(frame, now)
            tilts = self._lines.feed(bytes(value for value in data if value < 0x80))
            if tilts:
                self.counts.tilts += len(tilts)
                self._tilt_time = now
            return tilts

    def fail(self, error: PortError) -> None:
        """The port cannot be read any more; `check` raises this from now on."""
        with self._lock:
            self._fault = error

    def _take(self, frame: Frame, now: float) -> None:
        if self.protocol in ("legacy", "ascii_imu"):
            return
        if frame.kind is FrameType.BANNER:
            self.banner = read_banner(frame)
            self.telemetry = None  # of before the reset
            self.counts.banners += 1
            self._restarted = True
        elif frame.kind is FrameType.TELEMETRY:
            self._restarted |= self._heard is None
            self.telemetry = read_telemetry(frame)
            self.counts.telemetry += 1
            if self._sent_seq is not None:
                self.unacknowledged = (self._sent_seq - self.telemetry.seq) % SEQUENCES
                self.counts.most_unacknowledged = max(self.counts.most_unacknowledged, self.unacknowledged)
        else:
            return  # a board that echoes what it is sent
        self._heard = now

    # What the writing side asks

    def state(self, now: float) -> LinkState:
        """The protocol to write in, or that it is too early to write."""
        with self._lock:
            if self._heard is not None:
                return "extended" if self.telemetry is not None else "waiting"
            if now < self._quiet_until or self.protocol == "extended":
                return "waiting"
            return "legacy" if self.protocol == "auto" else self.protocol

    def check(self, now: float) -> None:
        """Whether the board still lives.

        Raises:
            PortError: the port failed, telemetry stopped, or the board is not what was asked for.
        """
        with self._lock:
            if self._fault is not None:
                raise PortError(self.port, str(self._fault))
            if self.banner is not None and self.banner.protocol != PROTOCOL_VERSION:
                raise PortError(
                    self.port,
                    f"the board on {self.port} speaks version {self.banner.protocol} of the extended"
                    f" protocol, this bridge version {PROTOCOL_VERSION}; flash its firmware anew"
                    " (softsim flash), or set the parameter protocol to legacy",
                )
            if self._heard is not None and self._looked - self._heard > TELEMETRY_TIMEOUT_S:
                raise PortError(
                    self.port,
                    f"no telemetry from the board on {self.port} for {TELEMETRY_TIMEOUT_S} s (it hangs, lost"
                    " its supply, or the cable is bad)",
                )
            silent = self._heard is None and now > self._quiet_until + BANNER_GRACE_S
            if self.protocol == "extended" and silent:
                raise PortError(
                    self.port,
                    f"no board of the extended protocol answered on {self.port} within"
                    f" {self._quiet_s + BANNER_GRACE_S:g} s; flash its firmware (softsim flash), or set the"
                    " parameter protocol to auto",
                )

    def take_restart(self) -> bool:
        """Whether the board (re)started since the last call: limits and pose have to be told again."""
        with self._lock:
            restarted, self._restarted = self._restarted, False
            return restarted

    def sent(self, seq: int) -> None:
        """A frame with this sequence number is written now."""
        with self._lock:
            self._sent_seq = seq

    def telemetry_age(self, now: float) -> float | None:
        """Time in [s] since the board's newest frame; None before the first."""
        with self._lock:
            return None if self._heard is None else max(now - self._heard, 0.0)

    def tilt_age(self, now: float) -> float | None:
        """Time in [s] since the newest reading of an IMU; None before the first."""
        with self._lock:
            return None if self._tilt_time is None else max(now - self._tilt_time, 0.0)

    @property
    def frames_dropped(self) -> int:
        """Frames of the board that came damaged."""
        return self._frames.dropped

    @property
    def lines_ignored(self) -> int:
        """Lines of text that were no reading of an IMU."""
        return self._lines.ignored


class Readable(Protocol):
    """A port to read from; `transport.SerialTransport` is one."""

    def read(self) -> bytes:
        """Bytes that came in, none after a short time without any; PortError where it failed."""
        ...

    def cancel_read(self) -> None:
        """End a `read` that waits in another thread."""
        ...


class Reader:
    """A thread that hands everything a port gives to a link until the port fails or `stop` is called.

    Args:
        source: The port.
        link: Takes the bytes.
        clock: Steady clock in [s].
        on_tilt: Called in this thread with every reading of an IMU.
    """

    def __init__(
        self,
        source: Readable,
        link: BoardLink,
        clock: Callable[[], float],
        on_tilt: Callable[[TiltReading], None] = lambda reading: None,
    ) -> None:
        self._source, self._link, self._clock, self._on_tilt = source, link, clock, on_tilt
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="servo_board_reader", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stop.set()
        self._source.cancel_read()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                data = self._source.read()
            except PortError as error:
                self._link.fail(error)
                return
            for reading in self._link.receive(data, self._clock()):
                self._on_tilt(reading)
