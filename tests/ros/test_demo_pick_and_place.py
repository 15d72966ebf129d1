"""`softsim demo pick_and_place`: objects on another tray, by topics alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from softsim_core.scene.io import config_file  # noqa: E402
from softsim_ros.cli import run_command as main  # noqa: E402

WEIGHTS_G = {"cube": 30.0, "can": 60.0, "brick": 15.0}


def one_object(folder: Path, name: str) -> str:
    """A scene file: the demo's, of whose objects the others are not there."""
    scene = yaml.safe_load(config_file("scenes/pick_and_place.yaml").read_text())
    others = set(WEIGHTS_G) - {name}
    scene["extends"] = str(config_file("scenes/gripper_on_arm.yaml"))
    for group in ("rigid_bodies", "collisions"):
        scene[group] = [each for each in scene[group] if each["name"] not in others]
    pairs = scene["contact"]["friction_pairs"]
    scene["contact"]["friction_pairs"] = [each for each in pairs if not others & {*each["between"]}]
    file = folder / "one_object.yaml"
    file.write_text(yaml.safe_dump(scene))
    return str(file)


@pytest.mark.parametrize("objects", [("can",), pytest.param(tuple(WEIGHTS_G), marks=pytest.mark.exhaustive)])
def test_objects_are_moved_and_weighed(
    ros_domain: int, tmp_path: Path, capfd: pytest.CaptureFixture[str], objects: tuple[str, ...]
) -> None:
    """The heaviest and smoothest of the objects; with all three at once it is the demo as it stands."""
    robot = ["--robot", one_object(tmp_path, *objects)] if len(objects) == 1 else []
    assert main(["demo", "pick_and_place", "--speed", "0", "--check", *robot]) == 0
    told = re.findall(
        r"(\w+): ([\d.]+) mm from its place; largest grip force ([\d.]+) N, weighs ([\d.]+) g",
        capfd.readouterr().out,
    )
    assert tuple(name for name, *_ in told) == objects
    weights = [WEIGHTS_G[name] for name in objects]
    assert [float(grams) for *_, grams in told] == pytest.approx(weights, rel=0.02)


def test_what_counts_as_put_down() -> None:
    from softsim_ros.cli.demos import AWAY, MeasuredObject

    start = np.array([0.3, -0.2, 0.03])
    for lifted, end, why in (
        (0.1, start + AWAY, ""),
        (0.01, start, "was not lifted (10 mm)"),
        (0.1, start + AWAY + [0.02, 0.0, 0.0], "stands 20 mm from its place"),
        (0.1, start + AWAY + [0.0, 0.0, -0.02], "does not stand upright (-20 mm)"),
        (0.1, np.full(3, np.nan), "stands nan mm from its place"),
    ):
        assert MeasuredObject(start, lifted=lifted, end=np.asarray(end)).why_not == why
