"""The link to the board at the other end: which protocol it speaks, and whether it still lives.

Detection is passive: nothing is written to an unknown board. What it says within the quiet time after opening
is shown to every protocol it may speak; the first that recognises it is kept, and silence makes it a board of
the last one. A board that was met on a port that was lost since is met again only as the same one: until then
nothing is written but the question who it is, and a board that answers otherwise is refused. Times are
seconds of one steady clock that the caller reads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from servo_bridge.driver.ports import Transport
from servo_bridge.errors import PortError
from servo_bridge.protocols import WAITING, Ability, BoardProtocol, TiltReading

TELEMETRY_TIMEOUT_S = 0.5
"""Without telemetry for this long a board that sent some is lost."""

LONGEST_LOOK_S = 0.1
"""Time in [s] that one look at the port stands for at most: longer, and it was this computer that slept."""

LONGEST_TURN_S = 0.5
"""The conversation is waited for so long in [s]; longer, and the protocol hangs."""

BANNER_GRACE_S = 1.0
"""Longer than the quiet time that a board has to answer where it has to say what it is."""


@dataclass(frozen=True, slots=True)
class MetBoard:
    """A board that a bridge has spoken to.

    Attributes:
        protocol: Name of the protocol it speaks.
        identity: What tells it from others, see `BoardProtocol.identity`; empty: not known.
    """

    protocol: str
    identity: str


class BoardLink:
    """State of one opened port; safe to use from a reading and a writing thread.

    Args:
        port: Name of the port, for messages.
        boards: A new conversation in each protocol that the board may speak; the last one is written in where
            none recognises it.
        quiet_s: Time in [s] after opening in which nothing is written, unless the board has spoken.
        now: Time of the opening.
        before: The board that was met on a port lost since, which is to be met again; None: any board.
        silent_allowed: A board that says nothing may be driven, in the last protocol; False: `check` refuses
            it.

    Attributes:
        tilts: Readings of an IMU since the port was opened.
        met: The board met here, or before; None as long as none is, and as long as its answer to the question
            who it is may still come.
    """

    def __init__(
        self,
        port: str,
        boards: Sequence[BoardProtocol],
        quiet_s: float,
        now: float,
        before: MetBoard | None = None,
        silent_allowed: bool = True,
    ) -> None:
        self.port = port
        self.tilts = 0
        self.met = self._before = before
        self._boards = tuple(
            board
            for board in boards
            if Ability.DETECT in board.abilities
            or (silent_allowed if before is None else board.name == before.protocol)
        )
        self._refuses_silence = not silent_allowed
        self._recognised: BoardProtocol | None = None
        self._lock = threading.RLock()
        self._quiet_s, self._quiet_until = quiet_s, now + quiet_s
        self._heard: float | None = None  # newest message that told the board's protocol
        self._looked = now  # newest look at the port, whether it had something or not
        self._unheard_s = 0.0  # time looked at the port since then
        self._tilt_time: float | None = None
        self._restarted = False
        self._fault: PortError | None = None

    @property
    def board(self) -> BoardProtocol:
        """The conversation in the board's protocol, as far as it is known; to be used within `speaking`."""
        return self._recognised or self._boards[-1]

    # What the reading side tells

    def receive(self, data: bytes, now: float) -> tuple[TiltReading, ...]:
        """Take what the port gave at `now`, which may be nothing.

        Returns:
            Readings of an IMU among it.

        Raises:
            PortError: the protocol failed.
        """
        with self.speaking():
            self._unheard_s += min(now - self._looked, LONGEST_LOOK_S)
            self._looked = now
            tilts: tuple[TiltReading, ...] = ()
            for board in self._boards if self._recognised is None else (self._recognised,):
                decoded = board.decode(data)
                if decoded.recognised and Ability.DETECT in board.abilities:
                    if self._heard is None:
                        self.met = self._before  # silence may have been taken for another board
                    self._restarted |= decoded.restarted or self._heard is None
                    self._recognised, self._heard, self._unheard_s = board, now, 0.0
                if board is self.board:
                    tilts = decoded.tilts
                    break
            if tilts:
                self.tilts += len(tilts)
                self._tilt_time = now
            return tilts

    def fail(self, error: PortError) -> None:
        """The port cannot be read any more; `check` raises this from now on."""
        self._fault = error

    # What the writing side asks

    @contextmanager
    def speaking(self) -> Iterator[BoardProtocol]:
        """The board's conversation, for one thread at a time.

        Raises:
            PortError: the protocol failed inside the `with` block, or hangs in another thread.
        """
        if not self._lock.acquire(timeout=LONGEST_TURN_S if self._fault is None else 0.0):
            raise PortError(
                self.port,
                f"the protocol {self.board.name} does not come back on {self.port}; correct it, or set the"
                " parameter protocol",
            )
        try:
            yield self.board
        except PortError:
            raise
        except Exception as error:
            raise PortError(
                self.port,
                f"the protocol {self.board.name} failed on {self.port}"
                f" ({type(error).__name__}: {error}); correct it, or set the parameter protocol",
            ) from error
        finally:
            self._lock.release()

    def state(self, now: float) -> str:
        """Name of the protocol to write in, or WAITING: it is too early to write."""
        try:
            with self.speaking() as board:
                if self._heard is None:
                    ready = now >= self._quiet_until and not self._must_speak
                else:
                    ready = board.ready
                return board.name if ready and self._meet(board) else WAITING
        except PortError as error:
            self.fail(error)
            return WAITING

    def _meet(self, board: BoardProtocol) -> bool:
        """Whether the board may be written to: none was met before, or it is that one."""
        identity, met = board.identity(), self.met
        if met is not None and met.identity:
            return not self._is_stranger(board) and identity is not None
        if met is not None and met.protocol != board.name:
            return False
        if identity is not None:
            self.met = MetBoard(board.name, identity)
        return True

    def _is_stranger(self, board: BoardProtocol) -> bool:
        """Whether what the board says shows that it is another one than the one met."""
        identity, met = board.identity(), self.met
        if met is None:
            return False
        another = bool(met.identity) and identity is not None and identity != met.identity
        return another or board.name != met.protocol

    def check(self, now: float) -> None:
        """Whether the board still lives.

        Raises:
            PortError: the port failed, telemetry stopped, or the board is not what was asked for.
        """
        with self.speaking() as board:
            if self._fault is not None:
                raise PortError(self.port, str(self._fault))
            if problem := board.fault():
                raise PortError(self.port, f"the board on {self.port} {problem}")
            if self._heard is not None and self.met is not None and self._is_stranger(board):
                raise PortError(
                    self.port,
                    f"another board is on {self.port} ({_described(board.name, board.identity() or '')}, not"
                    f" {_described(self.met.protocol, self.met.identity)}), and is told nothing; plug in the"
                    " one that was configured, or for this one cleanup and configure",
                )
            if self._heard is None:
                if self._must_speak and now > self._quiet_until + BANNER_GRACE_S:
                    advice = board.advice
                    if self._refuses_silence:
                        advice = (
                            "whether it is the one that was configured is unknown; look, then cleanup and"
                            " configure"
                        )
                    raise PortError(
                        self.port,
                        f"no board of the {board.name} protocol answered on {self.port} within"
                        f" {self._quiet_s + BANNER_GRACE_S:g} s; {advice}",
                    )
            elif Ability.TELEMETRY in board.abilities and self._unheard_s > TELEMETRY_TIMEOUT_S:
                raise PortError(
                    self.port,
                    f"no telemetry from the board on {self.port} for {TELEMETRY_TIMEOUT_S} s (it hangs, lost"
                    " its supply, or the cable is bad)",
                )

    @property
    def asks(self) -> bool:
        """Whether the board may be asked: it was recognised, or speaks only when it is asked."""
        return self._recognised is not None or Ability.ASKED in self.board.abilities

    @property
    def _must_speak(self) -> bool:
        """Whether a board that says nothing is none of those asked for."""
        return Ability.DETECT in self._boards[-1].abilities

    def take_restart(self) -> bool:
        """Whether the board (re)started since the last call: limits and pose have to be told again."""
        with self.speaking():
            restarted, self._restarted = self._restarted, False
            return restarted

    def heard_age(self, now: float) -> float | None:
        """Time in [s] since the newest message that told the board's protocol; None before the first."""
        heard = self._heard
        return None if heard is None else max(now - heard, 0.0)

    def tilt_age(self, now: float) -> float | None:
        """Time in [s] since the newest reading of an IMU; None before the first."""
        tilt_time = self._tilt_time
        return None if tilt_time is None else max(now - tilt_time, 0.0)


def _described(protocol: str, identity: str) -> str:
    return f"protocol {protocol}, {identity or 'without a number'}"


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
        source: Transport,
        link: BoardLink,
        clock: Callable[[], float],
        on_tilt: Callable[[TiltReading], None] = lambda reading: None,
    ) -> None:
        self._source, self._link, self._clock, self._on_tilt = source, link, clock, on_tilt
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="servo_board_reader", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it, though not for a protocol that hangs."""
        self._stop.set()
        self._source.cancel_read()
        self._thread.join(LONGEST_TURN_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                readings = self._link.receive(self._source.read(), self._clock())
            except PortError as error:
                self._link.fail(error)
                return
            for reading in readings:
                self._on_tilt(reading)
