"""Effector paths: interpolation, maze plans, files, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from softsim_core.base import CommandError, ConfigError
from softsim_core.control.inverse import (
    EffectorPath,
    find_path,
    known_paths,
    maze_path,
    read_csv_path,
    read_maze_plan,
    read_path,
    tilt_rotation,
    tilts_of,
)
from softsim_core.physics.mechanics import rotation_of

START = (0.0, 0.0, 0.03)
OURS_OF_REFERENCE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # (x, y, z) = (z, x, y)_ref


def random_path(seed: int, count: int = 6) -> EffectorPath:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.1, 1.0, count))
    return EffectorPath(
        times, rng.normal(size=(count, 3)), Rotation.random(count, random_state=rng).as_quat()
    )


@pytest.mark.parametrize("seed", range(5))
def test_positions_are_linear_and_turns_are_the_shortest(seed: int) -> None:
    path = random_path(seed)
    turns = Slerp(path.times, Rotation.from_quat(path.quaternions))
    for time in np.random.default_rng(seed).uniform(path.times[0], path.times[-1], 50):
        pose = path.sample(time)
        expected = [np.interp(time, path.times, path.positions[:, axis]) for axis in range(3)]
        assert pose.position == pytest.approx(expected, abs=1e-14)
        assert rotation_of(pose.quaternion_xyzw) == pytest.approx(turns(time).as_matrix(), abs=1e-12)


def test_a_path_stays_at_its_ends() -> None:
    path = random_path(1)
    for time, end in ((0.0, 0), (path.times[0], 0), (path.duration, -1), (1e9, -1)):
        assert np.array_equal(path.sample(time).position, path.positions[end])
    assert not path.is_over(path.duration - 0.01)
    assert path.is_over(path.duration)


def test_one_pose_is_a_path() -> None:
    path = EffectorPath([0.0], [START], [(0.0, 0.0, 0.0, 1.0)])
    assert path.duration == 0.0
    assert path.sample(3.0).position.tolist() == list(START)


def test_neighbours_on_opposite_half_spheres_turn_the_short_way() -> None:
    path = EffectorPath([0.0, 1.0], np.zeros((2, 3)), [(0.0, 0.0, 0.0, 1.0), (0.0, 0.0, -0.1, -0.99499)])
    assert path.sample(0.5).quaternion_xyzw[2] == pytest.approx(0.05006, abs=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_tilts_are_the_euler_angles_of_a_frame_with_y_up(seed: int) -> None:
    first, second, third = np.random.default_rng(seed).uniform(-1.5, 1.5, 3)
    reference = Rotation.from_euler(
        "xyz", [first, second, third]
    ).as_matrix()  # Rz(third) Ry(second) Rx(first)
    ours = OURS_OF_REFERENCE @ reference @ OURS_OF_REFERENCE.T
    assert tilt_rotation(third, first, second) == pytest.approx(ours, abs=1e-14)
    assert tilts_of(ours) == pytest.approx((third, first, second), abs=1e-12)


def test_a_maze_plan_follows_its_key_points() -> None:
    pairs = np.random.default_rng(7).uniform(-0.3, 0.3, (26, 2))
    path = maze_path(pairs, START)
    assert path.duration == pytest.approx(13.0)
    keys = np.vstack([np.zeros(2), pairs])
    for time in np.arange(0.0, 15.0, 0.01):
        theta_x, theta_z = (np.interp(time, 0.5 * np.arange(27), keys[:, axis]) for axis in range(2))
        height = np.interp(time, [0.0, 0.5], [30.0, 50.0])
        reference = Rotation.from_euler("z", theta_z) * Rotation.from_euler("x", theta_x)
        pose = path.sample(time)
        assert pose.position == pytest.approx(1e-3 * OURS_OF_REFERENCE @ [0.0, height, 0.0], abs=1e-12)
        expected = OURS_OF_REFERENCE @ reference.as_matrix() @ OURS_OF_REFERENCE.T
        assert rotation_of(pose.quaternion_xyzw) == pytest.approx(expected, abs=1e-9)


def test_a_csv_file_comes_back_the_same(tmp_path: Path) -> None:
    path, file = random_path(3), tmp_path / "path.csv"
    rows = np.column_stack([path.times, path.positions, path.quaternions])
    np.savetxt(file, rows, "%.17g", ",", header="time,x,y,z,qx,qy,qz,qw", comments="")
    again = read_csv_path(file)
    assert np.array_equal(again.times, path.times)
    assert np.array_equal(again.positions, path.positions)
    assert again.quaternions == pytest.approx(path.quaternions, abs=1e-15)


HEADER = "time,x,y,z,qx,qy,qz,qw\n"
GOOD = "0,0,0,0.03,0,0,0,1\n"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "row 1: the columns must be time,x,y,z"),
        ("t,x,y\n" + GOOD, "row 1: the columns must be time,x,y,z"),
        (HEADER, "it has no poses"),
        (HEADER + GOOD + "1,0,0,0.03,0,0,0\n", "row 3: must hold 8 numbers"),
        (HEADER + GOOD + "one,0,0,0.03,0,0,0,1\n", "row 3: must hold 8 numbers"),
        (HEADER + GOOD + "\n" + GOOD, "row 4: times must be >= 0 s and strictly increasing"),
        (HEADER + GOOD + "1,0,nan,0.03,0,0,0,1\n", "row 3: a position is not a finite number"),
        (HEADER + GOOD + "1,0,0,0.03,0,0,0,0\n", "row 3: the quaternion (x, y, z, w) must have length 1"),
    ],
)
def test_a_wrong_csv_file_is_one_sentence(tmp_path: Path, content: str, sentence: str) -> None:
    file = tmp_path / "wrong.csv"
    file.write_text(content)
    with pytest.raises(ConfigError) as refusal:
        read_path(file, START)
    assert str(refusal.value).startswith(str(file))
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "must be an object with the one key anglePlanningTable"),
        ('{"angles": []}', "must be an object with the one key anglePlanningTable"),
        ('{"anglePlanningTable": []}', "must be a list of one or more pairs"),
        ('{"anglePlanningTable": [[0, 1], [0.1]]}', "row 2: must be two finite angles in rad, not [0.1]"),
        ('{"anglePlanningTable": [[0, NaN]]}', "row 1: must be two finite angles in rad"),
        ('{"anglePlanningTable": [["a", true]]}', 'row 1: must be two finite angles in rad, not ["a", true]'),
    ],
)
def test_a_wrong_plan_is_one_sentence(tmp_path: Path, content: str, sentence: str) -> None:
    file = tmp_path / "wrong.json"
    file.write_text(content)
    with pytest.raises(ConfigError) as refusal:
        read_path(file, START)
    assert str(refusal.value).startswith(str(file))
    assert sentence in str(refusal.value)


def test_a_plan_is_read_and_begins_where_it_is_told(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_text(json.dumps({"anglePlanningTable": [[-0.3, 0.3], [0.3, 0]]}))
    assert read_maze_plan(file).tolist() == [[-0.3, 0.3], [0.3, 0.0]]
    assert read_path(file, (0.0, 0.001, 0.04)).sample(0.0).position.tolist() == [0.0, 0.001, 0.04]


@pytest.mark.parametrize(("name", "sentence"), [("nowhere.csv", "no such file"), ("", "no such file")])
def test_an_unknown_path_names_the_known_ones(name: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        find_path(name)
    assert sentence in str(refusal.value)
    assert "circle.csv" in str(refusal.value)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "path.txt"
    file.write_text("")
    with pytest.raises(ConfigError, match=r"ends in .json, .csv, not in '.txt'"):
        find_path(file)


def test_the_paths_that_come_with_the_suite_are_good() -> None:
    known = known_paths()
    assert {"circle.csv", "tilt_wave.json"} <= set(known)
    for name, file in known.items():
        path = read_path(name, START)
        assert 1.0 < path.duration < 60.0, file
        assert (np.abs(path.positions) < 0.1).all()
    assert find_path("circle") == known["circle.csv"]


def test_arrays_that_do_not_fit_are_refused() -> None:
    with pytest.raises(CommandError, match=r"do not fit 2 times; nothing was moved"):
        EffectorPath([0.0, 1.0], np.zeros((1, 3)), np.zeros((2, 4)))
    with pytest.raises(CommandError, match="needs one or more pairs"):
        maze_path([], START)
