"""`softsim bench --batch`: copies beside single runs and MuJoCo, and its verdicts."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import (
    BatchRate,
    EnvironmentCost,
    copies,
    cost_table,
    describe_missed_targets,
    measure_copies,
    measure_environments,
    measure_peer,
    rate_table,
)


@pytest.mark.slow
@pytest.mark.numba
def test_copies_are_measured_beside_single_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(copies, "MEASURED", (("tripod", "low"),))
    monkeypatch.setattr(copies, "SAMPLE_S", 0.02)
    rates = list(measure_copies((1, 4), (1, 2), 1, Path("/nowhere")))
    assert [(each.copies, each.workers) for each in rates] == [(1, 1), (4, 1), (4, 2)]
    for each in rates:
        assert each.nodes == 246
        assert each.per_core > 0.0
        assert each.as_json()["per_core"] == each.per_core
    assert len(rate_table(rates)) == 4


def rate(copies: int, workers: int, by_single: float) -> BatchRate:
    return BatchRate("tripod", "low", "softsim", 246, copies, workers, 1000.0 * by_single, 1000.0)


def test_what_is_slower_than_asked_is_told() -> None:
    assert describe_missed_targets([rate(8, 1, 0.95), rate(8, 2, 1.75)]) == []
    assert describe_missed_targets([rate(8, 1, 0.85)]) == [
        "tripod low, 8 copies: 0.85 of the single run per core, target >= 0.9"
    ]
    assert describe_missed_targets([rate(8, 1, 1.0), rate(8, 2, 1.5)]) == [
        "tripod low, 8 copies: two workers 1.50 times one, target >= 1.8"
    ]


@pytest.mark.slow
def test_mujoco_is_measured_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco.rollout")
    monkeypatch.setattr(copies, "PEERS", (("held_centre", "low"),))
    monkeypatch.setattr(copies, "SAMPLE_S", 0.02)
    rates = list(measure_peer((1, 2), (1,), 1, Path("/nowhere")))
    assert [(each.engine, each.copies) for each in rates] == [("mujoco", 1), ("mujoco", 2)]
    assert rates[0].rate > 0.0


@pytest.mark.slow
@pytest.mark.numba
def test_environments_are_measured_beside_their_physics() -> None:
    pytest.importorskip("gymnasium")
    costs = measure_environments(8, 1)
    assert costs[0].environment == "softsim/TripodReach-v0"
    assert all(each.overhead > 0.0 for each in costs)
    assert len(cost_table(costs)) == 1 + len(costs)
    dear = EnvironmentCost("softsim/X-v0", 64, 1.0, 0.2)
    assert dear.missed
    assert "20.0 % outside the physics" in dear.report_line
