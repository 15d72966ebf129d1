"""The curves of the page: their times are simulated ones, and what is not known is left blank."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from softsim_core import load_scene
from softsim_ros.client import EffectorPose, RobotState, with_inverse
from softsim_ros.nodes.viewer import PlotsTab

pytestmark = pytest.mark.ros

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Charts:
    """Stands for viser's controls: keeps the data of each chart by its title."""

    def __init__(self) -> None:
        self.charts: dict[str, Any] = {}

    def add_uplot(self, data: object, series: object, *, title: str, **_: object) -> Any:
        self.charts[title] = SimpleNamespace(data=data)
        return self.charts[title]

    def data(self, title: str) -> list[list[float]]:
        return [np.asarray(column).tolist() for column in self.charts[title].data]


class Page:
    """The tab Plots at a robot whose state is set by the test."""

    def __init__(self) -> None:
        self.gui, self.state = Charts(), RobotState(measured=(0.1, 0.2, 0.3))
        self.stages: dict[str, dict[str, str]] = {}
        statistics: Any = SimpleNamespace(stages=self.stages)
        self._tab = PlotsTab(self.gui, load_scene("tripod"), lambda: self.state, statistics)

    def report(self, at: float, time_s: float, factor: float = 0.5, simulator: str = "running") -> None:
        self.state = replace(
            self.state, time_s=time_s, time_at=at, real_time_factor=factor, simulator=simulator
        )

    def add(self, *times: float) -> None:
        for now in times:
            self._tab.sample(now)

    def times(self) -> list[float]:
        return self.gui.data("Joint positions [rad]")[0]


def test_curves_run_over_simulated_time_and_follow_its_reports() -> None:
    page = Page()
    page.report(100.0, 7.0, factor=0.5)
    page.add(100.0, 100.4, 100.8)
    assert page.times() == pytest.approx([7.0, 7.2, 7.4])
    page.report(101.0, 7.1, factor=0.1)  # slower than foreseen: the points are moved to where they belong
    page.add(101.2)
    assert page.times() == pytest.approx([7.0, 7.04, 7.08, 7.12])


def test_nothing_is_added_while_simulated_time_stands() -> None:
    page = Page()
    page.report(100.0, 7.0)
    page.add(100.0, 100.2)
    page.report(101.0, 7.4, simulator="paused")
    page.add(101.0, 101.2, 101.4)
    assert page.times() == pytest.approx([7.0, 7.08, 7.4])
    page.report(102.0, 7.41, simulator="paused")  # a single step
    page.add(102.0, 102.2)
    assert page.times() == pytest.approx([7.0, 7.08, 7.4, 7.41])


def test_a_simulator_that_is_gone_adds_nothing_for_long() -> None:
    page = Page()
    page.report(100.0, 7.0, factor=1.0)
    page.add(100.0, 101.0, 102.0, 103.0, 200.0)
    assert page.times() == pytest.approx([7.0, 8.0, 9.0])


def test_curves_begin_anew_when_simulated_time_does() -> None:
    page = Page()
    page.report(100.0, 7.0)
    page.add(100.0, 100.2)
    page.report(101.0, 0.3)
    page.add(101.0)
    assert page.times() == pytest.approx([0.3])


def test_without_a_simulator_time_is_that_of_the_clock() -> None:
    page = Page()
    page.add(100.0, 100.2)
    first, second = page.times()
    assert second - first == pytest.approx(0.2)
    page.report(101.0, 7.0)
    page.add(101.0)
    assert page.times() == pytest.approx([7.0])


def test_the_distance_to_the_goal_is_blank_while_inverse_control_is_off() -> None:
    page, title = Page(), "Effector to goal [mm]"
    page.report(100.0, 7.0)
    page.state = with_inverse(replace(page.state, effector=EffectorPose((0.0, 0.0, 0.0), UPRIGHT)), True)
    page.add(100.0)
    assert np.isnan(page.gui.data(title)[1]).all()  # no goal yet
    page.state = replace(page.state, heard_goal=EffectorPose((0.0, 0.0, 0.004), UPRIGHT))
    page.add(100.2)
    assert page.gui.data(title)[1] == pytest.approx([4.0])
    page.state = with_inverse(page.state, False)
    page.add(100.4)
    times, blank = page.gui.data(title)
    assert times[-1] == pytest.approx(7.2)
    assert np.isnan(blank).all()


def test_no_times_of_steps_are_made_up() -> None:
    page = Page()
    page.add(100.0)
    for title in ("Time a step [ms]", "Real-time factor"):
        assert np.isnan(page.gui.data(title)[1]).all()
    page.report(101.0, 7.0, factor=0.5)
    page.stages["step"] = {"mean_ms": "1.5"}
    page.add(101.0)
    assert page.gui.data("Real-time factor")[1] == [0.5]
    assert page.gui.data("Time a step [ms]")[1:] == [[1.5], [0.0]]
