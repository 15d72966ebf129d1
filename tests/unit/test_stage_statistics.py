"""The table of stage times, and the structure of a scene, as messages."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time

from softsim_core import Simulation, load_scene
from softsim_ros.nodes.simulator import StageTime, index_array, stage_statistics, structure

pytestmark = pytest.mark.ros


def test_the_table_is_a_tree_with_shares_of_the_whole() -> None:
    stages = {
        "factor": StageTime(100, 0.1, 0.3, 0.9),
        "step": StageTime(100, 0.4, 0.6, 1.0, deviation=0.2),
        "publishing": StageTime(50, 0.1, 0.4, 0.5),
    }
    message = stage_statistics(Time(), "tripod", stages)
    table = {status.name: {pair.key: pair.value for pair in status.values} for status in message.status}
    assert list(table) == ["step", "factor", "publishing"]
    assert [row["level"] for row in table.values()] == ["0", "1", "0"]
    assert table["factor"]["percent"] == "37.5"
    assert table["publishing"]["percent"] == "25"
    assert table["step"] == {
        "level": "0",
        "calls": "100",
        "min_ms": "0.4",
        "mean_ms": "0.6",
        "max_ms": "1",
        "deviation_ms": "0.2",
        "total_ms": "60",
        "percent": "75",
    }


def test_a_stage_has_mean_and_deviation_of_its_calls() -> None:
    times = np.random.default_rng(3).gamma(2.0, 0.3, 200)
    gathered = StageTime.of(times.tolist())
    assert gathered.calls == 200
    assert (gathered.minimum, gathered.maximum) == (times.min(), times.max())
    assert gathered.mean == pytest.approx(times.mean())
    assert gathered.deviation == pytest.approx(times.std())
    assert gathered.total == pytest.approx(times.sum())


def test_the_structure_names_what_the_topics_number() -> None:
    simulation = Simulation(load_scene("tripod"), backend="scipy")
    parts = structure(simulation)
    (body,) = parts["bodies"]
    assert body["points"] == [0, len(simulation.visual_points())]
    assert body["triangles"] == [0, len(simulation.visual_triangles)]
    assert body["nodes"] == [0, len(simulation.positions)]
    assert parts["frames"] == list(simulation.frames())
    assert {region["name"]: region["to"] for region in parts["regions"]} == {
        "tip_0": "servo_0",
        "tip_1": "servo_1",
        "tip_2": "servo_2",
        "centre": "free",
    }


def test_an_index_array_tells_its_shape() -> None:
    message = index_array(np.arange(8).reshape(2, 4))
    assert [dim.size for dim in message.layout.dim] == [2, 4]
    assert list(message.data) == list(range(8))
