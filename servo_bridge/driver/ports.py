"""Ports of boards: find the one that the board is on, and open it; serial ports for one user only."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import select
import socket
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import serial
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from servo_bridge import PortError
from softsim_core.base import SoftSimError, listing, open_lock, runtime_folder

READ_TIMEOUT_S = 0.05
WRITE_TIMEOUT_S = 0.2
BRLTTY = "if it vanishes right after plugging in on Ubuntu, remove the package brltty: it takes CH340 chips"


class Transport(Protocol):
    """An open port to a board; `SerialTransport` is one, and `register_transport` adds other kinds.

    Attributes:
        port: Its name, for messages.
    """

    port: str

    def write(self, packet: bytes) -> None:
        """Send one packet; raise PortError if the port failed."""

    def read(self) -> bytes:
        """Return received bytes, none after a short time without any; raise PortError if the port failed."""

    def cancel_read(self) -> None:
        """End a `read` that waits in another thread."""

    def close(self) -> None:
        """Close the port; a second call does nothing."""


class SerialTransport(contextlib.AbstractContextManager["SerialTransport"]):
    """An open serial port: whole packets out, bytes in.

    One thread may read while another one writes. The modem lines are not set: opening a port resets most
    boards in any case, and a pseudo-terminal has no modem lines.

    Raises:
        PortError: the port cannot be opened; the message says why and what to do.
    """

    def __init__(self, port: str, baud_rate: int = 115200) -> None:
        self.port = port
        try:
            self._serial = serial.Serial(port, baud_rate, timeout=READ_TIMEOUT_S, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise PortError(port, opening_error_message(port, error)) from error

    @property
    def is_open(self) -> bool:
        """Whether the port has not been closed yet."""
        return bool(self._serial.is_open)

    def write(self, packet: bytes) -> None:
        """Send one packet, in one write if the port has room for it.

        Raises:
            PortError: the port vanished, was closed, or accepts no data for 0.2 s.
        """
        # Only the port decides whether it accepts data. Pyserial's own time limit reads the clock after it
        # has written: if this process is paused there, it reports a failure for a packet that was sent.
        while packet:
            taken = 0
            try:
                _, ready, _ = select.select([], [self._serial.fileno()], [], WRITE_TIMEOUT_S)
                taken = os.write(self._serial.fileno(), packet) if ready else 0
            except BlockingIOError:
                pass
            except (OSError, TypeError) as error:  # TypeError: another thread closed the port
                raise PortError(self.port, self._describe_loss()) from error
            if not taken:
                raise PortError(
                    self.port,
                    f"the board on {self.port} took no data for {WRITE_TIMEOUT_S} s; unplug it and plug it"
                    " in",
                )
            packet = packet[taken:]

    def read(self) -> bytes:
        """Return what was received; wait for the first byte for 0.05 s at most.

        Raises:
            PortError: the port vanished or was closed.
        """
        try:
            data = bytes(self._serial.read(1))
            waiting = self._serial.in_waiting if data else 0
            return data + bytes(self._serial.read(waiting)) if waiting else data
        except (OSError, TypeError) as error:
            raise PortError(self.port, self._describe_loss()) from error

    def cancel_read(self) -> None:
        """End a `read` that waits in another thread."""
        with contextlib.suppress(OSError, AttributeError):  # vanished or closed: nothing waits any more
            self._serial.cancel_read()

    def close(self) -> None:
        """Close the port; a second call, or one on a vanished port, does nothing."""
        try:
            self._serial.close()
        except OSError:  # a vanished device may refuse even this; its descriptor is gone all the same
            self._serial.is_open = False

    def __exit__(self, *error: object) -> None:
        self.close()

    def _describe_loss(self) -> str:
        message = f"port {self.port} vanished (board unplugged, or its USB supply failed); plug it in again"
        return f"{message}; {BRLTTY}" if _is_usb_adapter(self.port) else message


class UdpTransport:
    """A board on the network, named udp:HOST:PORT: each packet is a datagram.

    Only datagrams from that address are received. While none come, empty ones are sent: they contain the
    address to which the board sends. A board that is silent cannot be distinguished from none, unless its
    computer reports that no program receives at that port. An IPv6 address stands in brackets; the baud rate
    is not used.

    Raises:
        PortError: the name is none of that form, or names no host.
    """

    def __init__(self, port: str, baud_rate: int = 0) -> None:
        self.port = port
        try:
            parts = re.fullmatch(r"udp:(?:\[([^\]]+)\]|([^:\[\]]+)):([0-9]{1,5})", port)
            if parts is None or not 0 < int(parts[3]) < 65536:
                raise ValueError("the form is udp:HOST:PORT, such as udp:192.168.4.1:4210")
            family, kind, protocol, _, place = socket.getaddrinfo(
                parts[1] or parts[2], parts[3], type=socket.SOCK_DGRAM
            )[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.connect(place)
            self._socket.setblocking(False)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise PortError(port, f"port {port} cannot be opened: {reason}") from error

    def write(self, packet: bytes) -> None:
        """Send one packet as a datagram, which may be lost on its way.

        Raises:
            PortError: the port was closed, the network is down, or no program receives there.
        """
        with contextlib.suppress(BlockingIOError):  # no room: the next packet is newer
            self._try(self._socket.send, packet)

    def read(self) -> bytes:
        """Return the next datagram; after 0.05 s without one, send an empty one."""
        ready, _, _ = self._try(select.select, [self._socket], [], [], READ_TIMEOUT_S)
        if not ready:
            self.write(b"")
            return b""
        try:
            return bytes(self._try(self._socket.recv, 65536))
        except BlockingIOError:  # the datagram was damaged
            return b""

    def _try(self, action: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return action(*arguments)
        except BlockingIOError:
            raise
        except ConnectionRefusedError as error:
            raise PortError(self.port, f"no program receives at {self.port}; start the board") from error
        except (OSError, ValueError) as error:  # ValueError: another thread closed the port
            raise PortError(self.port, f"port {self.port} failed ({error}); is the network up?") from error

    def cancel_read(self) -> None:
        """Do nothing: a read ends by itself soon."""

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        self._socket.close()


class _OneUserTransport:
    """A port that the system does not lock, for one program of this user; the lock ends with the program."""

    def __init__(self, port: str, baud_rate: int, opener: Opener) -> None:
        import fcntl  # not on every system whose users convert angles

        self.port = port
        try:
            name = hashlib.sha256(port.encode()).hexdigest()[:16]
            self._lock = open_lock(runtime_folder() / f"softsim-port-{name}.lock")
        except SoftSimError as error:
            raise PortError(port, f"port {port} cannot be locked: {error}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._transport = opener(port, baud_rate)
        except BlockingIOError as error:
            self._lock.close()
            raise PortError(
                port, f"port {port} is in use by another program (another bridge?); stop that program first"
            ) from error
        except BaseException:
            self._lock.close()
            raise
        self.write, self.read = self._transport.write, self._transport.read
        self.cancel_read = self._transport.cancel_read

    def close(self) -> None:
        """Close the port, then release it; a second call does nothing."""
        try:
            self._transport.close()
        finally:
            self._lock.close()


# Opens a port by its name and its bits per second; raises PortError if it cannot
Opener: TypeAlias = Callable[[str, int], Transport]
_openers: dict[str, Opener] = {"udp": UdpTransport}


def register_transport(kind: str, opener: Opener) -> None:
    """Register what opens the ports named "KIND:...", such as a CAN bus.

    A kind that is registered again gets the new opener, since a scene that is loaded again registers again.

    Raises:
        PortError: the kind has other characters than small letters, digits and _.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", kind):
        raise PortError("", f"kind of port {kind!r} cannot be used; give small letters, digits and _")
    _openers[kind] = opener


