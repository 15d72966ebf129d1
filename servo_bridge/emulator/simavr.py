"""An ATmega328P from Debian's libsimavr through ctypes: firmware, time, pins, serial line, I2C, resets.

libsimavr is loaded at run time if it is installed (apt-get install libsimavr2); it is not part of this suite.
It was made for programs that observe a firmware. Driving one byte-exactly and fast needs the following; each
point was found by a wrong measurement:

* Bytes to the board come from cycle timers inside the emulation. A loop around `avr_run` cannot deliver them
  in time: a sleeping core jumps to its next timer, and they would arrive in bunches.
* This module stores whether such a timer runs: `avr_cycle_timer_status` reports "none" for an overdue one.
* The UART delays a delivered byte by its whole byte time, and halves the rate while another one waits. So its
  byte time is short during the delivery and is restored for the sending side. That byte time is 11 bits: the
  board sends a tenth slower than a real one.
* Its receiver buffers 64 bytes, that of the chip two and one in progress: overruns of the chip are counted
  here.
* By default it sleeps in wall time at every read of the status register, and prints sent bytes. Both are
  switched off.
* A core whose firmware sleeps would sleep in wall time, too: `avr->sleep` is replaced.
* One `avr_run` is one instruction unless `run_cycle_limit` is raised. Every reset, including the watchdog's,
  restores the limit and removes all cycle timers; a reset by the watchdog is detected by that.
* A sleeping core overshoots the end of a time slice unless a timer is set there.
* Time does not advance in a core that is done or has crashed: a loop until some time would never end.
* An external reset must set its bit in MCUSR explicitly, or a boot loader cannot know why it runs. The RAM is
  unchanged by a reset, as on the chip.
* The I2C bus leaves its flag "done" set while a byte is transferred, and reports for an acknowledged address
  the status of a byte: the flag is cleared here, and the firmware accepts both as acknowledged.
* A new prescaler of a running watchdog applies only from the next time that the watchdog is reset.
* The callbacks must stay referenced as long as the core exists, and the library needs a log function.
* The layout of the C structures is the same in simavr 1.6 and 1.7, and checked at start.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from softsim_core.base import SoftSimError

# Conditions on the bus in messages of simavr: bits 8..15 of the value; address in 16..23, data in 24..31.
_START, _STOP, _ACKNOWLEDGE, _WRITE, _READ = 1 << 0, 1 << 1, 1 << 3, 1 << 4, 1 << 5


@dataclass(slots=True)
class I2cRegisters:
    """A device of 256 registers on the I2C bus.

    The first written byte selects a register; the next ones are stored from there on.
    """

    address: int  # address on the bus, 7 bits
    registers: bytearray = field(default_factory=lambda: bytearray(256))  # the registers' contents
    present: bool = True  # whether it responds; False models an unplugged cable
    _selected: int = -1
    _pointer: int | None = None

    def answer(self, value: int) -> int | None:
        """Return the bus's next message after a message of the processor; None if there is none."""
        conditions, address, data = value >> 8 & 0xFF, value >> 16 & 0xFF, value >> 24 & 0xFF
        if conditions & _STOP:
            self._selected = -1
        if conditions & _START:
            self._selected = -1
            if self.present and address >> 1 == self.address:
                self._selected = address
                if not address & 1:
                    self._pointer = None
                return self._message(_ACKNOWLEDGE, 1)
        if self._selected < 0:
            return None
        if conditions & _WRITE:
            if self._pointer is None:
                self._pointer = data
            else:
                self.registers[self._pointer] = data
                self._pointer = (self._pointer + 1) % 256
            return self._message(_ACKNOWLEDGE, 1)
        if conditions & _READ:
            pointer = self._pointer or 0
            self._pointer = (pointer + 1) % 256
            return self._message(_READ, self.registers[pointer])
        return None

    def _message(self, conditions: int, data: int) -> int:
        return conditions << 8 | self._selected << 16 | data << 24


class EmulatorMissingError(SoftSimError, OSError):
    """The processor's emulator is not installed, or its version has an unknown memory layout."""


class EmulatorError(SoftSimError, RuntimeError):
    """The emulated processor cannot continue, or a firmware image cannot be loaded into it."""


