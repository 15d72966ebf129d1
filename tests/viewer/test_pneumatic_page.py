"""The pneumatic finger's page: its body is tuned there, its air told in ml, its chambers are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import NODES, BrowserPage
from sensor_msgs.msg import JointState

from softsim_core import Simulation, load_scene
from softsim_ros.nodes.viewer import HOLLOW_OFFSET_MM, MM, facing

pytestmark = [pytest.mark.ros, pytest.mark.slow]

HOLLOW = "/chambers/air_0"


@pytest.fixture(scope="module")
def finger(
    start_station: Callable[..., tuple[Any, str]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Any, str]:
    """The finger in the namespace of the tests' client."""
    file = tmp_path_factory.mktemp("scene") / "finger.yaml"
    file.write_text(f"extends: {load_scene('pneu_finger').source}\nname: tripod\n")
    return start_station(str(file), "--no-bridge")


@pytest.fixture(scope="module")
def page(finger: tuple[Any, str], browser: Any) -> Iterator[BrowserPage]:
    page = BrowserPage(browser, finger[1])
    page.wait_for_node("/bodies/finger")
    yield page
    page.close()


@pytest.mark.parametrize(
    ("label", "parameter", "shown", "value"),
    [
        ("Young modulus of paper [MPa]", "paper.young_modulus", 500.0, 5.0e8),
        ("Poisson ratio of paper", "paper.poisson_ratio", 0.2, 0.2),
        ("Stiffness in tension of thread [kPa]", "thread.stiffness", 2000.0, 2.0e6),
        ("Factor on the stiffness of finger", "stiffness_factor", 1.4, 1.4),
    ],
)
def test_layers_and_fibres_are_tuned_on_the_page(
    finger: tuple[Any, str],
    page: BrowserPage,
    spin_until: Callable[..., bool],
    label: str,
    parameter: str,
    shown: float,
    value: float,
) -> None:
    robot, _ = finger
    page.tab("Tune")
    page.set_number(label, shown)
    assert spin_until(lambda: robot.get_parameter(parameter) == pytest.approx(value)), robot.process.output
    assert page.errors == []


def test_the_air_is_commanded_in_ml(
    finger: tuple[Any, str], page: BrowserPage, spin_until: Callable[..., bool]
) -> None:
    robot, _ = finger
    states = robot.client.collect(JointState, "joint_states", 5)
    assert spin_until(lambda: states)
    page.tab("Drive")
    page.set_number("air [ml]", 0.8)
    assert spin_until(lambda: states[-1].position[0] == pytest.approx(8.0e-7, abs=1e-9))
    page.page.get_by_text("8e-07 m^3 (0.8 ml)").wait_for(state="visible")
    page.tab("Plots")
    for title in ("Joint positions [ml]", "Efforts [Pa]"):
        page.page.get_by_text(title).wait_for(state="visible")
    assert page.errors == []


def volume(corners: np.ndarray) -> float:
    """What triangles that point outward go around, shape (k, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return float(np.einsum("ki,ki->", a, np.cross(b, c)) / 6.0)


def test_the_hollow_is_drawn_grows_with_its_air_and_is_switched(
    finger: tuple[Any, str], page: BrowserPage, spin_until: Callable[..., bool]
) -> None:
    robot, _ = finger
    page.wait_for_node(HOLLOW)
    corners = MM * Simulation(load_scene("pneu_finger"), "scipy").actuators[0].surface.reshape(-1, 3)
    rest = 1e-3 * volume((corners + HOLLOW_OFFSET_MM * facing(corners)).reshape(-1, 3, 3))

    def grown() -> float:
        """By how much the hollow on the screen is larger than at rest, in [ml]."""
        return 1e-3 * volume(np.array(page.vertices(HOLLOW)).reshape(-1, 3, 3)) - rest

    for air in (0.0, 0.8):
        robot.command([1e-6 * air])
        assert spin_until(lambda air=air: grown() == pytest.approx(air, abs=0.1)), grown()
    page.tab("View")
    for shown in ("!", ""):
        page.tick("Pressure chambers")
        page.page.wait_for_function(f"{shown}{NODES}['{HOLLOW}'].visible")
    assert page.errors == []