def open_transport(port: str, baud_rate: int) -> Transport:
    """Open a port by its name: a serial device, "udp:HOST:PORT", or "KIND:..." of a registered kind.

    Raises:
        PortError: the port cannot be opened; the message says why and what to do.
    """
    kind, colon, _ = port.partition(":")
    opener = _openers.get(kind) if colon else None
    if opener is not None:
        return _OneUserTransport(port, baud_rate, opener)
    if colon and re.fullmatch(r"[a-z][a-z0-9_]*", kind) and not os.path.lexists(port):
        kinds = listing(f"{each}:..." for each in sorted(_openers))
        raise PortError(
            port,
            f"port {port} cannot be opened: {kind} is no known kind of port (known: serial devices,"
            f" {kinds}); the robot's Python file can register one",
        )
    return SerialTransport(port, baud_rate)


def opening_error_message(port: str, error: BaseException) -> str:
    """Return a message that says why a port cannot be opened, and what to do."""
    code = _error_number(error)
    if code in (errno.EACCES, errno.EPERM):
        return (
            f"no permission to open {port}; run: sudo usermod -aG dialout $USER, then log out and in, or"
            " install configs/udev/99-tripod.rules (in a container: --device and --group-add dialout)"
        )
    if code in (errno.EAGAIN, errno.EBUSY):
        return (
            f"port {port} is in use by another program (another bridge, a serial monitor, an upload);"
            " stop that program first; ModemManager tries every new port for some seconds:"
            " configs/udev/99-tripod.rules keeps it away"
        )
    if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        if not port:
            return (
                "no port is named; name the board's (ls -l /dev/serial/by-id), or let"
                " servo_bridge.driver.find_port() search for it"
            )
        if not os.path.lexists(port):
            advice = (
                "plug the board in, or give another name with the parameter port (ls -l /dev/serial/by-id)"
            )
            if _is_usb_adapter(port):
                advice += f"; {BRLTTY}"
            return f"port {port} does not exist; {advice}"
        return f"port {port} has no device behind it; plug the board in"
    if code in (errno.ENOTTY, errno.EISDIR, errno.EINVAL, errno.ENOTDIR):
        return f"{port} is not a serial port; give the board's with the parameter port, e.g. /dev/ttyACM0"
    if code == errno.EIO:
        return f"port {port} does not answer (input/output error); unplug the board and plug it in again"
    return f"port {port} cannot be opened: {error}"


