"""What a computer without the emulator is told."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("library", "sentence"),
    [
        (
            "/nowhere/libsimavr.so",
            "emulator is missing (/nowhere/libsimavr.so); install it with:",
        ),
        ("libc.so.6", "libc.so.6 is no simavr"),
    ],
)
def test_a_missing_emulator_is_one_sentence(library: str, sentence: str) -> None:
    code = "from servo_bridge.emulator import why_missing; print(why_missing())"
    environment = {**os.environ, "SOFTSIM_SIMAVR": library}
    shown = subprocess.run(
        [sys.executable, "-c", code],
        cwd=REPOSITORY,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert sentence in shown.stdout
    assert "sudo apt-get install libsimavr2" in shown.stdout
