"""Building firmware and boot loader in tests, where Debian's compiler for the AVR is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "servo_bridge" / "firmware"
OPTIBOOT = Path("/usr/share/arduino/hardware/arduino/avr/bootloaders/optiboot/optiboot.c")
OPTIBOOT_FLAGS = (
    "-Os -fno-split-wide-types -mrelax -fno-inline-small-functions -fno-strict-aliasing -mmcu=atmega328p"
    " -DF_CPU=16000000L -DLED_START_FLASHES=3 -DBAUD_RATE=115200 -Wl,--section-start=.text=0x7c00"
    " -Wl,--relax -nostartfiles"
)


def missing(reason: str) -> None:
    """Skip, or fail where REQUIRE_SIMAVR is set."""
    if os.environ.get("REQUIRE_SIMAVR"):
        pytest.fail(reason)
    pytest.skip(reason)


@cache
def builds() -> tempfile.TemporaryDirectory[str]:
    """A folder that lasts as long as this process."""
    return tempfile.TemporaryDirectory(prefix="softsim_firmware_")


def new_folder() -> Path:
    return Path(tempfile.mkdtemp(dir=builds().name))


@cache
def compiler_version() -> str:
    """First line of the compiler's version; skips without it."""
    if shutil.which("avr-gcc") is None:
        missing("avr-gcc is missing (apt-get install gcc-avr avr-libc binutils-avr)")
    shown = subprocess.run(["avr-gcc", "--version"], capture_output=True, text=True, check=True)
    return shown.stdout.splitlines()[0]


@cache
def build(switches: str = "") -> Path:
    """Build the firmware, once per process; returns the hex file."""
    compiler_version()
    folder = new_folder()
    for name in ("tripod.c", "imu.h", "Makefile"):
        shutil.copy(FIRMWARE / name, folder)
    subprocess.run(
        ["make", "-s", "-C", str(folder), f"SWITCHES={switches}"], check=True, capture_output=True, text=True
    )
    return folder / "tripod.hex"


@cache
def build_boot_loader() -> Path:
    """Build the Uno's boot loader from Debian's source, once per process; skips without it."""
    compiler_version()
    folder = new_folder()
    if not OPTIBOOT.is_file():
        missing(f"{OPTIBOOT} is missing (apt-get install arduino-core-avr)")
    elf, image = folder / "optiboot.elf", folder / "optiboot.hex"
    subprocess.run(
        ["avr-gcc", *OPTIBOOT_FLAGS.split(), "-o", str(elf), str(OPTIBOOT)], check=True, capture_output=True
    )
    subprocess.run(
        ["avr-objcopy", "-O", "ihex", "-j", ".text", "-j", ".data", str(elf), str(image)], check=True
    )
    return image
