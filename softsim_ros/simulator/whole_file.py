"""Writing an ordinary file whole or not at all, never through a link."""

from __future__ import annotations

import os
import secrets
from contextlib import suppress


def write_whole(folder: int, name: str, data: bytes, *, mode: int = 0o600, replaces: bool = True) -> None:
    """Write a file beside its place, then put it there.

    Args:
        folder: Descriptor of its folder.
        name: Its name in the folder; a link there is replaced, not followed.
        data: What it shall hold.
        mode: Who may read and write it.
        replaces: Whether it takes the place of another file.

    Raises:
        OSError: it cannot be written, or there is one and it must not be replaced; what was there is kept.
    """
    aside = f".{name}.{secrets.token_hex(8)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    try:
        with os.fdopen(os.open(aside, flags, mode, dir_fd=folder), "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        if replaces:
            os.replace(aside, name, src_dir_fd=folder, dst_dir_fd=folder)
        else:
            os.link(aside, name, src_dir_fd=folder, dst_dir_fd=folder, follow_symlinks=False)
            os.unlink(aside, dir_fd=folder)
    except BaseException:
        with suppress(OSError):
            os.unlink(aside, dir_fd=folder)
        raise
    os.fsync(folder)
