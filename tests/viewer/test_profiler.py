"""What the page tells of time: the line of state, the table of stages, the profiler of single steps."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from softsim_ros.nodes.viewer import Profile, progress, stage_table, step_table

pytestmark = pytest.mark.ros

STAGES = ("assemble", "step", "publishing")


def steps(first: int, *durations: float) -> np.ndarray:
    """Rows of steps whose assembly takes half of the step, and publishing 0.1 ms."""
    return np.array([[first + k, 0.01 * (first + k), 0.5 * d, d, 0.1] for k, d in enumerate(durations)])


def test_the_profile_follows_until_a_step_is_looked_at() -> None:
    profile = Profile()
    assert profile.table() == ""
    profile.look_at_slowest()  # of no steps: nothing to hold yet
    assert not profile.is_frozen
    profile.take(STAGES, steps(1, 0.3, 0.9, 0.4))
    assert profile.at == 2
    np.testing.assert_allclose(profile.durations, [0.4, 1.0, 0.5])
    profile.look_at_slowest()
    assert (profile.at, profile.is_frozen) == (1, True)
    profile.take(STAGES, steps(4, 5.0))
    assert len(profile.rows) == 3
    assert "<b>step 2</b>, t = 0.020 s: 1.000 ms" in profile.table()
    profile.look_at(99)
    assert profile.at == 2
    profile.follow()
    profile.take(STAGES, steps(4, 5.0))
    assert (profile.at, len(profile.rows)) == (0, 1)


def test_the_tree_of_a_step_tells_what_each_stage_takes_itself() -> None:
    table = step_table(7, 0.07, {"assemble": 0.3, "step": 0.9, "publishing": 0.1})
    rows = [row.split("</td>")[:-1] for row in table.split("<tr>")[2:]]
    cells = [[cell.rsplit(">", 1)[1] for cell in row] for row in rows]
    assert cells == [
        ["step", "90.0", "60.0", "0.900", "0.600"],
        ["\u00a0\u00a0assemble", "30.0", "30.0", "0.300", "0.300"],
        ["publishing", "10.0", "10.0", "0.100", "0.100"],
    ]


def test_the_statistics_have_a_row_a_stage() -> None:
    table = stage_table({"step": {"level": "0", "mean_ms": "0.5"}, "solve": {"level": "1"}})
    assert ">step</td>" in table
    assert ">\u00a0\u00a0solve</td>" in table
    assert ">0.50</td>" in table
    assert "no statistics yet" in stage_table({})


def test_the_line_of_state_tells_time_and_step() -> None:
    assert progress("running", 0.987, 12.3, 0.01) == "running, 0.99 × real time, t = 12.30 s, dt = 10 ms"
    assert progress("paused", None, None, None) == "paused"
    assert progress("", 1.0, 1.0, 0.01) == "no simulator found"
