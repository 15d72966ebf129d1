"""Servos of the Dynamixel protocol 2.0 on a bus (XM430, XM540), which measure their positions.

Such servos send only responses, one at a time. Each packet of the bridge ends with one bulk read: the
measured values of all servos, and of one servo in turn its settings or its state (`dynamixel_packets`). While
the port is open and nothing is to move, only that request is sent.

Before a servo gets torque, its present position is written as its goal, and the servo has to confirm it. From
then on its own bus watchdog stops it when packets stop.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from servo_bridge.driver import angle_to_pulse, pulse_to_angle
from servo_bridge.protocols import dynamixel_packets as table
from servo_bridge.protocols.dynamixel_bus import DynamixelBus
from servo_bridge.protocols.dynamixel_packets import (
    ALERT,
    Instruction,
    Packet,
    PacketStream,
    ServoSettings,
    ServoState,
)
from servo_bridge.protocols.protocol import Ability, BoardModel, BoardProtocol, Decoded, EncodedPacket
from softsim_core.base import listing
from softsim_core.scene import BoardDescription, BusServo, Servo

# Bus watchdog of every servo with torque, in units of 20 ms: stops it after 0.5 s without a packet
WATCHDOG = 25
DEAD_BAND = 17  # a servo closer than this in pulses is at its goal: one and a half degrees
MOST_PINGS = 10  # a servo that did not respond to this many requests is missing
STALE = 2  # number of unanswered requests after which a servo's position is too old to stop at
PATIENCE = 2  # number of contradicting responses in a row; a single one may date from before
# Fraction of the time between two packets that requests and responses may take on the line
LARGEST_LOAD = 0.8
BITS_PER_BYTE = 10
_STATUS_BYTES, _RETURN_DELAY_S = 11, 500e-6


class DynamixelProtocol(BoardProtocol):
    """Goals to the servos of a bus, and their measurements."""

    name = "dynamixel"
    drives = BusServo
    abilities = Ability.DETECT | Ability.ASKED | Ability.TELEMETRY | Ability.MEASURES
    abilities |= Ability.HOLD | Ability.RELAX | Ability.LIMITS
    advice = "check the servos' supply and cable, their ids, and the baud rate"

    def __init__(self, board: BoardDescription) -> None:
        super().__init__(board)
        self._servos = {servo.id: servo for servo in board.bus_servos}
        self.top_speed = 0.9 * min(servo.speed for servo in self._servos.values())
        self._stream = PacketStream()
        self._models: dict[int, int] = {}
        self._settings: dict[int, ServoSettings] = {}
        self._states: dict[int, ServoState] = {}
        self._positions: dict[int, int] = {}  # newest, in pulses
        self._currents: dict[int, float] = {}
        self._asked: Counter[int] = Counter()  # requests since the newest response, by id
        self._answers = 0
        self._responding_ids: set[int] = set()  # ids that responded since the last time that all had
        self._next = 0  # turn of the servo that is queried for more
        self._goals: dict[int, int] | None = None  # sent last; None: none since the takeover began
        self._hold_goals: dict[int, int] | None = None  # goals of the hold in progress
        self._fresh: set[int] = set()  # ids with a state reported since the takeover began
        self._taken_over: bool | None = None  # None before the first takeover
        self._contradictions: Counter[int] = Counter()

    @classmethod
    def refusal(cls, board: BoardDescription) -> str:
        """Refuse a line that is too slow for this number of servos at this rate."""
        places = {servo.id: table.PRESENT for servo in board.bus_servos}
        data = table.sync_write(table.GOAL_POSITION, dict.fromkeys(places, bytes(4)))
        needed_s = _line_s(board, len(data) + len(table.bulk_read(places))) + _answers_s(board)
        free_s = LARGEST_LOAD / board.rate
        if needed_s <= free_s:
            return ""
        return (
            f"{len(places)} servos at {board.baud_rate} baud need {1e3 * needed_s:.1f} ms for a packet and"
            f" its answers, and {board.rate:g} Hz leave {1e3 * free_s:.1f} ms; set a higher baud_rate, in the"
            " servos too, or a lower rate"
        )

    @classmethod
    def board_model(cls, servos: Sequence[Servo]) -> BoardModel:
        """Return a bus of emulated XM430-W210."""
        return DynamixelBus([servo.id for servo in servos if isinstance(servo, BusServo)])

    # Sending

    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        """Encode the goals of all servos, and a request."""
        pairs = list(zip(angles_rad, self._servos.values(), strict=True))
        self._goals = {servo.id: angle_to_pulse(angle, servo) for angle, servo in pairs}
        self._hold_goals = None
        return EncodedPacket(
            self._encode_goals(self._goals) + self.ask(),
            tuple(self._goals.values()),
            tuple(pulse_to_angle(self._goals[servo.id], servo) for _, servo in pairs),
        )

    def ask(self) -> bytes:
        """Return a ping of the next servo not known yet; else a request to all, to one in turn for more."""
        ids = list(self._servos)
        unknown = [each for each in ids if each not in self._models]
        among = unknown or ids
        self._next += 1
        chosen = among[self._next % len(among)]
        if unknown:
            self._asked[chosen] += 1
            return table.ping(chosen)
        self._asked.update(ids)
        more = table.STATE if chosen in self._settings else table.SETTINGS
        return table.bulk_read({each: more if each == chosen else table.PRESENT for each in ids})

    def limits(self) -> bytes:
        """Return the packet that prepares every servo: first its goal, then torque, as its responses allow.

        The goal is written before the torque is switched on, and the torque only when the servo has reported
        this goal. A servo that has torque already is sent one goal only once, since it may give way under its
        load by any distance.
        """
        if self._fresh != set(self._servos):
            return self.ask()
        before = self._goals or {}
        with_torque = {each for each in before if self._states[each].torque}
        goals = {each: before[each] if each in with_torque else self._stand(each) for each in self._servos}
        # A servo with a tripped watchdog refuses goals, so the watchdog is cleared first.
        data = table.sync_write(table.BUS_WATCHDOG, dict.fromkeys(goals, b"\x00"))
        data += table.sync_write(table.PROFILE, {each: self._profile(each) for each in goals})
        data += self._encode_goals(goals)
        ready = [
            each
            for each, state in self._states.items()
            if state.torque  # or it has just reported its position as its goal
            or (self._asked[each] <= STALE and abs(state.goal - state.position) <= DEAD_BAND)
        ]
        if ready:
            data += table.sync_write(table.TORQUE_ENABLE, dict.fromkeys(ready, b"\x01"))
            data += table.sync_write(table.BUS_WATCHDOG, dict.fromkeys(ready, bytes([WATCHDOG])))
        self._goals = goals
        return data + self.ask()

    def hold(self) -> bytes:
        """Return goals at the present positions, the same for the whole hold; torque that is off stays off.

        The first hold packet is sent at any moment. Responses to the request before may still be on the line
        and damage it, so its goals are repeated until all of these are over.
        """
        if self._hold_goals is not None:
            return self._encode_goals(self._hold_goals) + self.ask()
        self._hold_goals = {servo_id: self._stand(servo_id) for servo_id in self._servos}
        data = self._encode_goals(self._hold_goals)
        return data * (2 + int(_answers_s(self.board) / _line_s(self.board, len(data)))) + self.ask()

    def relax(self) -> bytes:
        """Return the packet that switches torque and watchdog off."""
        off = table.sync_write(table.TORQUE_ENABLE, dict.fromkeys(self._servos, b"\x00"))
        return off + table.sync_write(table.BUS_WATCHDOG, dict.fromkeys(self._servos, b"\x00"))

    def _encode_goals(self, goals: Mapping[int, int]) -> bytes:
        return table.sync_write(
            table.GOAL_POSITION, {servo_id: table.four(goal) for servo_id, goal in goals.items()}
        )

    # Receiving

    def decode(self, data: bytes) -> Decoded:
        """Process responses; the board is recognised each time that all servos have responded."""
        for packet in self._stream.feed(data):
            if packet.instruction == Instruction.STATUS and packet.servo_id in self._servos:
                self._take(packet)
        if set(self._servos) - self._responding_ids or len(self._models) < len(self._servos):
            return Decoded()
        self._responding_ids.clear()
        return Decoded(recognised=True)

    def _take(self, packet: Packet) -> None:
        servo_id, parameters = packet.servo_id, packet.parameters
        if packet.error & ~ALERT:
            return  # the servo refuses a packet that was damaged on the line
        if len(parameters) == 3:
            self._models[servo_id] = int.from_bytes(parameters[:2], "little")
        elif len(parameters) == table.PRESENT[1]:
            self._currents[servo_id], self._positions[servo_id] = table.read_present(parameters)
        elif len(parameters) == table.SETTINGS[1]:
            self._settings[servo_id] = table.read_settings(parameters)
        elif len(parameters) == table.STATE[1]:
            self._states[servo_id] = state = table.read_state(parameters)
            self._fresh.add(servo_id)
            self._positions[servo_id], self._currents[servo_id] = state.position, state.current
            wrong = self._taken_over and not self._is_armed(servo_id)
            self._contradictions[servo_id] = self._contradictions[servo_id] + 1 if wrong else 0
        else:
            return
        self._answers += 1
        self._asked[servo_id] = 0
        self._responding_ids.add(servo_id)

    @property
    def ready(self) -> bool:
        """Whether every servo has reported its settings and its state."""
        return all(each in self._settings and each in self._states for each in self._servos)

    def identity(self) -> str | None:
        """Return models, firmware and settings of the servos, which have no serial number."""
        if not self.ready:
            return None
        return "; ".join(
            f"servo {each} {self._settings[each].identity_text}" for each in sorted(self._servos)
        )

    def fault(self) -> str:
        """Report a servo that is missing, is no XM, is set unsuitably, or has switched its torque off."""
        silent = [each for each in self._servos if each not in self._models]
        if missing := [each for each in silent if self._asked[each] >= MOST_PINGS]:
            there = [str(each) for each in self._servos if each in self._models]
            return (
                f"receives nothing from {self._list_servos(missing)} at {self.board.baud_rate} baud (answers"
                f" come from: {listing(there)}); {self.advice}"
            )
        for servo_id in self._servos:
            if problem := self._problem(servo_id):
                return f"cannot be driven: {self._list_servos([servo_id])} {problem}"
        return ""

    def _problem(self, servo_id: int) -> str:
        """Return why a servo cannot be driven; empty if it can, or has not reported enough yet."""
        servo, model = self._servos[servo_id], self._models.get(servo_id)
        if model is not None and model not in table.MODELS:
            return f"is a model {model}; known are {listing(table.MODELS.values())}"
        settings, state = self._settings.get(servo_id), self._states.get(servo_id)
        if settings is not None and (problem := _setting_problem(settings, servo)):
            return problem
        if state is None or settings is None:
            return ""
        if off := state.hardware_error & settings.shutdown:
            return (
                f"has switched its torque off ({off.words()}); take the load away, let it cool, and switch"
                " the servos' supply off and on"
            )
        position = self._positions[servo_id]
        out = max(servo.pulse_min - position, position - servo.pulse_max)
        if self._taken_over is False and not state.torque and out > DEAD_BAND:
            return (
                f"is at pulse {position}, outside {servo.pulse_min}..{servo.pulse_max}; it has no"
                " torque: turn it there by hand"
            )
        return ""

    def begin_takeover(self) -> None:
        """Start a takeover: reported states and goals from before do not count."""
        self._taken_over = False
        self._goals = self._hold_goals = None
        self._fresh.clear()
        self._contradictions.clear()

    def acknowledged(self) -> bool:
        """Return whether every servo reports the commanded goal, torque on and an armed watchdog."""
        goals = self._goals
        self._taken_over = goals is not None and all(
            self._is_armed(each) and self._states[each].goal == goal for each, goal in goals.items()
        )
        return self._taken_over

    def pose(self) -> tuple[float, ...] | None:
        """Return the angles of the servos: of their goals where they are reached, else as measured."""
        if len(self._positions) < len(self._servos):
            return None
        return tuple(pulse_to_angle(self._stand(each), servo) for each, servo in self._servos.items())

    def measured(self) -> tuple[float, ...] | None:
        """Return the angles of the newest responses."""
        if len(self._positions) < len(self._servos):
            return None
        return tuple(pulse_to_angle(self._positions[each], servo) for each, servo in self._servos.items())

    def deviation(self) -> str:
        """Report a servo that has lost its torque, or was stopped by its watchdog."""
        for servo_id, count in self._contradictions.items():
            if count >= PATIENCE:
                state = self._states[servo_id]
                stopped = state.watchdog == table.WATCHDOG_TRIPPED
                what = "was stopped by its bus watchdog" if stopped else "has lost its torque or its profile"
                return f"does not follow its commands ({self._list_servos([servo_id])} {what})"
        return ""

    def values(self) -> Mapping[str, object]:
        """Return measurements and properties of the servos."""
        ids = list(self._servos)

        def of_each(by_id: Mapping[int, object]) -> str:
            return " ".join(str(by_id.get(each, "?")) for each in ids)

        states = self._states
        errors = {each: state.hardware_error for each, state in states.items() if state.hardware_error}
        return {
            "servos": " ".join(map(str, ids)),
            "models": of_each({each: table.MODELS.get(model, model) for each, model in self._models.items()}),
            "servo firmware": of_each({each: settings.firmware for each, settings in self._settings.items()}),
            "torque": of_each({each: "on" if state.torque else "off" for each, state in states.items()}),
            "positions [pulse]": of_each(self._positions),
            "currents [mA]": of_each({each: round(1e3 * amps) for each, amps in self._currents.items()}),
            "voltages [V]": of_each({each: state.voltage for each, state in states.items()}),
            "temperatures [degC]": of_each({each: state.temperature for each, state in states.items()}),
            "hardware errors": "; ".join(f"{each}: {error.words()}" for each, error in errors.items())
            or "none",
            "answers": self._answers,
            "answers damaged": self._stream.damaged,
            "questions unanswered": max(self._asked.values(), default=0),
        }

    # State of one servo

    def _stand(self, servo_id: int) -> int:
        """Return where a servo is to stay: at its goal if it is within the dead band, else where it is.

        Its position is unknown after a few unanswered requests; it then also stays at its goal, which is
        never far from it.
        """
        servo, state, position = self._servos[servo_id], self._states.get(servo_id), self._positions[servo_id]
        goal = None if self._goals is None else self._goals[servo_id]
        if goal is None and state is not None and state.torque:
            goal = state.goal
        if goal is not None and (self._asked[servo_id] > STALE or abs(position - goal) <= DEAD_BAND):
            position = goal
        return min(max(position, servo.pulse_min), servo.pulse_max)

    def _is_armed(self, servo_id: int) -> bool:
        """Return whether a servo has torque, its watchdog and its profile."""
        state = self._states.get(servo_id)
        if state is None:
            return False
        profile = b"".join(map(table.four, state.profile))
        return state.torque and state.watchdog == WATCHDOG and profile == self._profile(servo_id)

    def _profile(self, servo_id: int) -> bytes:
        """Return the profile of a servo: its top speed, and no limit of acceleration.

        The bridge limits the acceleration.
        """
        return table.four(0) + table.four(max(1, int(self._servos[servo_id].speed / table.VELOCITY_UNIT)))

    def _list_servos(self, servo_ids: Iterable[int]) -> str:
        return listing([f"servo {each} ({self._servos[each].joint})" for each in servo_ids])


def _line_s(board: BoardDescription, count: int) -> float:
    """Return the time in [s] that a number of bytes takes on the line."""
    return count * BITS_PER_BYTE / board.baud_rate


def _answers_s(board: BoardDescription) -> float:
    """Return the longest time in [s] of the responses to one request, with the servos' factory settings."""
    count = len(board.bus_servos)
    size = count * (_STATUS_BYTES + table.PRESENT[1]) + table.STATE[1]
    return _line_s(board, size) + count * _RETURN_DELAY_S


def _setting_problem(settings: ServoSettings, servo: BusServo) -> str:
    """Return why a servo with these settings cannot be driven; empty if it can."""
    if settings.firmware < table.LEAST_FIRMWARE:
        return f"has firmware {settings.firmware}, and {table.LEAST_FIRMWARE} is needed; bring it up to date"
    if settings.operating_mode != table.POSITION_MODE:
        return f"is in operating mode {settings.operating_mode}; set mode {table.POSITION_MODE} (position)"
    if settings.drive_mode & table.DRIVE_MODE_TIME_PROFILE:
        return "takes profiles of time; clear bit 2 of its drive mode"
    if settings.lowest > servo.pulse_min or settings.highest < servo.pulse_max:
        return (
            f"takes goals {settings.lowest}..{settings.highest} only, and the robot's file allows"
            f" {servo.pulse_min}..{servo.pulse_max}; narrow them there, or widen them in the servo"
        )
    return ""
