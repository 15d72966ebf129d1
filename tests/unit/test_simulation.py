"""Simulation: what one may pass, faults, what one can look at."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_scenes import body, limited, machine, scene, shaken, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import ArrayError, Backend, MaterialError, SceneError, SolverDivergedError
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import Controller, JointDescription

A = -1.4965
DT = 0.01


def test_what_is_assigned_to_forces_is_converted_once_or_refused(backend: Backend) -> None:
    sims = [Simulation(machine(), backend=backend) for _ in range(2)]
    forces = 0.01 * np.random.default_rng(4).normal(size=sims[0].forces.shape).astype(np.float32)
    sims[0].forces[:] = forces
    sims[1].forces = np.asfortranarray(forces)  # type: ignore[assignment]
    assert sims[1].forces.dtype == np.float64
    assert sims[1].forces.flags.c_contiguous
    for sim in sims:
        sim.step()
    np.testing.assert_array_equal(sims[0].positions, sims[1].positions)
    before = sims[0].forces.copy()
    for wrong in (np.zeros(3), np.zeros((len(forces) + 1, 3)), np.zeros(forces.shape, complex), "much"):
        with pytest.raises(ArrayError, match=rf"forces refused: expected .* shape \({len(forces)}, 3"):
            sims[0].forces = wrong  # type: ignore[assignment]
    np.testing.assert_array_equal(sims[0].forces, before)


def test_what_fails_while_a_scene_is_built_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("softsim_core.simulation.scene_state.build", fails)
    with pytest.raises(SceneError, match="cannot be built: LinAlgError: Singular matrix; look for a value"):
        Simulation(machine(), "scipy")


def test_a_control_for_another_model_is_refused(backend: Backend) -> None:
    sim = Simulation(machine(), backend=backend)
    joints, nodes = len(sim.joint_names), len(sim.positions)
    for control, name in (
        (Control(np.zeros(joints + 1), sim.forces), "targets"),
        (Control(np.zeros(joints), np.zeros((nodes - 1, 3))), "forces"),
    ):
        with pytest.raises(ArrayError, match=f"{name} refused"):
            sim._time_step.step(sim._state, control, sim.parameters)
    with pytest.raises(ArrayError, match="forces refused"):
        Control(np.zeros(joints), np.zeros(3))


@pytest.mark.parametrize("force", [1e12, np.nan, -np.inf])
def test_a_diverging_step_keeps_the_last_good_state(force: float, backend: Backend) -> None:
    sim = Simulation(limited(), backend=backend)
    sim.command([0.2])
    for _ in range(5):
        sim.step()
    good = sim.snapshot()
    worst = len(sim.positions) - 1
    sim.forces[worst, 2] = force
    for _ in range(2):
        with pytest.raises(SolverDivergedError, match=r"diverged at step 6 \(t = 0.060 s\)") as caught:
            sim.step()
        assert (caught.value.step, caught.value.time_s) == (6, pytest.approx(0.06))
    if np.isfinite(force):
        assert caught.value.worst_node == worst
    sim.forces[:] = 0.0
    assert sim.snapshot() == good
    for _ in range(10):  # no trace of the fault in what follows
        sim.step()
    unharmed = Simulation(limited(), backend=backend)
    unharmed.command([0.2])
    for _ in range(15):
        unharmed.step()
    assert sim.snapshot() == unharmed.snapshot()


def test_a_thousand_random_commands_stay_finite(backend: Backend) -> None:
    """Jumps over the whole range at once, pulls, base moves: nothing that a person can command diverges."""
    sim = Simulation(load_scene("tripod"), backend=backend)
    sim.enforce_limits = False
    rng = np.random.default_rng(4)
    for step in range(1000 if backend == "numba" else 100):
        if step % 5 == 0:
            sim.command(rng.uniform(-3.0, 1.0, 3))
            sim.base_shift = rng.uniform(-0.01, 0.035)
        sim.forces[:] = 0.0
        sim.forces[rng.integers(len(sim.forces))] = rng.normal(scale=1.0, size=3)  # N, many times its weight
        sim.step()
        assert np.isfinite(sim.positions).all()
    assert np.abs(sim.positions).max() < 1.0


@pytest.mark.parametrize("stiffness", ["young_modulus", "poisson_ratio"])
def test_a_wrong_material_changes_nothing(stiffness: str) -> None:
    sim = Simulation(limited(), backend="scipy")
    before = sim.snapshot()
    with pytest.raises(MaterialError):
        sim.set_material("body", **{stiffness: -2.0})
    with pytest.raises(SceneError, match="unknown body 'finger'; known bodies: body"):
        sim.set_material("finger", young_modulus=1.0)
    for damping in ({"rayleigh_mass": -1.0}, {"rayleigh_stiffness": np.nan}):
        with pytest.raises(SceneError, match="must be >= 0"):
            sim.set_damping(**damping)
    assert sim.snapshot() == before


def test_a_stiffer_body_sags_less(backend: Backend) -> None:
    sags = []
    sim = Simulation(limited(), backend=backend)
    for young in (1e5, 2e5):
        sim.set_material("body", young_modulus=young)
        assert sim.material("body").young_modulus == pytest.approx(young)
        assert sim.material("body").poisson_ratio == pytest.approx(0.3)
        for _ in range(400):
            sim.step()
        sags.append(sim.model.rest[:, 2].min() - sim.positions[:, 2].min())
    assert sags[0] / sags[1] == pytest.approx(2.0, rel=0.02)


@pytest.mark.slow
def test_memory_does_not_grow(backend: Backend) -> None:
    """Neither arrays nor the process: after 200 steps there are no more than after 20."""

    def bytes_of_arrays() -> int:
        gc.collect()
        only_arrays = tracemalloc.DomainFilter(True, np.lib.tracemalloc_domain)
        traces = tracemalloc.take_snapshot().filter_traces([only_arrays]).traces
        return sum(trace.size for trace in traces)

    sim = Simulation(machine(), backend=backend)
    shaken(sim, 20, seed=5)
    pages = resident_pages()
    shaken(sim, 200, seed=5)
    assert resident_pages() - pages < 512  # 2 MB; watching takes memory of its own, so that comes after
    tracemalloc.start()
    try:
        shaken(sim, 20, seed=5)
        before = bytes_of_arrays()
        shaken(sim, 200, seed=5)
        assert bytes_of_arrays() - before < sim.velocities.nbytes
    finally:
        tracemalloc.stop()


def resident_pages() -> int:
    """Pages of memory that this process holds now."""
    return int(Path("/proc/self/statm").read_text().split()[1])


def test_surfaces_follow_the_body(backend: Backend) -> None:
    sim = Simulation(load_scene("tripod"), backend=backend)
    np.testing.assert_allclose(sim.visual_points(), sim.visual_rest_points, atol=1e-12)
    assert sim.visual_triangles.max() == len(sim.visual_rest_points) - 1
    assert all(body.boundary.max() < len(sim.positions) for body in sim.bodies)
    np.testing.assert_allclose(sim.visual_values(np.full(len(sim.positions), 3.5)), 3.5)
    sim.start_animation()
    for _ in range(40):
        sim.step()
    moved = sim.visual_points()
    assert np.abs(moved - sim.visual_rest_points).max() > 0.01
    low, high = sim.positions.min(axis=0), sim.positions.max(axis=0)
    assert (moved > low - 2e-3).all()
    assert (moved < high + 2e-3).all()


def test_stress_of_a_stretched_bar_is_uniform(backend: Backend) -> None:
    """Pulled by its ends by 1 % at Poisson ratio 0: E strain at every node."""
    bar = body(box_mesh((0.04, 0.01, 0.01), (4, 1, 1)), young_modulus=2e5, poisson_ratio=0.0)
    slide = JointDescription(name="slide", kind="prismatic", axis=(1.0, 0.0, 0.0))
    ends = (slab("wall", "world", 0.0), slab("end", "slide", 0.04))
    sim = Simulation(
        scene(bar, joints=(slide,), attachments=ends, gravity=(0.0, 0.0, 0.0), rayleigh_mass=5.0),
        backend=backend,
    )
    assert sim.von_mises() == pytest.approx(np.zeros(20), abs=1e-9)
    sim.command([4e-4])
    for _ in range(400):
        sim.step()
    assert sim.von_mises() == pytest.approx(np.full(20, 2e3), rel=1e-6)
    assert sim.joint_efforts[0] == pytest.approx(2e3 * 1e-4, rel=1e-6)  # stress times area


def test_frames_are_named_and_placed() -> None:
    sim = Simulation(machine(), backend="scipy")
    names = {"middle", *sim.joint_names, *(f"{name}_horn" for name in sim.joint_names)}
    assert set(sim.frames()) == names
    effector = sim.effector_pose
    assert effector is not None
    assert effector.position.tolist() == [0.03, 0.0, 0.0]
    assert effector.quaternion_xyzw.tolist() == [0.0, 0.0, 0.0, 1.0]
    slid = sim.frames()["slide_horn"].position - sim.frames()["slide"].position
    assert np.linalg.norm(slid) == pytest.approx(0.002)  # its rest position is -2 mm
    assert Simulation(limited(), backend="scipy").effector_pose is None


def test_what_is_handed_out_is_a_copy() -> None:
    sim = Simulation(machine(), backend="scipy")
    before = sim.snapshot()
    for array in (sim.positions, sim.velocities, sim.joint_positions, sim.joint_targets, sim.joint_efforts):
        array += 1.0
    effector = sim.effector_pose
    assert effector is not None
    effector.position[:] = 9.0
    sim.frames()["middle"].position[:] = 9.0
    assert sim.snapshot() == before


def test_controllers_run_around_every_step() -> None:
    calls: list[tuple[str, int]] = []
    controller = Controller(
        on_begin=lambda sim: calls.append(("begin", sim.step_count)),
        on_end=lambda sim: calls.append(("end", sim.step_count)),
        on_key=lambda sim, key: calls.append((key, sim.step_count)),
    )
    sim = Simulation(replace(limited(), controllers=(controller,)), backend="scipy")
    sim.step()
    sim.press_key("up")
    sim.step()
    assert calls == [("begin", 0), ("end", 1), ("up", 1), ("begin", 1), ("end", 2)]


def test_times_are_told(backend: Backend) -> None:
    sim = Simulation(limited(), backend=backend)
    assert sim.backend == backend
    assert (sim.dt, sim.time, sim.step_count) == (DT, 0.0, 0)
    sim.step()
    assert sim.time == pytest.approx(DT)
    stages = sim.stage_times
    assert all(value >= 0.0 for value in stages.values())
    assert stages["step"] >= sum(value for stage, value in stages.items() if stage != "step") > 0.0
