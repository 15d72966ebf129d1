"""`softsim bench` runs, tells the machine, writes its JSON; its verdicts follow from the numbers."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import (
    ALL,
    LIMIT_MS,
    LIMITS,
    SCENES,
    TOUCHING,
    Case,
    Probe,
    Record,
    TouchingScene,
    can_control,
    command,
    default_reference_dir,
    describe,
    measure_rubber,
    measure_sensors,
    measured_scenes as cases,
    reference_size,
    rubber_table,
    sensor_table,
    set_ratios,
    steps,
    table,
)
from softsim_core import Simulation
from softsim_core.base import Contender, SoftSimError, limit_threads, take_turns

KEYS = ("scene", "mesh", "path", "nodes", "elements", "min_ms", "median_ms", "splu_min_ms")
REPOSITORY = Path(__file__).resolve().parents[2]


def run_bench(*words: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", "bench", *words],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"PYTHONPATH": path},
        check=False,
    )


@pytest.fixture(scope="module")
def quick_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[dict[str, Any]]]:
    file = tmp_path_factory.mktemp("bench") / "numbers.json"
    done = run_bench("--quick", "--rounds", "3", "--mesh", "low", "--json", str(file))
    assert done.returncode == 0, done.stderr
    return done.stdout, json.loads(file.read_text())


@pytest.mark.slow
def test_bench_tells_machine_threads_and_verdicts(quick_run: tuple[str, list[dict[str, Any]]]) -> None:
    printed, _ = quick_run
    for word in ("cores", "Python", "numpy", "scipy", "one thread", "min ms", "median ms", "verdict"):
        assert word in printed


@pytest.mark.slow
def test_bench_json_has_the_fixed_keys_first(quick_run: tuple[str, list[dict[str, Any]]]) -> None:
    _, records = quick_run
    scenes = {"held_centre", "tripod", *TOUCHING} | ({"inverse"} if can_control() else set())
    assert {(each["scene"], each["mesh"]) for each in records} == {(scene, "low") for scene in scenes}
    for each in records:
        assert tuple(each)[: len(KEYS)] == KEYS
        assert 0.0 < each["min_ms"] <= each["median_ms"]
        assert each["nodes"] > 150
        assert each["elements"] > 500


@pytest.mark.slow
def test_records_have_the_limits_and_ratios_that_check_judges(
    quick_run: tuple[str, list[dict[str, Any]]],
) -> None:
    pytest.importorskip("numba")
    _, records = quick_run
    step = {(each["scene"], each["path"]): each for each in records}
    held = step["held_centre", "numba"]
    assert held["scipy_ratio"] == pytest.approx(held["min_ms"] / step["held_centre", "scipy"]["min_ms"])
    if can_control():
        assert step["inverse", "numba"]["limit"] == 3.0
    for scene in TOUCHING:
        assert step[scene, "numba"]["limit"] == pytest.approx(LIMITS[scene] / 0.17)
        assert step[scene, "numba"]["scipy_ratio"] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["held_centre", *TOUCHING])
@pytest.mark.filterwarnings("ignore::UserWarning")  # slivers of the reference's meshes
def test_scenes_run_on_the_reference_meshes_too(reference_dir: Path, scene: str) -> None:
    description = describe(scene, "reference_low", reference_dir)
    simulation = Simulation(description)
    assert (len(simulation.positions), len(simulation.tets)) == reference_size(scene, "reference_low")
    ours = Simulation(describe(scene, "low", reference_dir))
    np.testing.assert_allclose(
        simulation.positions.min(axis=0), ours.positions.min(axis=0), atol=5e-4
    )  # the tip is round
    np.testing.assert_allclose(
        simulation.positions.max(axis=0), ours.positions.max(axis=0), atol=5e-4
    )  # the tip is round
    assert len(simulation.collision_surfaces) == len(ours.collision_surfaces)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_grasp_is_measured_while_fingers_touch_the_cube(reference_dir: Path) -> None:
    for mesh in ("low", "reference_low"):
        scene = TouchingScene("gripper_grasp", describe("gripper_grasp", mesh, reference_dir), "numba")
        scene.simulation.step()
        contacts = scene.simulation.contacts
        names = [surface.name for surface in scene.simulation.collision_surfaces]
        forces = np.linalg.norm(contacts.forces, axis=1)
        keys = scene.simulation._state.warm_start[:, 0]
        assert len(np.unique(keys)) == len(keys), "each contact is solved for once"
        for k in (1, 2, 3):
            pair = {names.index("cube"), names.index(f"finger_{k}")}
            assert sum(f for f, (a, b) in zip(forces, contacts.pairs, strict=True) if {a, b} == pair) > 0.1


def test_without_a_checkout_the_command_says_where_it_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from softsim_ros.cli.upkeep import bench

    monkeypatch.setattr(bench, "__file__", str(tmp_path / "softsim_ros" / "cli" / "upkeep" / "bench.py"))
    with pytest.raises(SoftSimError, match=r"run \./softsim bench in a checkout"):
        bench.configure(argparse.ArgumentParser())


def test_the_command_knows_the_scenes_that_are_measured() -> None:
    assert SCENES == cases.SCENES


@pytest.mark.parametrize("name", command.MEASUREMENTS)
@pytest.mark.parametrize("has_numba", [True, False])
def test_an_option_runs_its_measurement_alone(
    name: str, has_numba: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measurement = command.MEASUREMENTS[name]
    monkeypatch.setitem(command.MEASUREMENTS, name, measurement._replace(run=lambda _: 7))
    monkeypatch.setattr(command, "limit_threads", lambda _: True)
    monkeypatch.setattr(steps, "known_paths", lambda: ("scipy", *(("numba",) if has_numba else ())))
    parser = argparse.ArgumentParser()
    command.configure(parser)
    refused = measurement.needs_numba and not has_numba
    assert command.run(parser.parse_args([f"--{name}"])) == (2 if refused else 7)
    printed = capsys.readouterr()
    assert bool(printed.out) == (measurement.describes_machine and not refused)
    numba = f"softsim bench: --{name} needs the package numba: pip install numba\n"
    assert printed.err == (numba if refused else "")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--mesh", "huge"), "unknown mesh huge; known meshes: low"),
        (("--mesh", "reference_low", "--reference", "/nowhere"), "use --reference DIR"),
        (("--rounds", "0"), "--rounds must be at least 1"),
        (("--bridge", "--seconds", "0"), "--seconds must be at least 1"),
    ],
)
@pytest.mark.slow
def test_wrong_usage_is_one_sentence(words: tuple[str, ...], sentence: str) -> None:
    done = run_bench(*words)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.numba
def test_rubber_is_measured_beside_splu_and_air_beside_none() -> None:
    beam, cube = measure_rubber(1, ("cantilever_quadratic", "inflated_cube"))
    assert (beam.nodes, beam.against, beam.measured) == (325, "splu", beam.step[0])
    assert cube.against == "none"
    assert cube.measured == pytest.approx(cube.step[0] / cube.beside[0] - 1.0)
    late = replace(cube, step=(1.2, 1.3), beside=(1.0, 1.1))
    assert late.missed
    assert late.measured == pytest.approx(0.2)
    lines = rubber_table([beam, late])
    assert "splu" in lines[1]
    assert lines[2].split()[-6:] == ["+20.0", "%", "<=", "15", "%", "MISSED"]


@pytest.mark.slow
def test_each_sensor_is_measured_alone_and_all_together() -> None:
    times = measure_sensors(3)
    assert [each.sensor for each in times][:2] == ["skin (tactile)", "press (wrench)"]
    assert times[-1].sensor == ALL
    assert all(0.0 < each.min_ms <= each.median_ms for each in times)
    assert len(sensor_table(times)) == len(times) + 1
    assert replace(times[-1], min_ms=LIMIT_MS + 0.1).missed
    assert not replace(times[0], min_ms=LIMIT_MS + 0.1).missed


def test_missed_target_is_named() -> None:
    held = Record("held_centre", "low", "numba", 10, 20, min_ms=1.0, median_ms=1.1, splu_min_ms=5.0)
    robot = Record("tripod", "low", "numba", 10, 20, min_ms=1.5, median_ms=1.7, splu_min_ms=5.0)
    set_ratios([held, robot])
    assert held.missed
    assert held.ratio == pytest.approx(0.2)
    assert not robot.missed
    assert robot.ratio == pytest.approx(1.5)
    assert "MISSED" in table([held])[1]
    assert "1/5.0 splu" in table([held])[1]


def test_a_processor_on_which_splu_is_fast_does_not_miss_a_target() -> None:
    """The step costs a fifth of splu, but few probes: a fixed kernel that streams and multiplies."""
    held = Record("held_centre", "mid", "numba", 10, 20, min_ms=1.0, median_ms=1.1, splu_min_ms=5.0)
    set_ratios([held])
    for probe_ms, missed in ((2.0, False), (0.1, True)):
        held.probe_min_ms = probe_ms
        assert held.missed is missed
        assert held.as_json()["probe_ratio"] == 1.0 / probe_ms
    assert "probes" in table([held])[1]


def test_the_probe_multiplies_its_panels() -> None:
    pytest.importorskip("numba")
    probe = Probe()
    probe.run()
    np.testing.assert_allclose(probe.squares, np.einsum("pri,prj->pij", probe.panels, probe.panels))


def test_contenders_take_turns() -> None:
    order: list[str] = []
    contenders = [
        Contender("a", lambda: order.append("a"), calls=2, prepare=lambda: order.append("prepare")),
        Contender("b", lambda: order.append("b")),
    ]
    times = take_turns(contenders, rounds=2)
    assert order == ["prepare", "a", "b", "prepare", "a", "a", "b", "b", "prepare", "a", "a"]
    assert {name: len(each) for name, each in times.items()} == {"a": 4, "b": 2}


def test_thread_limit_is_asked_before_numpy_is_loaded() -> None:
    code = (
        f"import os, sys; sys.path.append({str(REPOSITORY)!r}); "
        "import benchmarks.command as bench; assert 'numpy' not in sys.modules; "
        "assert bench.limit_threads(os.environ); assert os.environ['OPENBLAS_NUM_THREADS'] == '1'"
    )
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=True, timeout=300)
    environment = {"OPENBLAS_NUM_THREADS": "2"}
    assert not limit_threads(environment)  # NumPy is loaded in this process
    assert set(environment.values()) == {"1"}


def low_case() -> Case:
    return Case("held_centre", "low", describe("held_centre", "low", default_reference_dir()))


@pytest.mark.slow
@pytest.mark.parametrize("package", ["pydrake", "mujoco"])
def test_other_engines_find_our_sag(package: str) -> None:
    pytest.importorskip(package, reason=f"{package} is not installed: pip install 'softsim[peers]'")
    from benchmarks.peers import compare

    records, _ = compare(low_case(), rounds=1)
    sags = [each.extras for each in records if each.path == package.removeprefix("py")]
    assert sags
    for extras in sags:
        assert extras["sag_mm"] == pytest.approx(extras["ours_sag_mm"], rel=0.05)


@pytest.mark.slow
@pytest.mark.numba
def test_growing_bodies_are_compared_without_waiting_for_rest() -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'softsim[mjcf]'")
    from benchmarks import clamped_scene, mesh_of, peer_table
    from benchmarks.peers import compare
    from softsim_core.scene import RobotDescription

    scene = RobotDescription(scene=clamped_scene(mesh_of("silicone", "1k")))
    records, _ = compare(Case("scaling", "silicone 1k", scene), rounds=1, to_rest=False)
    assert {"mujoco", "mujoco_unconverged"} <= {each.path for each in records}
    for record in records:
        assert min(record.extras["ours_min_ms"], record.min_ms) > 0.0
        assert record.extras["sag_mm"] is record.extras["ours_sag_mm"] is None
    assert len(peer_table(records)) == 1 + len(records)


@pytest.mark.slow
def test_drake_finds_exactly_our_sag_with_its_masses() -> None:
    pytest.importorskip("pydrake", reason="pydrake is not installed: pip install 'softsim[peers]'")
    from benchmarks.peers import DrakeBody, clamped_body
    from softsim_core import Simulation

    case = low_case()
    body = clamped_body(case.description)
    ours, drake = Simulation(case.description, backend="scipy"), DrakeBody(body)
    elements = ours.model.groups[0]
    quarters = np.repeat(elements.volumes / 4.0, 4)
    by_volume = np.bincount(elements.cells.ravel(), quarters, minlength=len(body.points))
    ours.model.mass[:] = body.total_mass * by_volume / body.volume  # the SciPy path reads it in every step
    for _ in range(200):
        ours.step()
        drake.advance()
    assert body.sag(drake.points()) == pytest.approx(body.sag(ours.positions), rel=1e-3)


def test_missing_engines_say_how_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.peers import comparison

    monkeypatch.setitem(sys.modules, "pydrake", None)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    records, missing = comparison.compare(low_case(), rounds=1)
    assert records == []
    assert len(missing) == 2
    assert all("pip install " in sentence for sentence in missing)