def _is_usb_adapter(port: str) -> bool:
    try:
        target = os.path.realpath(port)
    except OSError:  # the link vanishes at this moment
        target = port
    return Path(port).name.startswith("ttyUSB") or Path(target).name.startswith("ttyUSB")


def _error_number(error: BaseException | None) -> int | None:
    """Return the error number of an exception, or of its cause (pyserial drops it in some places)."""
    while error is not None:
        if isinstance(error, OSError) and error.errno is not None:
            return error.errno
        if type(error).__module__ == "termios" and error.args and isinstance(error.args[0], int):
            return error.args[0]
        error = error.__context__
    return None


BY_ID = Path("/dev/serial/by-id")  # folder of links that keep their names when a port's number changes
# Vendor and product ids of genuine Uno boards
BOARD_USB_IDS = {(0x2341, 0x0043), (0x2341, 0x0001), (0x2A03, 0x0043), (0x2341, 0x0243), (0x2341, 0x006A)}
CLONE_USB_IDS = {(0x1A86, 0x7523), (0x0403, 0x6001), (0x10C4, 0xEA60)}
"""USB-serial chips (CH340, FT232, CP210x) of cheap boards and of other devices; never chosen automatically.

Many of them have no serial number, or all the same one.
"""

NAME_PORT_HINT = "name it with the parameter port (port:=/dev/...)"