def read_image(path: Path | str) -> tuple[int, bytes]:
    """Read an Intel hex file; return the address of its first byte and its bytes, gaps filled with 0xFF.

    Raises:
        EmulatorError: the file is missing, is no Intel hex, or has a wrong checksum; the message names file
            and line.
    """
    try:
        lines = Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise EmulatorError(
            f"firmware {path} cannot be read ({error}); give an Intel hex file, such as tripod.hex"
        ) from error
    pieces: dict[int, bytes] = {}
    base = 0
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where, record = f"{path}, line {number}", line.strip()
        try:
            raw = bytes.fromhex(record[1:])
        except ValueError:
            raw = b""
        if record[:1] != ":" or len(raw) < 5 or len(raw) != raw[0] + 5:
            raise EmulatorError(f"{where}: {record[:20]!r} is no line of an Intel hex file")
        if sum(raw) & 0xFF:
            raise EmulatorError(
                f"{where}: the checksum is wrong; the file is damaged, build or copy it again"
            )
        kind, address, data = raw[3], int.from_bytes(raw[1:3], "big"), raw[4:-1]
        if kind == 0:
            pieces[base + address] = data
        elif kind == 1:
            break
        elif kind in (2, 4):
            base = int.from_bytes(data, "big") << (4 if kind == 2 else 16)
    if not pieces:
        raise EmulatorError(f"firmware {path} holds no bytes; give an Intel hex file, such as tripod.hex")
    start = min(pieces)
    image = bytearray(b"\xff" * (max(at + len(data) for at, data in pieces.items()) - start))
    for at, data in pieces.items():
        image[at - start : at - start + len(data)] = data
    return start, bytes(image)


FREQUENCY = 16_000_000  # cycles per second of the board's crystal
BAUD_RATE = 115200  # default speed of the line to the board
FLASH_SIZE = 0x8000
POWER_ON, EXTERNAL = 1 << 0, 1 << 1  # reset causes, as in the register MCUSR
LIBRARY_VARIABLE = "SOFTSIM_SIMAVR"
INSTALL = "install it with: sudo apt-get install libsimavr2 (Debian, Ubuntu)"

# Offsets in bytes inside the C structures of simavr 1.6 and 1.7 on 64-bit machines.
_FLASHEND, _STATE, _FREQUENCY, _CYCLE, _LIMIT = 12, 60, 64, 80, 96
_SLEEP, _PC, _RESET_PC, _FLASH, _DATA = 168, 204, 208, 11712, 11720
_UART_FIFO_READ, _UART_FIFO_WRITE, _UART_CYCLES_PER_BYTE = 576, 578, 592
_RUNNING, _DONE, _CRASHED = 2, 6, 7
_MCUSR = 0x54
_TWCR, _TWINT = 0xBC, 1 << 7
_RAM_START, _RAM_SIZE = 0x100, 0x800
_RUN_LIMIT = 1000
_HAND_OVER_CYCLES = 8
_CHIP_FIFO = 2
_TimerFunction = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_void_p)
_IrqFunction = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p)
_SleepFunction = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_uint64)
_LogFunction = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p)


def _ioctl_code(text: str) -> int:
    return int.from_bytes(text.encode("ascii"), "big")


_silent = _LogFunction(lambda core, level, text, arguments: None)
_awake = _SleepFunction(lambda core, cycles: None)
_library: ctypes.CDLL | None = None
_library_lock = threading.Lock()


def load_library() -> ctypes.CDLL:
    """Return the emulator's library, loaded once.

    Raises:
        EmulatorMissingError: it is not installed, or its memory layout is unknown.
    """
    global _library
    with _library_lock:
        if _library is None:
            library = _open_library()
            try:
                _declare(library)
            except AttributeError as error:
                raise EmulatorMissingError(f"{library._name} is no simavr ({error}); {INSTALL}") from error
            library.avr_global_logger_set(_silent)
            core = library.avr_make_mcu_by_name(b"atmega328p")
            if not core:
                raise EmulatorMissingError("the emulator's library knows no ATmega328P; " + INSTALL)
            library.avr_init(core)
            places = (_FLASHEND, _FREQUENCY, _STATE)
            layout = tuple(ctypes.c_uint32.from_address(core + place).value for place in places)
            if layout != (FLASH_SIZE - 1, 1_000_000, _RUNNING):
                raise EmulatorMissingError(
                    f"the emulator's library is of a version whose layout is not known (it shows {layout});"
                    f" versions 1.6 and 1.7 are: {INSTALL}"
                )
            library.avr_terminate(core)
            _library = library
        return _library


def why_missing() -> str:
    """Return a message that says why no board can be emulated here; empty if one can."""
    try:
        load_library()
    except EmulatorMissingError as error:
        return str(error)
    return ""


def _open_library() -> ctypes.CDLL:
    chosen = os.environ.get(LIBRARY_VARIABLE, "")
    names = [chosen] if chosen else ["libsimavr.so.2", ctypes.util.find_library("simavr") or "libsimavr.so"]
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    raise EmulatorMissingError(f"the board's emulator is missing ({', '.join(names)}); {INSTALL}")


