"""Simulation: commands and limits, the start animation, snapshots, faults, what one can look at."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_scenes import body, machine, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.dynamics import Backend
from softsim_core.errors import (
    ArrayError,
    CommandError,
    MaterialError,
    SceneError,
    SnapshotError,
    SolverDivergedError,
)
from softsim_core.mechanics.control import Control
from softsim_core.mechanics.limits import JointLimits
from softsim_core.mechanics.snapshot import pack
from softsim_core.mesh import box_mesh
from softsim_core.scene.control import CommandSettings, StartAnimation
from softsim_core.scene.description import JointDescription
from softsim_core.scene.robot import Controller, RobotDescription

A = -1.4965
DT = 0.01


def limited(out_of_range: str = "clamp", speed: float = np.inf) -> RobotDescription:
    """A beam on a hinge within -1 .. 0.5 rad."""
    hinge = JointDescription(name="hinge", limits=JointLimits(-1.0, 0.5, speed), axis=(0.0, 1.0, 0.0))
    beam = body(box_mesh((0.03, 0.01, 0.01), (3, 1, 1)))
    return RobotDescription(
        scene=scene(beam, joints=(hinge,), attachments=(slab("root", "hinge", 0.0),)),
        poses={"up": (0.4,)},
        start=StartAnimation(pose="up", duration=0.05, base_shift=0.02),
        commands=CommandSettings(out_of_range=out_of_range),  # type: ignore[arg-type]
    )


def shaken(sim: Simulation, steps: int, seed: int) -> None:
    """Random commands, pulls and base shifts."""
    rng = np.random.default_rng(seed)
    for step in range(steps):
        if step % 7 == 0:
            sim.command(rng.uniform(-0.02, 0.02, len(sim.joint_names)))
            sim.forces[:] = rng.normal(scale=0.01, size=sim.forces.shape)
            sim.base_shift = rng.uniform(-0.002, 0.002)
        sim.step()


# --- commands ---


def test_a_command_is_clamped_and_returned(backend: Backend) -> None:
    sim = Simulation(limited(), backend=backend)
    for wanted, accepted in ((0.2, 0.2), (3.0, 0.5), (-7.0, -1.0)):
        assert sim.command([wanted]).tolist() == [accepted]
        assert sim.joint_targets.tolist() == [accepted]
        sim.step()
        assert sim.joint_positions.tolist() == [accepted]


def test_a_scene_may_refuse_instead() -> None:
    sim = Simulation(limited("refuse"), backend="scipy")
    sim.command([0.3])
    with pytest.raises(CommandError, match=r"command 0.6 for joint hinge refused: allowed is \[-1.0, 0.5\]"):
        sim.command([0.6])
    assert sim.joint_targets.tolist() == [0.3]


def test_without_limits_full_turns_are_allowed(backend: Backend) -> None:
    sim = Simulation(limited(speed=1.0), backend=backend)
    sim.enforce_limits = False
    assert sim.command([7.0]).tolist() == [7.0]
    sim.step()
    assert sim.joint_positions.tolist() == [7.0]  # the speed limit is off too


@pytest.mark.parametrize("values", [[], [0.1, 0.2], [np.nan], [np.inf]])
def test_a_wrong_command_changes_nothing(values: list[float]) -> None:
    sim = Simulation(limited(), backend="scipy")
    sim.command([0.3])
    before = sim.snapshot()
    with pytest.raises(CommandError, match="nothing was moved"):
        sim.command(values)
    assert sim.snapshot() == before
    sim.step()
    assert sim.joint_positions.tolist() == [0.3]


@pytest.mark.parametrize("shift", [np.nan, np.inf])
def test_a_base_shift_is_finite(shift: float) -> None:
    sim = Simulation(limited(), backend="scipy")
    with pytest.raises(CommandError, match="base_shift"):
        sim.base_shift = shift


def test_joints_keep_their_speed_limit(backend: Backend) -> None:
    sim = Simulation(limited(speed=2.0), backend=backend)
    sim.command([0.05])
    reached = []
    for _ in range(5):
        sim.step()
        reached.append(float(sim.joint_positions[0]))
    assert reached == pytest.approx([0.02, 0.04, 0.05, 0.05, 0.05], abs=1e-15)
    sim.command([-1.0])
    for _ in range(200):
        before = sim.joint_positions[0]
        sim.step()
        assert abs(sim.joint_positions[0] - before) <= 2.0 * DT + 1e-12
    assert sim.joint_positions[0] == -1.0


# --- the start animation ---


def test_start_animation_of_the_tripod_takes_21_steps(backend: Backend) -> None:
    """Factors 0, 0.05 .. 1, absolute, not slowed by the speed limit; then the pose is held."""
    sim = Simulation(load_scene("tripod"), backend=backend)
    for _ in range(2):  # pressing again starts again from the rest pose
        sim.start_animation()
        for i in range(21):
            sim.step()
            assert sim.joint_positions == pytest.approx(np.full(3, A * i / 20), abs=1e-12)
            assert sim.base_shift == pytest.approx(0.035 * i / 20, abs=1e-12)
            assert sim.joint_targets == pytest.approx(sim.joint_positions)
    for _ in range(3):
        sim.step()
        assert sim.joint_positions == pytest.approx(np.full(3, A))
        assert sim.base_shift == pytest.approx(0.035)


def test_a_command_takes_the_joints_from_the_animation_and_the_bases_still_arrive() -> None:
    sim = Simulation(limited(), backend="scipy")
    sim.start_animation()
    for _ in range(3):
        sim.step()
    sim.command([-0.2])
    for _ in range(3):
        sim.step()
    assert sim.joint_positions.tolist() == [-0.2]
    assert sim.base_shift == pytest.approx(0.02)


def test_a_scene_may_play_it_at_once_and_again_after_a_reset() -> None:
    description = limited()
    assert description.start is not None
    sim = Simulation(replace(description, start=replace(description.start, at_start=True)), backend="scipy")
    for _ in range(2):
        for _ in range(6):
            sim.step()
        assert sim.joint_positions == pytest.approx([0.4])
        sim.reset()


def test_a_scene_without_animation_says_so() -> None:
    with pytest.raises(SceneError, match="has no start animation"):
        Simulation(machine(), backend="scipy").start_animation()


# --- snapshots ---


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
    whole = sim._saved()
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


def test_a_control_for_another_model_is_refused(backend: Backend) -> None:
    sim = Simulation(machine(), backend=backend)
    joints, nodes = len(sim.joint_names), len(sim.positions)
    for control, name in (
        (Control(np.zeros(joints + 1), sim.forces), "targets"),
        (Control(np.zeros(joints), np.zeros((nodes - 1, 3))), "forces"),
    ):
        with pytest.raises(ArrayError, match=f"{name} refused"):
            sim._stepper.step(sim._state, control, sim.parameters)
    with pytest.raises(ArrayError, match="forces refused"):
        Control(np.zeros(joints), np.zeros(3))


def test_both_backends_read_each_others_snapshots() -> None:
    pytest.importorskip("numba")
    fast = Simulation(machine(), backend="numba")
    shaken(fast, 10, seed=3)
    readable = Simulation(machine(), backend="scipy")
    readable.restore(fast.snapshot())
    assert readable.snapshot() == fast.snapshot()


# --- faults ---


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


# --- what one can look at ---


def test_surfaces_follow_the_body(backend: Backend) -> None:
    sim = Simulation(load_scene("tripod"), backend=backend)
    np.testing.assert_allclose(sim.visual_points(), sim.visual_rest_points, atol=1e-12)
    assert sim.visual_triangles.max() == len(sim.visual_rest_points) - 1
    assert sim.surface_triangles.max() < len(sim.positions)
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
