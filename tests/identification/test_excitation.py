"""Motions that measure a robot keep all its limits; what is written is read back as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import JointLimits, SceneError, load_scene
from softsim_core.lab.identification import (
    AlignmentDescription,
    CommandColumns,
    DataSetDescription,
    ExcitationSettings,
    MotionLimits,
    SensorDescription,
    SessionDescription,
    SplitDescription,
    TimeColumn,
    chirp,
    data_of,
    first_calibration,
    grid,
    load_calibration,
    load_data_set,
    load_session,
    motion_limits_of,
    motions,
    replace_expressions,
    ring_down,
    steps,
    way,
    write_calibration,
    write_description,
    write_table,
)


def random_room(seed: int) -> MotionLimits:
    random = np.random.default_rng(seed)
    joints = int(random.integers(1, 5))
    low, home, high = np.sort(random.uniform(-2.0, 2.0, (3, joints)), axis=0)
    speed = random.uniform(0.05, 5.0, joints)
    return MotionLimits(home, low, high, speed, speed * random.uniform(1.0, 30.0, joints))


@pytest.mark.parametrize("seed", range(12))
def test_motions_keep_every_limit_and_come_home(seed: int) -> None:
    room = random_room(seed)
    for motion in motions(room, ExcitationSettings(seed=seed, chirp_s=4.0, hold_s=0.2, ringing_s=0.2)):
        moves = np.diff(motion.commands, axis=0) / motion.period_s
        assert (motion.commands >= room.low - 1e-12).all(), motion.name
        assert (motion.commands <= room.high + 1e-12).all(), motion.name
        assert (np.abs(moves) <= room.speed).all(), motion.name
        pushes = np.diff(moves, axis=0, prepend=0.0 * moves[:1]) / motion.period_s
        assert (np.abs(pushes) <= 1.001 * room.acceleration).all(), motion.name
        assert motion.commands[0] == pytest.approx(room.home)
        assert motion.commands[-1] == pytest.approx(room.home)


@pytest.mark.parametrize("seed", range(6))
def test_a_way_is_as_quick_as_its_limits_allow(seed: int) -> None:
    room, period = random_room(seed), 0.001
    course = np.vstack([room.low, way(room.low, room.high, room, 1.0, period)])
    speeds = np.diff(course, axis=0) / period
    used = np.abs(speeds).max(axis=0) / room.speed
    pushed = np.abs(np.diff(speeds, axis=0)).max(axis=0) / period / room.acceleration
    assert course[-1] == pytest.approx(room.high)
    assert max(used.max(), pushed.max()) == pytest.approx(1.0, abs=0.05)


def test_a_chirp_of_quick_joints_uses_its_range_and_no_more() -> None:
    one = np.ones(2)
    commands = chirp(MotionLimits(0.0 * one, -one, one, 1e4 * one, 1e7 * one), ExcitationSettings()).commands
    assert np.abs(commands).max(axis=0) == pytest.approx(one, abs=0.02)
    assert np.abs(commands).max() <= 1.0 + 1e-12


def test_a_chirp_goes_through_its_frequencies_and_a_ring_down_ends_still() -> None:
    room = motion_limits_of(load_scene("tripod"), 0.5)
    swings = chirp(room, ExcitationSettings(chirp_s=20.0, lowest_hz=0.5, highest_hz=4.0)).commands[:, 1]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(swings))))
    half_periods = 0.02 * np.diff(turns)
    assert 0.5 / half_periods[3:6].mean() == pytest.approx(0.8, rel=0.15)  # in Hz
    assert 0.5 / half_periods[-12:-4].mean() == pytest.approx(4.0, rel=0.1)
    settings = ExcitationSettings(ringing_s=1.5)
    still = ring_down(room, settings).commands[-75:]
    assert (still == room.home).all()
    assert np.ptp(steps(room, settings).commands, axis=0) == pytest.approx(room.high - room.low)


def test_the_grid_is_that_of_its_seed_and_stays_in_reach() -> None:
    room = motion_limits_of(load_scene("emio"), 0.5)
    settings = ExcitationSettings(poses=20, levels=4, seed=3)
    poses = grid(room, settings)
    assert len(np.unique(poses, axis=0)) == 20
    assert (poses >= room.low).all()
    assert (poses <= room.high).all()
    np.testing.assert_array_equal(poses, grid(room, settings))
    assert not np.array_equal(poses, grid(room, replace(settings, seed=4)))
    assert len(grid(room, replace(settings, poses=1000))) == 4**4
    assert len(grid(room, replace(settings, levels=40, poses=7))) == 7  # of 2.6 million


@pytest.mark.parametrize("limits", [JointLimits(), JointLimits(lower=-1.0), JointLimits(0.5, 0.5)])
def test_a_joint_without_a_range_is_refused(limits: JointLimits) -> None:
    robot = load_scene("tripod")
    joints = (replace(robot.joints[0], limits=limits), *robot.joints[1:])
    with pytest.raises(
        SceneError, match=r"joint servo_0 of tripod has the limits .*; give it a finite range"
    ):
        motion_limits_of(robot.with_scene(joints=joints), 0.5)


@pytest.mark.parametrize(
    "wrong",
    [
        {"reach": 0.0},
        {"reach": 1.5},
        {"speed": -1.0},
        {"poses": 0},
        {"levels": 1},
        {"chirp_s": float("nan")},
        {"highest_hz": 20.0},
        {"kinds": ("jump",)},
    ],
)
def test_settings_that_cannot_be_played_are_a_sentence(wrong: dict[str, object]) -> None:
    with pytest.raises(SceneError, match=next(iter(wrong))):
        ExcitationSettings(**wrong)  # type: ignore[arg-type]


def test_a_description_is_read_as_it_was_written(tmp_path: Path) -> None:
    sensor = SensorDescription(
        name="top", columns=("x_mm", "y_mm", "z_mm"), unit="mm", place=(0.0, 0.0, 0.03)
    )
    session = SessionDescription(
        name="first",
        file=Path("first.csv"),
        sensors=(sensor,),
        commands=CommandColumns(columns=("a_rad", "b_rad", "c_rad")),
        split=SplitDescription(held_out_share=0.25, seed=2),
        alignment=AlignmentDescription(frame=True),
        suspect="moving",
    )
    later = replace(session, name="later", split=None, time=TimeColumn(column="time_s", first=0.5))
    written = DataSetDescription(name="bench", robot="tripod", sessions=(session, later), source="here")
    write_description(tmp_path, written)
    random = np.random.default_rng(0)
    names = ["time_s", "a_rad", "b_rad", "c_rad", "x_mm", "y_mm", "z_mm", "moving"]
    columns = dict(zip(names, random.uniform(-1.0, 0.0, (len(names), 8)), strict=True))
    columns |= {"time_s": np.arange(8.0), "moving": np.eye(8)[3]}
    write_table(tmp_path / "first.csv", columns, ["made"])
    data = load_data_set(tmp_path)
    assert data.description == written
    rows, in_time = (load_session(data, each) for each in data.description.sessions)
    assert rows.measured[:, 0, 1] == pytest.approx(1e-3 * columns["y_mm"])
    assert rows.used.tolist() == [True] * 3 + [False] + [True] * 4
    assert in_time.times is not None
    assert rows.commands(load_scene("tripod"))[:, 2] == pytest.approx(columns["c_rad"])


@pytest.mark.parametrize(("robot", "sought"), [("tripod", 4), ("emio", 5), ("pneu_finger", 1)])
def test_a_first_calibration_fits_its_robot(robot: str, sought: int, tmp_path: Path) -> None:
    described = load_scene(robot)
    calibration = first_calibration("bench", described, ["grid"], False)
    assert calibration is not None
    assert len(calibration.parameters) == sought
    write_calibration(tmp_path, calibration)
    read, _ = load_calibration(tmp_path)
    assert read == calibration
    values = {each.name: each.start for each in read.parameters}
    moved = load_scene(robot, replace_expressions(read.overlay, values))
    assert moved.joints == described.joints
    assert moved.scene.bodies[0].material.values == pytest.approx(described.scene.bodies[0].material.values)
    in_time = first_calibration("bench", described, ["chirp"], True)
    assert in_time is not None
    assert "damping" in [each.name for each in in_time.parameters]


def test_a_calibration_finds_its_data_set(tmp_path: Path) -> None:
    calibration = first_calibration("bench", load_scene("tripod"), ["grid"], False)
    assert calibration is not None
    file = write_calibration(tmp_path, calibration)
    sensor = SensorDescription(name="top", columns=("x_m", "y_m", "z_m"))
    session = SessionDescription(name="grid", file=Path("grid.csv"), sensors=(sensor,))
    write_description(tmp_path, DataSetDescription(name="bench", robot="tripod", sessions=(session,)))
    assert data_of(calibration, file, None).description.name == "bench"