def _declare(library: ctypes.CDLL) -> None:
    pointer, word, long = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint64
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "avr_make_mcu_by_name": (pointer, [ctypes.c_char_p]),
        "avr_init": (ctypes.c_int, [pointer]),
        "avr_run": (ctypes.c_int, [pointer]),
        "avr_reset": (None, [pointer]),
        "avr_terminate": (None, [pointer]),
        "avr_ioctl": (ctypes.c_int, [pointer, word, pointer]),
        "avr_io_getirq": (pointer, [pointer, word, ctypes.c_int]),
        "avr_irq_register_notify": (None, [pointer, _IrqFunction, pointer]),
        "avr_raise_irq": (None, [pointer, word]),
        "avr_cycle_timer_register": (None, [pointer, long, _TimerFunction, pointer]),
        "avr_cycle_timer_cancel": (None, [pointer, _TimerFunction, pointer]),
        "avr_global_logger_set": (None, [_LogFunction]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments


class Processor:
    """One emulated ATmega328P; time passes only inside `run_to`.

    Args:
        image: Pieces of flash: address and bytes each.
        start: Address at which it starts after a reset: 0, or the address of the boot loader.
        on_pin: Called with (channel 0..2, level 0 or 1, cycle) at every edge of pins 9, 10, 11.
        on_byte: Called with every byte that the firmware sends.
        on_reset: Called after every reset by the watchdog.
        baud_rate: Speed of the line to the board; a byte takes ten bits.

    Attributes:
        flash: The program memory; writing to it changes what the processor runs.
        lost_bytes: Number of bytes that arrived while the chip's receiver was full; on the chip they overrun.
        resets: Number of resets so far, including the first power-on.

    Raises:
        EmulatorMissingError: no usable libsimavr here.
        EmulatorError: the image does not fit into the flash.
    """

    def __init__(
        self,
        image: list[tuple[int, bytes]],
        start: int,
        on_pin: Callable[[int, int, int], None],
        on_byte: Callable[[int], None],
        on_reset: Callable[[], None],
        baud_rate: int = BAUD_RATE,
    ) -> None:
        self._library = load_library()
        for address, data in image:
            if address + len(data) > FLASH_SIZE:
                raise EmulatorError(
                    f"{len(data)} bytes at {address:#x} do not fit into the {FLASH_SIZE} bytes of flash"
                )
        core = self._library.avr_make_mcu_by_name(b"atmega328p")
        self._library.avr_init(core)
        self._core: int = core
        self._on_reset = on_reset
        self._byte_cycles = round(10 * FREQUENCY / baud_rate)
        self._bus_hooks: list[Any] = []
        self._waiting: deque[int] = deque()
        self._feeding = False
        self.lost_bytes = self.resets = 0
        ctypes.c_uint32.from_address(core + _FREQUENCY).value = FREQUENCY
        ctypes.c_uint32.from_address(core + _RESET_PC).value = start
        ctypes.c_void_p.from_address(core + _SLEEP).value = ctypes.cast(_awake, ctypes.c_void_p).value
        self._cycle = ctypes.c_uint64.from_address(core + _CYCLE)
        self._limit = ctypes.c_uint64.from_address(core + _LIMIT)
        self._pc = ctypes.c_uint32.from_address(core + _PC)
        flash = ctypes.c_void_p.from_address(core + _FLASH).value
        memory = ctypes.c_void_p.from_address(core + _DATA).value
        assert flash is not None
        assert memory is not None
        self._ram = (ctypes.c_uint8 * _RAM_SIZE).from_address(memory + _RAM_START)
        self.flash = (ctypes.c_uint8 * FLASH_SIZE).from_address(flash)
        self._bus_control = ctypes.c_uint8.from_address(memory + _TWCR)
        self._mcusr = ctypes.c_uint8.from_address(memory + _MCUSR)
        for address, piece in image:
            self.flash[address : address + len(piece)] = list(piece)

        self._connect(on_pin, on_byte)
        self.reset(POWER_ON)

    @property
    def cycle(self) -> int:
        """Cycles since the first power-on; resets do not set it back."""
        return self._cycle.value

    @property
    def program_counter(self) -> int:
        """Address in bytes of the next instruction."""
        return self._pc.value

    @property
    def waiting(self) -> int:
        """Number of bytes still on the line to the board."""
        return len(self._waiting)

    def feed(self, data: bytes) -> None:
        """Put bytes on the line to the board; they arrive one by one as time passes."""
        self._waiting.extend(data)
        if self._waiting and not self._feeding:
            self._feeding = True
            self._library.avr_cycle_timer_register(self._core, self._byte_cycles, self._feed_timer, None)

    def attach(self, device: I2cRegisters) -> None:
        """Put a device on the I2C bus."""
        library, core = self._library, self._core
        bus, control = _ioctl_code("twi\0"), self._bus_control
        into = library.avr_io_getirq(core, bus, 0)

        def hook(irq: int, value: int, parameter: int) -> None:
            answer = device.answer(value)
            control.value &= ~_TWINT
            if answer is not None:
                library.avr_raise_irq(into, answer)

        function = _IrqFunction(hook)
        self._bus_hooks.append(function)
        library.avr_irq_register_notify(library.avr_io_getirq(core, bus, 1), function, None)

    def run_to(self, cycle: int) -> None:
        """Advance to a cycle; it ends at most one instruction late.

        Raises:
            EmulatorError: the processor crashed or stopped for good.
        """
        library, core, now, limit = self._library, self._core, self._cycle, self._limit
        if now.value >= cycle:
            return
        library.avr_cycle_timer_register(core, cycle - now.value, self._end_timer, None)
        run = library.avr_run
        while now.value < cycle:
            state = run(core)
            if limit.value != _RUN_LIMIT:
                self._after_reset()
                self._on_reset()
                library.avr_cycle_timer_register(core, max(1, cycle - now.value), self._end_timer, None)
            if state in (_DONE, _CRASHED):
                raise EmulatorError(
                    f"the emulated processor stopped at {self.program_counter:#06x} after "
                    f"{now.value / FREQUENCY:.3f} s; the firmware ran into erased or foreign code"
                )

    def reset(self, cause: int = EXTERNAL) -> None:
        """Reset it; bytes on the line to the board are received by the program that runs next."""
        self._library.avr_reset(self._core)
        self._mcusr.value = cause
        self._after_reset()

    def forget_memory(self) -> None:
        """Fill the RAM as a loss of power does; call a power-on reset afterwards."""
        self._ram[:] = [0xA5] * _RAM_SIZE

    def close(self) -> None:
        """Free the emulator's memory; a second call does nothing."""
        if self._core:
            self._library.avr_terminate(self._core)
            self._core = 0

    def _connect(self, on_pin: Callable[[int, int, int], None], on_byte: Callable[[int], None]) -> None:
        library, core = self._library, self._core
        serial = _ioctl_code("uar0")
        self._receive_irq: int = library.avr_io_getirq(core, serial, 0)
        no_flags = ctypes.c_uint32(0)  # neither wall-clock sleeps nor an echo on stdout
        library.avr_ioctl(core, _ioctl_code("uas0"), ctypes.byref(no_flags))

        self._byte_hook = _IrqFunction(lambda irq, value, parameter: on_byte(value & 0xFF))
        library.avr_irq_register_notify(library.avr_io_getirq(core, serial, 1), self._byte_hook, None)
        cycle = self._cycle
        self._pin_hooks = []
        for channel in range(3):

            def hook(irq: int, value: int, parameter: int, channel: int = channel) -> None:
                on_pin(channel, value & 1, cycle.value)

            function = _IrqFunction(hook)
            self._pin_hooks.append(function)
            pin = library.avr_io_getirq(core, _ioctl_code("iogB"), channel + 1)
            library.avr_irq_register_notify(pin, function, None)

        uart = self._uart_address()
        self._uart_byte_time = ctypes.c_uint64.from_address(uart + _UART_CYCLES_PER_BYTE)
        self._fifo_read = ctypes.c_uint16.from_address(uart + _UART_FIFO_READ)
        self._fifo_write = ctypes.c_uint16.from_address(uart + _UART_FIFO_WRITE)
        self._feed_timer = _TimerFunction(self._feed_one)
        self._end_timer = _TimerFunction(lambda core, when, parameter: 0)

    def _uart_address(self) -> int:
        """Return the address of the UART's structure: the parameter of its hook on its input line."""
        hook = ctypes.c_void_p.from_address(self._receive_irq + 32).value
        while hook:
            # struct avr_irq_hook_t: next, busy (int), chain, notify, param
            parameter = ctypes.c_void_p.from_address(hook + 32).value
            if parameter and ctypes.c_char.from_address(parameter + 72).value == b"0":
                return parameter
            hook = ctypes.c_void_p.from_address(hook).value
        raise EmulatorMissingError("the emulator's serial line has a layout that is not known; " + INSTALL)

    def _after_reset(self) -> None:
        self._limit.value = _RUN_LIMIT
        self.resets += 1
        self._feeding = False
        self.feed(b"")

    def _feed_one(self, core: int, when: int, parameter: int) -> int:
        if not self._waiting:
            self._feeding = False
            return 0
        value = self._waiting.popleft()
        if (self._fifo_write.value - self._fifo_read.value) % 64 > _CHIP_FIFO:
            self.lost_bytes += 1
        else:
            usual = self._uart_byte_time.value
            self._uart_byte_time.value = _HAND_OVER_CYCLES  # else the UART delays it by a byte time
            self._library.avr_raise_irq(self._receive_irq, value)
            self._uart_byte_time.value = usual
        return when + self._byte_cycles
