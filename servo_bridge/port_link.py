"""A stable name for a pseudo-terminal: a symbolic link that is replaced at once."""

from __future__ import annotations

import os
from pathlib import Path

from servo_bridge.errors import PortError


def make_link(link: Path | None, device: str) -> None:
    """Let `link` point to `device`, in one step for whoever looks at it; None does nothing.

    Raises:
        PortError: the link cannot be made, or something that is no link is in its place.
    """
    if link is None:
        return
    if link.exists() and not link.is_symlink():
        raise PortError(str(link), f"{link} exists and is no link; give another path for the link")
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    try:
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(device)
        fresh.replace(link)
    except OSError as error:
        raise PortError(
            str(link), f"link {link} cannot be made ({error.strerror}); give another path"
        ) from error


def remove_link(link: Path | None, device: str) -> None:
    """Remove `link` if it still points to `device`."""
    if link is not None and link.is_symlink() and str(link.readlink()) == device:
        link.unlink()
