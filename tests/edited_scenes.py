"""A scene's file as a person edits it while the scene runs."""

from __future__ import annotations

import os
import time
from pathlib import Path

SCENE = """
extends: {base}
name: tripod
bodies:
  - name: silicone
    material: {{young_modulus: {young}}}
"""
"""The Tripod on top of its own file `base`, of another Young modulus in [Pa]."""


def save(file: Path, text: str) -> None:
    """Write as an editor does: another file, moved into place; the time stamp surely changes."""
    aside = file.with_suffix(".tmp")
    aside.write_text(text)
    newer = max(time.time_ns(), file.stat().st_mtime_ns + 1_000_000 if file.exists() else 0)
    os.utime(aside, ns=(newer, newer))
    aside.replace(file)
