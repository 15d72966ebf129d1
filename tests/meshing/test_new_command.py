"""`softsim new`: what it writes loads, rests, moves, and says what it guessed."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from part_surfaces import Surface, ball, box, inside_out, joined, moved, sheet, write

from softsim_core.lab.meshing import guess, have_mesher
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.physics.mesh import box_mesh, quadratic
from softsim_core.scene import load_scene, nodes_in
from softsim_core.scene.arm import read_urdf
from softsim_core.simulation import Simulation
from softsim_ros.cli import main
from softsim_ros.cli.robots import arm_text, number

REPOSITORY = Path(__file__).resolve().parents[2]
mesher = pytest.mark.skipif(not have_mesher(), reason="needs pytetwild (pip install 'softsim[mesh]')")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Meshes of the parts of this module: each is made once."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.chdir(tmp_path)


STANDING, LYING = box(12, 8, 60), box(60, 12, 8)
HOLLOW = joined(box(24, 24, 40), moved(inside_out(ball(9.0, 1)), z=5.0))
MADE: dict[str, tuple[Surface, list[str], int, str]] = {
    "standing": (moved(STANDING, 30.0, -20.0), [], 2, "cable"),
    "lying": (moved(LYING, 30.0, -20.0), ["--order", "2", "--material", "Ecoflex 00-30"], 0, "cable"),
    "hollow": (moved(HOLLOW, 30.0, -20.0), ["--material", "dragon skin 10 medium"], 2, "air"),
}


@mesher
@pytest.mark.parametrize("name", MADE)
@pytest.mark.slow
def test_a_new_robot_rests_and_moves(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    surface, words, axis, joint = MADE[name]
    part = write(tmp_path, surface, "part.stl")
    assert main(["new", name, "--from", str(part), "--size", "6", *words]) == 0
    shown = capsys.readouterr().out
    assert f"softsim up ./{name}/{name}.yaml" in shown
    assert sorted(file.name for file in (tmp_path / name).iterdir()) == [
        f"{name}.vtk",
        f"{name}.yaml",
        f"test_{name}.py",
    ]
    text = (tmp_path / name / f"{name}.yaml").read_text()
    assert text.count("GUESS") >= 4
    robot = load_scene(tmp_path / name / f"{name}.yaml")
    assert robot.scene.joint_names == (joint,)
    simulation = Simulation(robot)
    rest = simulation.positions.copy()
    held = rest[:, axis] < rest[:, axis].min() + 1e-4
    for _ in range(40):
        simulation.step()
    sagged = simulation.positions.copy()
    assert np.array_equal(sagged[held], rest[held])
    simulation.command(robot.poses["moved"])
    for _ in range(40):
        simulation.step()
    assert np.array_equal(simulation.positions[held], rest[held])
    way = np.linalg.norm(simulation.positions - sagged, axis=1).max()
    assert 1e-4 < way < 0.06
    assert simulation.positions.shape[0] == len(rest)
    if joint == "air":
        assert simulation.joint_positions[0] > 0.0  # its hollow has grown
    else:
        assert simulation.joint_positions[0] == pytest.approx(robot.poses["moved"][0], rel=1e-3)


ARM = REPOSITORY / "configs" / "arms" / "bench_arm.urdf"


@mesher
@pytest.mark.parametrize("name", MADE)
@pytest.mark.slow
def test_a_new_robot_hangs_on_an_arm(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("urdf_parser_py")
    surface, words, axis, joint = MADE[name]
    part = write(tmp_path, surface, "part.stl")
    words = [*words, "--arm", str(ARM), "--link", "flange"]
    assert main(["new", name, "--from", str(part), "--size", "6", *words]) == 0
    assert f"softsim up ./{name}/{name}_on_arm.yaml" in capsys.readouterr().out
    robot = load_scene(tmp_path / name / f"{name}_on_arm.yaml")
    assert robot.scene.joint_names[-1] == joint
    assert len(robot.scene.joint_names) == 7
    assert {"plus", "minus", "left", "right", "up", "down"} - set(robot.keys) == set()
    simulation = Simulation(robot)
    # at its zeros the arm stands straight up; the part's held end is in the middle of the link, along its z
    chain = read_urdf(ARM).joints[:-1]
    assert chain[-1].child == "flange"
    rest = simulation.positions.copy()
    held = rest[:, 2] < rest[:, 2].min() + 1e-4
    assert rest[held, 2] == pytest.approx(sum(each.origin.translation[2] for each in chain), abs=1e-4)
    middle = 0.5 * (rest[held].min(axis=0) + rest[held].max(axis=0))
    assert middle[:2] == pytest.approx([0.0, 0.0], abs=1e-3)
    length = np.ptp(Simulation(load_scene(tmp_path / name / f"{name}.yaml")).positions, axis=0)[axis]
    assert np.ptp(rest[:, 2]) == pytest.approx(length, abs=1e-6)
    # a quarter turn about the vertical carries it along
    simulation.command([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(60):
        simulation.step()
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    assert simulation.positions[held, :2] == pytest.approx(rest[held, :2] @ turn.T, abs=1e-6)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--link", "flange"], 2, "name the arm's file, too"),
        (["--arm", str(ARM), "--link", "thumb"], 1, "'thumb' is no link of bench_arm; known: base, shoulder"),
        (["--arm", "part.stl"], 1, "part.stl"),
        (["--arm", "none.urdf"], 1, "none.urdf"),
    ],
)
def test_an_arm_that_cannot_be_is_refused_before_meshing(
    words: list[str], code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("urdf_parser_py")
    write(tmp_path, STANDING, "part.stl")
    assert main(["new", "other", "--from", "part.stl", *words]) == code
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["part.stl"]


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -2.5, 8.5e-5, -3.0e-7, 1.0e-12, 12345.678, 1070.0])
def test_numbers_are_numbers_in_yaml(value: float) -> None:
    read = yaml.safe_load(number(value))
    assert isinstance(read, float)
    assert read == pytest.approx(value, abs=1e-9)


@mesher
@pytest.mark.slow
def test_its_own_test_passes(tmp_path: Path) -> None:
    part = write(tmp_path, MADE["standing"][0], "part.stl")
    assert main(["new", "post", "--from", str(part), "--size", "6"]) == 0
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "post"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["My Finger", "--from", "part.stl"], 2, "'My Finger' is no name"),
        (["../up", "--from", "part.stl"], 2, "is no name"),
        (["there", "--from", "part.stl"], 1, "there: is there already"),
        (["other", "--from", "part.stl"], 1, "is open: a hole of 28.35 mm across"),
        (["other", "--from", "part.stl", "--material", "wood"], 1, "wood"),
        (["other", "--from", "none.stl"], 1, "does not exist"),
        (
            ["other", "--from", "part.STEP"],
            1,
            "a CAD model of curved faces, which is not read; export",
        ),
    ],
)
def test_a_refusal_leaves_nothing(
    words: list[str], code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, sheet())
    (tmp_path / "there").mkdir()
    assert main(["new", *words]) == code
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["part.stl", "there"]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("lengths", "axis"), [((0.1, 0.02, 0.03), 0), ((0.03, 0.02, 0.1), 2), ((0.1, 0.1, 0.09), 2)]
)
def test_what_is_guessed_lies_where_it_should(
    lengths: tuple[float, float, float], axis: int, order: int
) -> None:
    mesh = box_mesh(lengths, tuple(round(each / 0.01) for each in lengths))
    mesh = quadratic(mesh) if order == 2 else mesh
    guessed = guess(mesh)
    assert guessed.axis == axis
    assert guessed.length == pytest.approx(lengths[axis])
    assert guessed.tip_place[axis] == pytest.approx(mesh.points[:, axis].max())
    cable = np.array(guessed.cable)
    assert (np.diff(cable[:, axis]) > 0.0).all()
    assert (cable > mesh.points.min(axis=0)).all()
    assert (cable < mesh.points.max(axis=0)).all()
    assert guessed.pull_point[axis] < mesh.points[:, axis].min()
    for end, place in (
        (guessed.base_box, mesh.points[:, axis].min()),
        (guessed.tip, mesh.points[:, axis].max()),
    ):
        inside = (np.abs(mesh.points - end.center) <= 0.5 * np.array(end.size)).all(axis=1)
        assert np.array_equal(inside, np.abs(mesh.points[:, axis] - place) < 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_part_that_lies_askew_is_guessed_along_its_own_axes(seed: int) -> None:
    """A bar turned at random: what is held, pulled and the tip are those of the straight one, turned."""
    axes = rotation_euler(np.random.default_rng(seed).uniform(-0.7, 0.7, 3))
    straight = box_mesh((0.03, 0.02, 0.1), (3, 2, 10))
    straight = replace(straight, points=straight.points - [0.015, 0.01, 0.0])
    guessed = guess(replace(straight, points=straight.points @ axes.T + [0.2, -0.1, 0.3]))
    points = straight.points @ axes.T + [0.2, -0.1, 0.3]
    expected = guess(straight)
    assert expected.tilt_deg == 0.0
    assert guessed.length == pytest.approx(0.1)
    along = guessed.axes[:, guessed.axis]
    assert abs(along @ axes[:, 2]) == pytest.approx(1.0)
    depth = (points - points.mean(axis=0)) @ along
    for end, at in ((guessed.base_box, depth.min()), (guessed.tip, depth.max())):
        assert nodes_in(end, points).tolist() == np.flatnonzero(np.abs(depth - at) < 1e-9).tolist()
    assert len(guessed.cable) == len(expected.cable)
    assert (np.diff(np.array(guessed.cable) @ along) > 0.0).all()
    assert (np.array(guessed.pull_point) - points.mean(axis=0)) @ along < depth.min()
    # on an arm its held end is at the origin of the link, and it points along +z
    pytest.importorskip("urdf_parser_py")
    hung = yaml.safe_load(arm_text("bar", ARM, read_urdf(ARM), "tool", guessed))["arm"]["tools"][0]["pose"]
    turn = rotation_euler(np.radians(hung["rotation_deg"]))
    assert turn @ along == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert turn @ np.array(guessed.base_box.center) + hung["translation"] == pytest.approx(
        np.zeros(3), abs=1e-6
    )