def find_port(port: str = "", *, ports: Iterable[ListPortInfo] | None = None, by_id: Path = BY_ID) -> str:
    """Return the board's port: `port` itself if given, else the port of the one board that is plugged in.

    The search is among `ports`, where None asks the system, and returns a link of /dev/serial/by-id if there
    is one.

    Raises:
        PortError: no board, or more than one; the message lists the ports found.
    """
    if port:
        return port
    found_ports = sorted(list_ports.comports() if ports is None else ports, key=lambda info: info.device)
    boards = {
        Path(info.device).resolve(): info.device
        for info in found_ports
        if (info.vid, info.pid) in BOARD_USB_IDS or "arduino" in (info.manufacturer or "").lower()
    }
    links = sorted(by_id.iterdir()) if by_id.is_dir() else []
    for link in links:
        if "arduino" in link.name.lower() or link.resolve() in boards:
            boards[link.resolve()] = str(link)
    if len(boards) == 1:
        return next(iter(boards.values()))
    if boards:
        raise PortError("", f"several boards found ({', '.join(sorted(boards.values()))}); {NAME_PORT_HINT}")
    clones = [
        f"{info.device} ({info.description})" for info in found_ports if (info.vid, info.pid) in CLONE_USB_IDS
    ]
    if clones:
        raise PortError(
            "",
            f"no certain board found; {', '.join(clones)} may be one or any other gadget: {NAME_PORT_HINT}",
        )
    others = ", ".join(info.device for info in found_ports) or "none"
    raise PortError(
        "", f"no board found (serial ports found: {others}); plug the board in, or {NAME_PORT_HINT}"
    )


def stable_name(port: str, by_id: Path = BY_ID) -> str:
    """Return the link of /dev/serial/by-id that leads to an open port; empty if there is none."""
    target = Path(port).resolve()
    links = sorted(by_id.iterdir()) if by_id.is_dir() else []
    return next((str(link) for link in links if link.resolve() == target), "")


def usb_identity(port: str, ports: Iterable[ListPortInfo] | None = None) -> str:
    """Return the identity of a port's USB chip, which stays the same when it is plugged in again.

    Returns:
        Vendor, product and serial number; the USB socket instead of a serial number that does not distinguish
        chips. Empty without a USB chip, as for a pseudo-terminal.
    """
    target = Path(port).resolve()
    found_ports = list_ports.comports() if ports is None else ports
    return next((_identity(info) for info in found_ports if Path(info.device).resolve() == target), "")


def _identity(info: ListPortInfo) -> str:
    if info.vid is None or info.pid is None:
        return ""
    socket = info.location or ""
    which = f"in USB socket {socket}"
    if info.serial_number and (info.vid, info.pid) not in CLONE_USB_IDS:
        _, _, interface = socket.partition(":")  # one of several interfaces of a chip
        number = info.serial_number.encode("unicode_escape").decode()
        which = f"serial number {number}{interface and f' interface {interface}'}"
    return f"USB {info.vid:04x}:{info.pid:04x} {which}"


def find_same_device(
    port: str, stable: str, usb: str = "", *, ports: Iterable[ListPortInfo] | None = None
) -> str:
    """Return the port to open after one was lost: that of the same device, whatever its number.

    Args:
        port: Name from the user; empty searches, see `find_port`.
        stable: Result of `stable_name` while the port was open; empty: none.
        usb: Result of `usb_identity` then; empty: none.
        ports: As for `find_port`.

    Raises:
        PortError: the device is missing, even if another device now has the user's name for it; errors of
            `find_port` if neither name nor identity is known.
    """
    if usb:
        found_ports = list_ports.comports() if ports is None else ports
        there = [info.device for info in found_ports if _identity(info) == usb]
        if len(there) > 1:
            raise PortError(
                port, f"{listing(sorted(there))} are the same to USB ({usb}); plug in the configured one only"
            )
        found = there[0] if there else ""
    else:
        found = stable if stable and Path(stable).exists() else ""
    if found:
        return found
    if not usb and not stable:
        return find_port(port)
    other = f", and {port} may be another device by now" if port and Path(port).exists() else ""
    raise PortError(
        stable or port,
        f"{stable or usb} is not plugged in{other}; plug it in, or for another board cleanup and configure",
    )
