"""Firmware images: Intel hex text to bytes."""

from __future__ import annotations

from pathlib import Path

from servo_bridge.emulator.errors import EmulatorError


def read_image(path: Path | str) -> tuple[int, bytes]:
    """Address of the first byte and the bytes of an Intel hex file; gaps are filled with 0xFF.

    Raises:
        EmulatorError: the file is missing, is no Intel hex, or has a wrong checksum; names file and line.
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
        kind, address, data = _record(line.strip(), f"{path}, line {number}")
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


def _record(line: str, where: str) -> tuple[int, int, bytes]:
    """Kind, address and data of one line."""
    try:
        raw = bytes.fromhex(line[1:])
    except ValueError:
        raw = b""
    if line[:1] != ":" or len(raw) < 5 or len(raw) != raw[0] + 5:
        raise EmulatorError(f"{where}: {line[:20]!r} is no line of an Intel hex file")
    if sum(raw) & 0xFF:
        raise EmulatorError(f"{where}: the checksum is wrong; the file is damaged, build or copy it again")
    return raw[3], int.from_bytes(raw[1:3], "big"), raw[4:-1]
