"""`softsim flash`: write the firmware to the servo board with avrdude; asks first."""

from __future__ import annotations

import argparse
import hashlib
import shlex
import shutil
import sys
from pathlib import Path

from softsim_core.base import run_process
from softsim_ros.cli import CommandError, add_number

BAUD_RATE = 115200
OLD_NANO_BAUD_RATE = 57600


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--port", default="", metavar="PATH", help="the board's port (the one plugged in)")
    parser.add_argument("--hex", type=Path, metavar="FILE", help="another firmware (this package's own)")
    speeds = f"speed of the board's boot loader: {BAUD_RATE} (default), {OLD_NANO_BAUD_RATE} on old Nanos"
    add_number(parser, "--baud", BAUD_RATE, "N", speeds)
    parser.add_argument("--dry-run", action="store_true", help="say what would be done, and stop")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.epilog = "Stop the bridge first, and switch off the servos' supply: their pulses end meanwhile."


def run(arguments: argparse.Namespace) -> int:
    """Flash the board; return 0 if avrdude wrote and verified it.

    Raises:
        CommandError: it was refused, or could not.
        PortError: the port is in use, missing, or not allowed; the message says what to do.
    """
    from servo_bridge import PortError
    from servo_bridge.driver import SerialTransport, find_port
    from servo_bridge.emulator import FIRMWARE, read_image

    image = Path(arguments.hex or FIRMWARE)
    _, content = read_image(image)
    if arguments.hex is None and not is_as_recorded(image):
        raise CommandError(
            f"{image} is not the file its checksum was made of; copy or check out the package again"
        )
    try:
        port = find_port(arguments.port)
    except PortError as error:
        if not arguments.dry_run:
            raise
        port = "PORT"
        print(f"{error}\n")
    command = flash_command(port, image, arguments.baud)
    print(f"firmware: {image} ({len(content)} bytes)\nboard:    ATmega328P on {port}, which is reset twice")
    print(f"command:  {shlex.join(command)}")
    if arguments.dry_run:
        print("nothing was done (--dry-run)")
        return 0
    if shutil.which(command[0]) is None:
        raise CommandError("avrdude is not installed; run: sudo apt-get install avrdude")
    if not arguments.yes and not (
        sys.stdin.isatty() and input("write it? [yes/no] ").strip().lower() in ("y", "yes")
    ):
        raise CommandError("nothing was done; answer yes, or give --yes")
    with SerialTransport(port, arguments.baud):
        pass  # refuses a port that another program has open: avrdude would not notice, and both lose bytes
    code = run_process(command).returncode
    if code:
        raise CommandError(
            f"avrdude failed (exit code {code}); close other programs on {port}, check that the board "
            f"is an Uno or Nano, and on an old Nano add --baud {OLD_NANO_BAUD_RATE}"
        )
    print("done: the firmware runs; softsim up tripod --board auto")
    return 0


def flash_command(port: str, image: Path, baud_rate: int) -> list[str]:
    """Return the avrdude command line that writes and verifies the flash of an Uno or Nano."""
    write = f"flash:w:{image}:i"
    return ["avrdude", "-c", "arduino", "-p", "m328p", f"-b{baud_rate}", "-P", port, "-U", write]


def is_as_recorded(image: Path) -> bool:
    """Return whether an image has the checksum in the file beside it."""
    record = image.with_suffix(".sha256")
    expected = [hashlib.sha256(image.read_bytes()).hexdigest(), image.name]
    return any(line.split() == expected for line in record.read_text().splitlines())
