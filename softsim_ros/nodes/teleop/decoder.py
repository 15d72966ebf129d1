"""Decode terminal bytes to key presses incrementally: pure, any chunking, no part of a sequence leaks.

Understood: printable ASCII, control bytes, arrows and editing keys as CSI, SS3, rxvt and xterm-modifier
sequences, the kitty protocol (CSI u), xterm's modifyOtherKeys. Discarded completely: every other escape
sequence, strings (OSC, DCS, APC, PM, SOS), mouse reports, bracketed pastes, Alt+key, characters outside
ASCII. Ctrl+C is always recognised.

Source: ECMA-48 section 5.4 (shape of a control sequence); xterm control sequences; kitty keyboard protocol.
"""

from __future__ import annotations

import string
from collections.abc import Iterator
from enum import Enum, auto
from typing import Final

from softsim_ros.keys import KeyPress

ESCAPE_TIMEOUT_S: Final = 0.5
"""Silence in [s] after which an unfinished sequence is discarded; long, since slow links split sequences."""

_ESC, _CTRL_C, _TAB, _DEL = 0x1B, 0x03, 0x09, 0x7F
_PASTE_END: Final = b"\x1b[201~"
_SEQUENCE_MAX: Final = 64  # limit of stored parameter bytes; no key needs more
_CTRL, _IGNORED_MODIFIERS = 0b100 | 0b1000, 0b1 | 0b1100_0000  # Ctrl or Cmd/Super; Shift, Caps Lock, Num Lock

_ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left", "H": "home", "F": "end"}
_RXVT_ARROWS: Final = {"a": "up", "b": "down", "c": "right", "d": "left"}
_SS3_KEYPAD: Final = {"k": "plus", "m": "minus", "M": "enter"} | dict(
    zip("pqrstuvwxy", string.digits, strict=True)
)
_EDITING: Final = dict(
    enumerate(("home", "insert", "delete", "end", "page_up", "page_down", "home", "end"), 1)
)
_KITTY_KEYPAD: Final = {57399 + i: str(i) for i in range(10)} | {
    57412: "minus", 57413: "plus", 57414: "enter", 57417: "left", 57418: "right", 57419: "up", 57420: "down",
    57421: "page_up", 57422: "page_down", 57423: "home", 57424: "end", 57425: "insert", 57426: "delete",
}  # fmt: skip
_CONTROL_NAMES: Final = {0x00: "space", 0x0D: "enter", 0x1C: "\\", 0x1D: "]", 0x1E: "^", 0x1F: "minus"}
_NAMED_CHARACTERS: Final = {
    " ": "space", "+": "plus", "=": "plus", "-": "minus", "_": "minus",
    "\r": "enter", "\x1b": "escape", "\x7f": "backspace", "\t": "i",
}  # fmt: skip


class _State(Enum):
    GROUND = auto()
    ESCAPE = auto()  # after ESC
    CSI = auto()  # after ESC [
    CONSOLE = auto()  # after ESC [ [ (function keys of the Linux console)
    SS3 = auto()  # after ESC O
    STRING = auto()  # until BEL or ESC backslash
    STRING_ESCAPE = auto()  # after ESC inside a string
    MOUSE = auto()  # three characters after ESC [ M
    PASTE = auto()  # until ESC [ 201 ~
    UTF8 = auto()  # continuation bytes of a character outside ASCII


