"""Pump lines: air that compresses, leaks, is pumped with a limit: closed forms, snapshots, any step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import scene
from test_chambers import CELL, balloon, hollow, inflated

from softsim_core import Simulation
from softsim_core.base import SceneError
from softsim_core.physics.actuation.chamber import ATMOSPHERE, ChamberDescription
from softsim_core.scene import BodyDescription, JointDescription, MaterialDescription, SceneDescription

HOLLOW, HOSE = 8.0 * CELL**3, 2e-6
BACKENDS = ["scipy", pytest.param("numba", marks=pytest.mark.numba)]


def stiff(control: str = "volume", dt: float = 0.01, backend: str = "auto", **line: Any) -> SceneDescription:
    """A cube that hardly gives way, on a line that is full of air."""
    described = inflated(hollow(), control, dt, backend, line_volume=HOSE, **line)
    hard = MaterialDescription(law="stable_neo_hookean", young_modulus=1e10, poisson_ratio=0.45)
    return replace(described, bodies=(replace(described.bodies[0], material=hard),))


def pressures(simulation: Simulation, steps: int) -> Any:
    found = []
    for _ in range(steps):
        simulation.step()
        found.append(float(simulation.joint_efforts[0]))
    return np.array(found)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("exponent", [1.0, 1.4])
@pytest.mark.parametrize("pumped", [5e-6, -4e-6])
@pytest.mark.slow
def test_air_in_a_rigid_hollow_keeps_p_v_k(exponent: float, pumped: float, backend: str) -> None:
    simulation = Simulation(stiff(exponent=exponent, backend=backend))
    closed = ATMOSPHERE * ((1.0 + pumped / (HOLLOW + HOSE)) ** exponent - 1.0)
    assert simulation.equilibrium([pumped]).state.joint_efforts[0] == pytest.approx(closed, rel=1e-4)
    simulation.command([pumped])
    assert pressures(simulation, 40)[-1] == pytest.approx(closed, rel=1e-4)


@pytest.mark.parametrize("dt", [0.002, 0.001])
@pytest.mark.slow
def test_a_leak_lets_the_pressure_fade(dt: float) -> None:
    """As exp(-L P0 t / V); steps are of first order."""
    leak, total = 4e-10, HOLLOW + HOSE
    simulation = Simulation(stiff(leak=leak, dt=dt))
    simulation.command([2e-7])
    seen = pressures(simulation, round(0.2 / dt))
    first = round(0.02 / dt)
    times = dt * np.arange(len(seen) - first)
    rate = leak * ATMOSPHERE / total
    fading = np.exp(-rate * times)
    assert np.abs(seen[first:] / seen[first] - fading).max() < 0.3 * rate * dt
    assert simulation.equilibrium([2e-7]).state.joint_efforts[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("control", ["volume", "pressure"])
@pytest.mark.slow
def test_a_pump_fills_no_quicker_than_it_can(control: str) -> None:
    """The pressure of a rigid hollow rises by P0 F / V each second, up to the command, and falls likewise."""
    flow, dt = 2e-5, 0.001
    simulation = Simulation(stiff(control, flow_limit=flow, dt=dt))
    top = 2e4
    content = top / ATMOSPHERE * (HOLLOW + HOSE)
    slope = ATMOSPHERE * flow / (HOLLOW + HOSE)
    times = dt * np.arange(1, 141)
    for command, start in ((top, 0.0), (0.0, top)):
        simulation.command([command if control == "pressure" else command / top * content])
        ramp = np.clip(start + np.sign(command - start) * slope * times, 0.0, top)
        assert np.abs(pressures(simulation, 140) - ramp).max() < 0.002 * top


@pytest.mark.slow
def test_a_regulator_that_leaks_holds_what_its_flow_can() -> None:
    simulation = Simulation(stiff("pressure", flow_limit=1e-5, leak=1e-9))
    simulation.command([2e4])
    assert pressures(simulation, 200)[-1] == pytest.approx(1e4, rel=1e-6)
    assert simulation.equilibrium([2e4]).state.joint_efforts[0] == pytest.approx(1e4, rel=1e-6)
    assert simulation.equilibrium([5e3]).state.joint_efforts[0] == pytest.approx(5e3, rel=1e-6)


@pytest.mark.slow
def test_air_let_out_at_the_largest_pressure_is_gone() -> None:
    """A relief valve at 20 kPa; then the pump takes back all that it has pushed in: less than at first."""
    simulation, total = Simulation(stiff(max_pressure=2e4)), HOLLOW + HOSE
    simulation.command([5e-6])
    assert pressures(simulation, 20)[-1] == pytest.approx(2e4)
    simulation.command([0.0])
    left = total * (1.0 + 2e4 / ATMOSPHERE) - 5e-6
    assert pressures(simulation, 40)[-1] == pytest.approx(ATMOSPHERE * (left / total - 1.0), rel=1e-4)


LINES: dict[str, dict[str, Any]] = {
    "volume": {"control": "volume", "line_volume": HOSE, "exponent": 1.2},
    "pump": {"control": "volume", "line_volume": HOSE, "flow_limit": 2e-5, "line_compliance": 1e-11},
    "regulator": {"control": "pressure", "line_volume": HOSE, "flow_limit": 1e-5, "leak": 1e-10},
    "water": {"control": "volume", "flow_limit": 5e-6},
}
GIVEN = {"volume": 3e-6, "pump": 3e-6, "regulator": 6e3, "water": 1.2e-6}


@pytest.mark.slow
@pytest.mark.parametrize("kind", LINES)
def test_rest_does_not_depend_on_the_step(kind: str) -> None:
    """Nodes to a micrometre, and where statics find them; on the way there, to first order in dt."""
    ends, ways = [], []
    for dt in (0.001, 0.005, 0.01):
        simulation = Simulation(inflated(hollow(), dt=dt, **LINES[kind]))
        simulation.command([GIVEN[kind]])
        growth = []
        for _ in range(round(1.2 / dt)):
            simulation.step()
            growth.append(simulation.joint_positions[0])
        ends.append(simulation.positions)
        ways.append(np.array(growth)[round(0.1 / dt) - 1])
    assert max(np.abs(end - ends[0]).max() for end in ends[1:]) < 1e-6
    resting = simulation.equilibrium([GIVEN[kind]])
    assert resting.state.joint_positions[0] > 2e-7
    assert np.abs(resting.state.positions - ends[0]).max() < 1e-6
    assert abs(ways[1] - ways[0]) < 0.6 * abs(ways[2] - ways[0]) + 1e-10


@pytest.mark.numba
@pytest.mark.parametrize("kind", LINES)
@pytest.mark.slow
def test_both_implementations_agree(kind: str) -> None:
    pytest.importorskip("numba")
    fast, readable = (
        Simulation(inflated(hollow(2), **LINES[kind]), backend) for backend in ("numba", "scipy")
    )
    largest = 0.0
    for step in range(24):
        for simulation in (fast, readable):
            simulation.command([GIVEN[kind] if step < 12 else 0.0])
            simulation.step()
        largest = max(largest, fast.joint_efforts[0])
        np.testing.assert_allclose(fast.positions, readable.positions, atol=1e-9)
        np.testing.assert_allclose(fast.joint_efforts, readable.joint_efforts, rtol=1e-6, atol=1e-4)
    assert largest > 1e3


@pytest.mark.parametrize("kind", LINES)
@pytest.mark.parametrize("scheme", ["implicit_euler", "bossak"])
def test_snapshots_go_on_bit_for_bit(kind: str, scheme: str) -> None:
    described = inflated(hollow(), **LINES[kind])
    solver = replace(described.solver, time_integration=scheme)  # type: ignore[arg-type]
    simulation = Simulation(replace(described, solver=solver))
    simulation.command([GIVEN[kind]])
    pressures(simulation, 7)
    taken = simulation.snapshot()
    once = pressures(simulation, 9), simulation.snapshot()
    simulation.restore(taken)
    again = pressures(simulation, 9), simulation.snapshot()
    assert once[1] == again[1]
    other = Simulation(replace(described, solver=solver))
    other.restore(taken)
    assert (pressures(other, 9) == once[0]).all()


@pytest.mark.parametrize("scheme", ["implicit_euler", "bossak"])
def test_time_passes_alike_in_every_scheme(scheme: str) -> None:
    """What a pump has pushed in after 0.1 s is its flow times 0.1 s."""
    described = inflated(hollow(), **LINES["water"])
    solver = replace(described.solver, time_integration=scheme)  # type: ignore[arg-type]
    simulation = Simulation(replace(described, solver=solver))
    simulation.command([1e-6])
    pressures(simulation, 10)
    assert simulation.joint_positions[0] == pytest.approx(5e-7, rel=1e-3)


def air_balloon(line_volume: float) -> tuple[Simulation, float]:
    """A thick sphere of neo-Hookean rubber on a line of air, and the volume in it at rest in [m^3]."""
    inner, outer, shear = 0.01, 0.013, 2e4
    rubber = MaterialDescription(law="yeoh", c1=0.5 * shear, poisson_ratio=0.499)
    air = ChamberDescription(body="body", control="volume", line_volume=line_volume)
    described = scene(
        BodyDescription(name="body", mesh=balloon(inner, outer), material=rubber, density=1000.0),
        joints=(JointDescription(name="air", kind="chamber", actuator=air),),
        gravity=(0.0, 0.0, 0.0),
        rayleigh_mass=40.0,
        dt=0.01,
    )
    return Simulation(described), 4.0 / 3.0 * np.pi * inner**3


@pytest.mark.slow
def test_a_balloon_on_a_stiff_line_passes_its_largest_pressure() -> None:
    """Against its closed curve, see test_chambers, and the air's own law at every step."""
    simulation, volume = air_balloon(0.0)
    seen = []
    for stretch in np.linspace(1.0, 2.4, 200)[1:]:
        wide = (0.013**3 + (stretch**3 - 1.0) * 0.01**3) ** (1.0 / 3.0) / 0.013
        curve = 4e4 * (1.0 / wide + 0.25 / wide**4 - 1.0 / stretch - 0.25 / stretch**4)
        pumped = volume * (stretch**3 * (1.0 + curve / ATMOSPHERE) - 1.0)
        simulation.command([pumped])
        simulation.step()
        pressure, growth = simulation.joint_efforts[0], simulation.joint_positions[0]
        content = (ATMOSPHERE + pressure) * (volume + growth)
        seen.append((stretch, pressure / curve, content / (ATMOSPHERE * (volume + pumped)), curve))
    table = np.array(seen)
    later = table[table[:, 0] > 1.2]
    assert 0 < np.argmax(later[:, 3]) < len(later) - 30
    assert np.abs(later[:, 1] - 1.0).max() < 0.03
    assert np.abs(later[:, 2] - 1.0).max() < 0.02  # the mesh's volume is a little less than the sphere's


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"line_volume": -1e-6}, "line_volume must be >= 0"),
        ({"exponent": 0.5}, "exponent must be in 1 to 2"),
        ({"leak": -1.0}, "leak must be >= 0"),
        ({"flow_limit": 0.0}, "flow_limit must be > 0"),
        ({"atmosphere": 0.0}, "atmosphere must be > 0 Pa"),
    ],
)
def test_lines_that_cannot_be_are_refused(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        inflated(hollow(), **fields)
