"""The link to the board at the other end of a port: its protocol, and whether it still responds.

Detection is passive: nothing is written to an unknown board. What it sends within the quiet time after
opening is passed to every protocol that it may speak. The first protocol that recognises it is used; silence
selects the last one. After a port was lost, only the board that was accepted before is accepted again: until
then only the query for its identity is written, and a board with another identity is refused. Times are
seconds of one steady clock that the caller reads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from servo_bridge import PortError
from servo_bridge.driver.ports import Transport
from servo_bridge.protocols import WAITING, Ability, BoardProtocol, TiltReading

TELEMETRY_TIMEOUT_S = 0.5  # a board that has sent telemetry is lost after this time in [s] without any
# Most time in [s] that one check of the port counts for; in a longer gap this computer was asleep
LONGEST_LOOK_S = 0.1
LONGEST_TURN_S = 0.5  # longest wait in [s] for the protocol object; after it the protocol counts as hanging
BANNER_GRACE_S = 1.0  # time in [s] beyond the quiet time in which a board may identify itself, if it has to


@dataclass(frozen=True, slots=True)
class MetBoard:
    """A board that the bridge has accepted."""

    protocol: str  # name of the protocol it speaks
    identity: str  # what distinguishes it from others, see `BoardProtocol.identity`; empty if unknown


class BoardLink:
    """State of one open port; safe to use from a reading and a writing thread.

    Args:
        port: Name of the port, for messages.
        boards: A new object of each protocol that the board may speak; the last one is used if none
            recognises the board.
        quiet_s: Time in [s] after opening in which nothing is written, unless the board sends first.
        now: Time of the opening.
        before: The board that was accepted on a port that was lost, and the only one accepted now; None
            accepts any board.
        silent_allowed: Whether a board that sends nothing may be driven, in the last protocol; if False,
            `check` refuses it.

    Attributes:
        tilts: Readings of an IMU since the port was opened.
        met: The board accepted here or before; None until then, and while its answer to the identity query
            may still arrive.
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
        self._telemetry_time: float | None = None  # newest message that identifies the protocol
        self._looked = now  # newest check of the port, with or without data
        self._silence_s = 0.0  # time in [s] that the port was checked since then
        self._tilt_time: float | None = None
        self._restarted = False
        self._fault: PortError | None = None

    @property
    def board(self) -> BoardProtocol:
        """Protocol object of the board, as far as its protocol is known; use it within `speaking`."""
        return self._recognised or self._boards[-1]

    # Called by the reading side

    def receive(self, data: bytes, now: float) -> tuple[TiltReading, ...]:
        """Process what the port returned at `now`, which may be nothing; return the IMU readings in it.

        Raises:
            PortError: the protocol failed.
        """
        with self.speaking():
            self._silence_s += min(now - self._looked, LONGEST_LOOK_S)
            self._looked = now
            tilts: tuple[TiltReading, ...] = ()
            for board in self._boards if self._recognised is None else (self._recognised,):
                decoded = board.decode(data)
                if decoded.recognised and Ability.DETECT in board.abilities:
                    if self._telemetry_time is None:
                        self.met = self._before  # silence may have selected another protocol
                    self._restarted |= decoded.restarted or self._telemetry_time is None
                    self._recognised, self._telemetry_time, self._silence_s = board, now, 0.0
                if board is self.board:
                    tilts = decoded.tilts
                    break
            if tilts:
                self.tilts += len(tilts)
                self._tilt_time = now
            return tilts

    def fail(self, error: PortError) -> None:
        """Record that the port cannot be read any more; `check` raises this error from now on."""
        self._fault = error

    # Called by the writing side

    @contextmanager
    def speaking(self) -> Iterator[BoardProtocol]:
        """Give access to the protocol object, to one thread at a time.

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
        """Return the name of the protocol to write in, or WAITING while it is too early to write."""
        try:
            with self.speaking() as board:
                if self._telemetry_time is None:
                    ready = now >= self._quiet_until and not self._must_speak
                else:
                    ready = board.ready
                return board.name if ready and self._meet(board) else WAITING
        except PortError as error:
            self.fail(error)
            return WAITING

    def _meet(self, board: BoardProtocol) -> bool:
        """Return whether the board may be written to: none was accepted before, or it is the same one."""
        identity, met = board.identity(), self.met
        if met is not None and met.identity:
            return not self._is_stranger(board) and identity is not None
        if met is not None and met.protocol != board.name:
            return False
        if identity is not None:
            self.met = MetBoard(board.name, identity)
        return True

    def _is_stranger(self, board: BoardProtocol) -> bool:
        """Return whether the board's identity shows that it is not the one accepted before."""
        identity, met = board.identity(), self.met
        if met is None:
            return False
        another = bool(met.identity) and identity is not None and identity != met.identity
        return another or board.name != met.protocol

    def check(self, now: float) -> None:
        """Check that the board still responds.

        Raises:
            PortError: the port failed, telemetry stopped, or the board is not the requested one.
        """
        with self.speaking() as board:
            if self._fault is not None:
                raise PortError(self.port, str(self._fault))
            if problem := board.fault():
                raise PortError(self.port, f"the board on {self.port} {problem}")
            if self._telemetry_time is not None and self.met is not None and self._is_stranger(board):
                raise PortError(
                    self.port,
                    f"another board is on {self.port}"
                    f" ({_describe_board(board.name, board.identity() or '')},"
                    f" not {_describe_board(self.met.protocol, self.met.identity)}), and is not commanded;"
                    " plug in the one that was configured, or for this one cleanup and configure",
                )
            if self._telemetry_time is None:
                if self._must_speak and now > self._quiet_until + BANNER_GRACE_S:
                    advice = board.advice
                    if self._refuses_silence:
                        advice = (
                            "whether it is the one that was configured is unknown; check it, then cleanup and"
                            " configure"
                        )
                    raise PortError(
                        self.port,
                        f"no board of the {board.name} protocol answered on {self.port} within"
                        f" {self._quiet_s + BANNER_GRACE_S:g} s; {advice}",
                    )
            elif Ability.TELEMETRY in board.abilities and self._silence_s > TELEMETRY_TIMEOUT_S:
                raise PortError(
                    self.port,
                    f"no telemetry from the board on {self.port} for {TELEMETRY_TIMEOUT_S} s (it hangs, lost"
                    " its supply, or the cable is bad)",
                )

    @property
    def asks(self) -> bool:
        """Whether the board may be queried: it was recognised, or sends only when it is asked."""
        return self._recognised is not None or Ability.ASKED in self.board.abilities

    @property
    def _must_speak(self) -> bool:
        """Whether a board that sends nothing is refused: every possible protocol identifies itself."""
        return Ability.DETECT in self._boards[-1].abilities

    def take_restart(self) -> bool:
        """Return whether the board has (re)started since the last call, and so needs limits and a pose."""
        with self.speaking():
            restarted, self._restarted = self._restarted, False
            return restarted

    def telemetry_age(self, now: float) -> float | None:
        """Return the age in [s] of the newest message that identifies the protocol; None before one."""
        telemetry_time = self._telemetry_time
        return None if telemetry_time is None else max(now - telemetry_time, 0.0)

    def tilt_age(self, now: float) -> float | None:
        """Return the time in [s] since the newest reading of an IMU; None before the first."""
        tilt_time = self._tilt_time
        return None if tilt_time is None else max(now - tilt_time, 0.0)


def _describe_board(protocol: str, identity: str) -> str:
    return f"protocol {protocol}, {identity or 'without a number'}"


class Reader:
    """A thread that passes everything from a port to a link until the port fails or `stop` is called.

    `clock` is a steady clock in [s]; `on_tilt` is called in this thread with every reading of an IMU.
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
        """End the thread and wait for it, but not for a protocol that hangs."""
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