class KeyDecoder:
    """Decodes bytes to key presses; `flush` discards an unfinished sequence after `timeout_s` in [s]."""

    def __init__(self, timeout_s: float = ESCAPE_TIMEOUT_S) -> None:
        self.timeout_s = timeout_s
        self._state = _State.GROUND
        self._last_byte_at = 0.0
        self._alt = False
        self._parameters = ""
        self._remaining = 0
        self._paste_tail = b""

    @property
    def pending(self) -> bool:
        """Whether an unfinished sequence waits for more bytes, or for `flush`."""
        return self._state not in (_State.GROUND, _State.PASTE)

    def feed(self, data: bytes, now: float = 0.0) -> list[KeyPress]:
        """Return key presses completed by `data`, in order; `now` is a steady clock in [s]. Never raises."""
        if data:
            self._last_byte_at = now
        return [key for byte in data for key in self._step(byte)]

    def flush(self, now: float) -> list[KeyPress]:
        """Discard an unfinished sequence after `timeout_s` of silence; a lone ESC becomes the key "escape".

        A paste has no time limit, since its text must never turn into keys.
        """
        if not self.pending or now - self._last_byte_at < self.timeout_s:
            return []
        lone_escape = self._state is _State.ESCAPE
        self._state = _State.GROUND
        return [KeyPress("escape")] if lone_escape else []

    def _step(self, byte: int) -> Iterator[KeyPress]:
        if byte == _CTRL_C:
            self._state = _State.GROUND
            yield KeyPress("c", ctrl=True)
        elif self._state is _State.GROUND:
            yield from self._ground(byte)
        elif self._state is _State.UTF8:
            yield from self._utf8(byte)
        elif self._state is _State.PASTE:
            self._paste(byte)
        elif self._state in (_State.STRING, _State.STRING_ESCAPE):
            self._string(byte)
        elif self._state is _State.MOUSE:
            self._mouse(byte)
        else:
            yield from self._sequence(byte)

    def _ground(self, byte: int) -> Iterator[KeyPress]:
        self._alt = False
        if byte == _ESC:
            self._state = _State.ESCAPE
        elif byte >= 0xC2:
            self._state, self._remaining = _State.UTF8, 1 + (byte >= 0xE0) + (byte >= 0xF0)
        elif byte >= 0x80:  # one-byte forms of ESC [, ESC O ...; anything else is a stray byte
            self._introduce(byte - 0x40)
        elif byte in _CONTROL_NAMES:
            yield KeyPress(_CONTROL_NAMES[byte], ctrl=byte != 0x0D)
        elif byte < 0x20:
            yield KeyPress(chr(byte + 0x60), ctrl=True)
        else:
            yield from _character(byte, ctrl=False)

    def _introduce(self, byte: int) -> None:
        """Choose the state by the byte after ESC; every other byte ends the sequence (Alt+key)."""
        self._parameters = ""
        character = chr(byte)
        if character == "[":
            self._state = _State.CSI
        elif character == "O":
            self._state = _State.SS3
        elif character in "]P_^X":
            self._state = _State.STRING
        else:
            self._state = _State.GROUND

    def _sequence(self, byte: int) -> Iterator[KeyPress]:
        """Process a byte after ESC, ESC [, ESC O or ESC [ [."""
        if byte == _ESC:  # Alt+key as ESC ESC ..., or a new sequence after a broken one
            self._alt = self._state is _State.ESCAPE
            self._state = _State.ESCAPE
        elif byte >= 0x80:
            yield from self._ground(byte)
        elif byte < 0x20:
            self._state = _State.GROUND
        elif self._state is _State.ESCAPE:
            self._introduce(byte)
        elif self._state is _State.CONSOLE:
            self._state = _State.GROUND
        elif self._is_final(byte):
            yield from self._finish(chr(byte))
        elif len(self._parameters) < _SEQUENCE_MAX:
            self._parameters += chr(byte)

    def _is_final(self, byte: int) -> bool:
        if chr(byte) == "$" and self._state is _State.CSI:  # rxvt ends Shift+editing keys with a dollar sign
            return self._parameters.isdigit()
        return 0x40 <= byte < _DEL

    def _finish(self, final: str) -> Iterator[KeyPress]:
        state, self._state = self._state, _State.GROUND
        if state is _State.CSI and final == "[" and not self._parameters:
            self._state = _State.CONSOLE
        elif state is _State.CSI and final == "M" and not self._parameters:
            self._state, self._remaining = _State.MOUSE, 3
        elif state is _State.CSI and (self._parameters, final) == ("200", "~"):
            self._state, self._paste_tail = _State.PASTE, b""
        elif not self._alt:
            decode = _csi_key if state is _State.CSI else _ss3_key
            if (key := decode(self._parameters, final)) is not None:
                yield key

    def _utf8(self, byte: int) -> Iterator[KeyPress]:
        if 0x80 <= byte < 0xC0:
            self._remaining -= 1
            if self._remaining == 0:
                self._state = _State.GROUND
        else:  # a truncated character: this byte starts a new one
            self._state = _State.GROUND
            yield from self._ground(byte)

    def _paste(self, byte: int) -> None:
        self._paste_tail = (self._paste_tail + bytes((byte,)))[-len(_PASTE_END) :]
        if self._paste_tail == _PASTE_END:
            self._state = _State.GROUND

    def _string(self, byte: int) -> None:
        if byte == 0x07 or (self._state is _State.STRING_ESCAPE and chr(byte) == "\\"):
            self._state = _State.GROUND
        else:
            self._state = _State.STRING_ESCAPE if byte == _ESC else _State.STRING

    def _mouse(self, byte: int) -> None:
        """Process a mouse report of three characters, which may be UTF-8 pairs.

        A continuation byte belongs to the byte before it.
        """
        if not (0x80 <= byte < 0xC0 and self._remaining < 3):
            self._remaining -= 1
        if self._remaining == 0:
            # a pair may still be open: its second byte is a stray one in the ground state, which swallows it
            self._state = _State.UTF8 if 0xC2 <= byte < 0xE0 else _State.GROUND
            self._remaining = 1


