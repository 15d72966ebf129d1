"""Simulation: snapshots, restoring and resetting."""

from __future__ import annotations

import numpy as np
import pytest
from small_scenes import body, limited, machine, shaken

from softsim_core import Simulation, load_scene
from softsim_core.base import (
    Backend,
    SnapshotError,
)
from softsim_core.physics.mechanics import pack
from softsim_core.physics.mesh import box_mesh

A = -1.4965
DT = 0.01


def test_snapshot_and_restore_give_the_same_bytes(backend: Backend) -> None:
    sim = Simulation(machine(), backend=backend)
    shaken(sim, 20, seed=0)
    saved = sim.snapshot()
    shaken(sim, 30, seed=1)
    later = sim.snapshot()
    assert later != saved
    sim.restore(saved)
    assert sim.snapshot() == saved
    assert sim.step_count == 20
    shaken(sim, 30, seed=1)
    assert sim.snapshot() == later
    fresh = Simulation(machine(), backend=backend)
    fresh.restore(saved)
    shaken(fresh, 30, seed=1)
    assert fresh.snapshot() == later


def test_a_snapshot_in_the_middle_of_the_animation(backend: Backend) -> None:
    sim = Simulation(load_scene("tripod"), backend=backend)
    sim.step()
    sim.start_animation()
    for _ in range(10):
        sim.step()
    saved = sim.snapshot()
    for _ in range(20):
        sim.step()
    later = sim.snapshot()
    other = Simulation(load_scene("tripod"), backend=backend)
    other.restore(saved)
    for _ in range(20):
        other.step()
    assert other.snapshot() == later


def test_a_snapshot_keeps_what_was_tuned(backend: Backend) -> None:
    sim = Simulation(limited(), backend=backend)
    sim.set_material("body", young_modulus=3e5, poisson_ratio=0.1)
    sim.set_damping(rayleigh_stiffness=0.02, rayleigh_mass=1.0)
    sim.enforce_limits = False
    sim.command([4.0])
    saved = sim.snapshot()
    for _ in range(5):
        sim.step()
    later = sim.snapshot()
    other = Simulation(limited(), backend=backend)
    other.restore(saved)
    assert other.material("body").young_modulus == pytest.approx(3e5)
    assert other.enforce_limits is False
    for _ in range(5):
        other.step()
    assert other.snapshot() == later


def test_reset_gives_the_first_bytes(backend: Backend) -> None:
    sim = Simulation(machine(), backend=backend)
    first = sim.snapshot()
    shaken(sim, 20, seed=2)
    later = sim.snapshot()
    sim.reset()
    assert sim.snapshot() == first
    shaken(sim, 20, seed=2)
    assert sim.snapshot() == later


def test_snapshots_of_other_scenes_and_foreign_bytes_are_refused() -> None:
    sim = Simulation(limited(), backend="scipy")
    sim.step()
    before = sim.snapshot()
    finer = limited().with_scene(bodies=(body(box_mesh((0.03, 0.01, 0.01), (6, 1, 1))),))
    other = Simulation(finer, backend="scipy").snapshot()
    slower = Simulation(limited().with_scene(dt=0.005), backend="scipy").snapshot()
    for data in (b"", b"not a snapshot", other, slower, before[::-1], bytes(32) + before):
        with pytest.raises(SnapshotError, match="not a snapshot of this scene"):
            sim.restore(data)
    for data in (before[:-1], before[: len(before) // 2], before + b"\0"):
        with pytest.raises(SnapshotError, match="damaged or cut short"):
            sim.restore(data)
    assert sim.snapshot() == before


def test_values_that_cannot_be_are_refused_behind_a_right_checksum() -> None:
    sim = Simulation(machine(), backend="scipy")
    sim.step()
    before = sim.snapshot()
    whole = sim._collect_snapshot()
    for name, value in (
        ("parameters.materials", 0.0),
        ("parameters.rayleigh_mass", -1.0),
        ("steps", 0.5),
        ("state.frame_rotations", 0.0),
    ):
        foreign = {**whole, name: np.full_like(whole[name], value)}
        with pytest.raises(SnapshotError, match="save a new one"):
            sim.restore(pack(sim._fingerprint, foreign))
        assert sim.snapshot() == before, name
    with pytest.raises(SnapshotError):
        sim.restore(pack(sim._fingerprint, {name: np.zeros_like(each) for name, each in whole.items()}))
    assert sim.snapshot() == before


def test_a_snapshot_holds_its_arrays_by_name() -> None:
    sim = Simulation(limited(), backend="scipy")
    sim.forces[3] = 0.1
    sim.step()
    data = sim.snapshot()
    for name in ("steps", "state.positions", "state.base_positions", "drive.targets", "parameters.materials"):
        assert f'"{name}"'.encode() in data
    assert data.startswith(b"softsim snapshot, version 2")
    sim.forces[:] = 0.0
    sim.restore(data)
    np.testing.assert_array_equal(sim.forces[3], [0.1, 0.1, 0.1])


def test_both_backends_read_each_others_snapshots() -> None:
    pytest.importorskip("numba")
    fast = Simulation(machine(), backend="numba")
    shaken(fast, 10, seed=3)
    readable = Simulation(machine(), backend="scipy")
    readable.restore(fast.snapshot())
    assert readable.snapshot() == fast.snapshot()
