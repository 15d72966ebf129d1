"""`softsim demo pick_and_place`: three objects on another tray, by topics alone."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

REPOSITORY = Path(__file__).resolve().parents[2]


def test_three_objects_are_moved_and_weighed(ros_domain: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", "demo", "pick_and_place", "--speed", "0", "--check"],
        capture_output=True,
        text=True,
        timeout=900.0,
        check=False,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = re.findall(
        r"(\w+): ([\d.]+) mm from its place; largest grip force ([\d.]+) N, weighs ([\d.]+) g", done.stdout
    )
    assert [name for name, *_ in told] == ["cube", "can", "brick"]
    assert [float(grams) for *_, grams in told] == pytest.approx([30.0, 60.0, 15.0], rel=0.02)


def test_what_counts_as_put_down() -> None:
    from softsim_ros.cli.demos.pick_and_place import Taken
    from softsim_ros.cli.demos.pick_plan import AWAY

    start = np.array([0.3, -0.2, 0.03])
    for lifted, end, why in (
        (0.1, start + AWAY, ""),
        (0.01, start, "was not lifted (10 mm)"),
        (0.1, start + AWAY + [0.02, 0.0, 0.0], "stands 20 mm from its place"),
        (0.1, start + AWAY + [0.0, 0.0, -0.02], "does not stand upright (-20 mm)"),
        (0.1, np.full(3, np.nan), "stands nan mm from its place"),
    ):
        assert Taken(start, lifted=lifted, end=np.asarray(end)).why_not == why