def _character(code: int, ctrl: bool) -> Iterator[KeyPress]:
    """Yield the key of a printable ASCII code, upper and lower case alike; nothing for other codes."""
    character = chr(code) if 0 <= code <= _DEL else ""
    if name := _NAMED_CHARACTERS.get(character):
        yield KeyPress(name, ctrl=ctrl or code == _TAB)
    elif 0x20 < code < _DEL:
        yield KeyPress(character.lower(), ctrl)


def _numbers(parameters: str) -> list[int]:
    """Return the numbers of a parameter string without sub-parameters; empty if it is not numeric.

    For example, "1;5:1" gives 1, 5.
    """
    fields = [parameter.split(":")[0] or "1" for parameter in parameters.split(";")] if parameters else []
    return [int(text) for text in fields] if all(text.isdecimal() for text in fields) else []


def _ctrl(modifier: int) -> bool | None:
    """Return whether an xterm/kitty modifier (1 + bits) means Ctrl; None if Alt or Meta is down."""
    bits = max(modifier - 1, 0)
    return None if bits & ~(_CTRL | _IGNORED_MODIFIERS) else bool(bits & _CTRL)


def _csi_key(parameters: str, final: str) -> KeyPress | None:
    """Return the key of the sequence ESC [ parameters final, or None."""
    numbers = _numbers(parameters)
    if (parameters and not numbers) or _is_release(parameters):
        return None
    if final in _ARROWS:  # ESC [ A, ESC [ 1 ; 5 A, and the old ESC [ 5 A
        return _add_modifier(_ARROWS[final], numbers[1] if len(numbers) > 1 else numbers[0] if numbers else 1)
    if final in _RXVT_ARROWS and not numbers:
        return KeyPress(_RXVT_ARROWS[final])
    if not numbers:
        return None
    modifier = numbers[1] if len(numbers) > 1 else 1
    if final == "u":
        return _decode_code(numbers[0], modifier)
    if final == "~" and numbers[0] == 27 and len(numbers) == 3:
        return _decode_code(numbers[2], modifier)
    if final in "~$^@" and numbers[0] in _EDITING:  # rxvt: ^ is Ctrl, @ is Ctrl+Shift, $ is Shift
        return _add_modifier(_EDITING[numbers[0]], 5 if final in "^@" else modifier)
    return None


def _ss3_key(parameters: str, final: str) -> KeyPress | None:
    """Return the key of the sequence ESC O parameters final, or None."""
    numbers = _numbers(parameters)
    if parameters and not numbers:
        return None
    if final in _RXVT_ARROWS and not numbers:
        return KeyPress(_RXVT_ARROWS[final], ctrl=True)
    name = _ARROWS.get(final) or _SS3_KEYPAD.get(final)
    return None if name is None else _add_modifier(name, numbers[-1] if numbers else 1)


def _is_release(parameters: str) -> bool:
    """Return whether a kitty sequence reports a release.

    Its second field contains the event: 1 press, 2 repeat, 3 release.
    """
    fields = parameters.split(";")
    return len(fields) > 1 and fields[1].split(":")[1:2] == ["3"]


def _decode_code(code: int, modifier: int) -> KeyPress | None:
    """Return the key of a character code (kitty and modifyOtherKeys) with its modifier."""
    ctrl = _ctrl(modifier)
    if ctrl is None:
        return None
    if code in _KITTY_KEYPAD:
        return KeyPress(_KITTY_KEYPAD[code], ctrl)
    return next(_character(code, ctrl), None)


def _add_modifier(name: str, modifier: int) -> KeyPress | None:
    ctrl = _ctrl(modifier)
    return None if ctrl is None else KeyPress(name, ctrl)
