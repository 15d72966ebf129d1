"""The protocols that are known by name: the built-in ones, and those that a robot's Python file registers."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from servo_bridge import ProtocolError
from servo_bridge.protocols.ascii_imu import AsciiImuProtocol
from servo_bridge.protocols.dynamixel import DynamixelProtocol
from servo_bridge.protocols.extended import ExtendedProtocol
from servo_bridge.protocols.legacy import LegacyProtocol
from servo_bridge.protocols.protocol import Ability, BoardModel, BoardProtocol
from softsim_core.base import known_names, listing
from softsim_core.scene import BoardDescription, Servo

AUTO = "auto"  # detect the protocol by listening; a board that does not identify itself gets `FALLBACK`
WAITING = "waiting"  # state of a link with a board that is not known yet; like `AUTO`, no name of a protocol
# Protocol of a board of hobby servos that does not identify itself
FALLBACK: type[BoardProtocol] = LegacyProtocol

_BUILT_IN: tuple[type[BoardProtocol], ...] = (
    LegacyProtocol,
    ExtendedProtocol,
    AsciiImuProtocol,
    DynamixelProtocol,
)
_registered: dict[str, type[BoardProtocol]] = {each.name: each for each in _BUILT_IN}

_METHODS = {
    Ability.DETECT: "decode",
    Ability.IMU: "decode",
    Ability.HOLD: "hold",
    Ability.RELAX: "relax",
    Ability.LIMITS: "limits",
    Ability.ASKED: "ask",
    Ability.MEASURES: "measured",
}

Protocol = TypeVar("Protocol", bound=type[BoardProtocol])


def register(protocol: Protocol) -> Protocol:
    """Register a protocol by its name; usable as a decorator of its class.

    A class of the same file and name replaces the one before, since a scene that is loaded again registers
    again.

    Returns:
        The class.

    Raises:
        ProtocolError: the class is incomplete, or its name is taken.
    """
    if not (isinstance(protocol, type) and issubclass(protocol, BoardProtocol)):
        raise ProtocolError(f"{protocol!r} is no board protocol; derive a class from BoardProtocol")
    what = f"board protocol {protocol.__qualname__}"
    if inspect.isabstract(protocol):
        missing = listing(sorted(protocol.__abstractmethods__))
        raise ProtocolError(f"{what} does not define {missing}; see BoardProtocol")
    name = getattr(protocol, "name", "")
    if not (isinstance(name, str) and re.fullmatch(r"[a-z][a-z0-9_]*", name)) or name in (AUTO, WAITING):
        raise ProtocolError(
            f"{what}: name {name!r} cannot be used; give small letters, digits and _, not {AUTO} or {WAITING}"
        )
    if Ability.TELEMETRY in protocol.abilities and Ability.DETECT not in protocol.abilities:
        raise ProtocolError(f"{what}: TELEMETRY needs DETECT; name both abilities, or neither")
    for ability, method in _METHODS.items():
        if ability in protocol.abilities and getattr(protocol, method) is getattr(BoardProtocol, method):
            raise ProtocolError(f"{what} has the ability {ability.name} and no method {method}; define it")
    former = _registered.get(name)
    if former is not None and _origin(former) != _origin(protocol):
        raise ProtocolError(
            f"{what}: the name {name} is taken by {former.__qualname__} of {_origin(former)[0]};"
            " choose another"
        )
    _registered[name] = protocol
    return protocol


def names() -> tuple[str, ...]:
    """Return the names of all known protocols, sorted."""
    return tuple(sorted(_registered))


def protocol_named(name: str) -> type[BoardProtocol]:
    """Return the protocol with a name.

    Raises:
        ProtocolError: nothing of that name is registered.
    """
    found = _registered.get(name)
    if found is None:
        raise ProtocolError(
            f"no board protocol is named {name!r}; {known_names(name, (AUTO, *names()))}; the robot's Python"
            " file can register one of its own"
        )
    return found


def candidates(choice: str, board: BoardDescription) -> tuple[type[BoardProtocol], ...]:
    """Return the protocols that a board may speak; the last one is used if none recognises the board.

    `AUTO` stands for the protocol that the robot's board names; without one, for every built-in protocol that
    detects its boards and fits the servos and the baud rate, then the fallback. A registered protocol is only
    used by name.

    Raises:
        ProtocolError: unknown name, or a protocol that does not fit the board's servos.
    """
    chosen = board.protocol if choice == AUTO else choice
    if chosen != AUTO:
        protocol = protocol_named(chosen)
        if problem := _refusal(protocol, board):
            raise ProtocolError(problem)
        return (protocol,)
    possible = [
        each
        for each in _BUILT_IN
        if (Ability.DETECT in each.abilities or each is FALLBACK)
        and each.baud_rate in (None, board.baud_rate)
    ]
    fitting = [each for each in possible if not _refusal(each, board)]
    if not fitting:
        raise ProtocolError("; ".join(_refusal(each, board) for each in possible if _drives(each, board)))
    return tuple(sorted(fitting, key=lambda each: each is FALLBACK))


def model_of_board(choice: str, servos: Sequence[Servo]) -> BoardModel:
    """Return a board without hardware that drives servos and speaks a protocol.

    `AUTO` gives a board that does not identify itself, or a bus of servos.

    Raises:
        ProtocolError: unknown name, or a protocol without a model of its board.
    """
    board = BoardDescription(servos=tuple(servos), baud_rate=1_000_000)
    protocol = candidates(AUTO, board)[-1] if choice == AUTO else protocol_named(choice)
    model = protocol.board_model(servos) if _drives(protocol, board) else None
    if model is None:
        raise ProtocolError(
            f"the protocol {protocol.name} has no model of a board with {len(servos)} servos; use a real"
            " board, or define its method board_model"
        )
    return model


def _drives(protocol: type[BoardProtocol], board: BoardDescription) -> bool:
    return all(isinstance(servo, protocol.drives) for servo in board.servos)


def _refusal(protocol: type[BoardProtocol], board: BoardDescription) -> str:
    """Return why a board cannot be driven in a protocol; empty if it can."""
    if _drives(protocol, board):
        return protocol.refusal(board)
    kind = "servos on a bus, which have an id" if board.hobby_servos else "hobby servos, which have no id"
    return (
        f"the {protocol.name} protocol drives {kind}, and {board.servos[0].joint} is none; change the"
        " board's servos, or the parameter protocol"
    )


def _origin(protocol: type[BoardProtocol]) -> tuple[str, str]:
    """Return file and name of a class; a file that is loaded again gives its class the same origin."""
    file = getattr(sys.modules.get(protocol.__module__), "__file__", None)
    return str(Path(file).resolve()) if file else protocol.__module__, protocol.__qualname__
