"""The files of a robot that begins with a part alone: a commented scene that runs at once, and its test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from softsim_core.meshing import MeshedPart
from softsim_core.meshing.guesses import Guess
from softsim_core.scene.generated import on_one_line, scalar
from softsim_core.values import Box
from softsim_ros.cli.robots.mesh_speed import DENSITY, POISSON

_DT = 0.01


def scene_text(
    name: str,
    made: MeshedPart,
    guess: Guess,
    preset: str,
    factor: float,
    doubts: Sequence[str] = (),
    dt: float = _DT,
) -> str:
    """The scene in YAML.

    Args:
        name: Of the robot, and of its files.
        made: Its mesh.
        guess: What is assumed of it.
        preset: Name of an elastomer.
        factor: Of its stiffness.
        doubts: What speaks against the guess of a cable.
        dt: Time step in [s].
    """
    order, tilt = made.mesh.order, guess.tilt_deg
    order_line = "\n    order: 2  # quadratic elements" if order == 2 else ""
    at = (
        "its lowest face"
        if guess.axis == 2
        else f"the low end of its longest side, along {'xyz'[guess.axis]}"
    ) + (f" (of its own axes: it lies askew by {tilt:.0f} degrees in its file)" if tilt else "")
    hollow = made.source.cavities == 1
    joint = _chamber() if hollow else "".join(f"  # {each}\n" for each in doubts) + _cable(guess)
    step, unit = (1000.0, "Pa") if hollow else (0.01 * guess.length, "m")
    pulled = 8000.0 if hollow else 0.06 * guess.length
    moves = ("pump", "let air out") if hollow else ("pull the cable", "let the cable go")
    nodes = made.report.nodes
    file, mass = on_one_line(Path(made.source.surface.name).name), 1e3 * DENSITY * made.report.volume
    return f"""\
# {name}: made of {file} by `softsim new`. SI units (m, kg, s, Pa), z up.
# What is a GUESS here is marked so: look at each in the page (softsim up), then correct it.
name: {name}
dt: {number(dt)}  # time step; every dt is stable, a smaller one damps less
gravity: [0.0, 0.0, -9.81]
solver: {{rayleigh_stiffness: 0.01}}  # damping; GUESS

bodies:
  - name: part
    mesh: {{file: {name}.vtk}}  # {nodes} nodes; keep it: the mesher does not make a mesh twice{order_line}
    # GUESS: `softsim material` lists others; or {{young_modulus: 250.0e+3, poisson_ratio: 0.45}}
    material: {{preset: {scalar(preset)}, stiffness_factor: {factor:g}, poisson_ratio: {POISSON[order]:g}}}
    density: {DENSITY:g}  # of silicone; by this the part weighs {mass:.3g} g: weigh a casting
    colour: [0.9, 0.6, 0.4, 0.6]

joints:
{joint}
attachments:
  # GUESS: held at {at}: all nodes in this box
  - {{name: base, body: part, to: world, box: {_box(guess.held)}}}
  # the tip, whose pose is told on a topic and moved by inverse control
  - name: tip
    body: part
    to: free
    box: {_box(guess.tip)}
    frame: {{translation: {number_list(guess.tip_place)}}}
effector: tip

poses:
  start: [0.0]
  moved: [{number(pulled)}]
{"" if hollow else "inverse: {task: position, posture_weight: 0.0}" + chr(10)}
keys:  # each on the plain key and with Ctrl; by: {unit} from where it is
  plus: {{joints: [{"air" if hollow else "cable"}], by: {number(step)}, help: {moves[0]}}}
  minus: {{joints: [{"air" if hollow else "cable"}], by: {number(-step)}, help: {moves[1]}}}
  q: {{pose: moved, help: moved pose}}
  a: {{pose: start, help: start pose}}
"""


def _chamber() -> str:
    return """\
  # GUESS: the hollow inside is an air chamber, commanded by its pressure in Pa
  - name: air
    kind: chamber
    limits: {lower: 0.0, upper: 1.0e+4, speed: 1.0e+4}
    chamber: {body: part, control: pressure}
"""


def _cable(guess: Guess) -> str:
    upper, speed = 0.1 * guess.length, 0.5 * guess.length
    points = "\n".join(f"        - {number_list(point)}" for point in guess.cable)
    return f"""\
  # GUESS: one cable along the longest axis, near one side; it slides through points and ends at the last
  - name: cable
    kind: cable
    limits: {{lower: 0.0, upper: {number(upper)}, speed: {number(speed)}}}  # how far it is pulled in, in m
    cable:
      body: part
      points:
{points}
      pull_point: {number_list(guess.pull_point)}  # where it leaves towards the motor
      max_tension: 10.0  # in N
"""


def _box(box: Box) -> str:
    turned = f", rotation_deg: {number_list(box.rotation_deg)}" if any(box.rotation_deg) else ""
    return f"{{center: {number_list(box.center)}, size: {number_list(box.size)}{turned}}}"


def number_list(values: tuple[float, ...]) -> str:
    """A YAML list of such numbers."""
    return "[" + ", ".join(number(each) for each in values) + "]"


def number(value: float) -> str:
    """A number as YAML takes it for one: with a point and without an exponent, to a nanometre."""
    text = f"{value:.9f}".rstrip("0")
    return "0.0" if float(text) == 0.0 else text + "0" * text.endswith(".")


def test_text(name: str, made: MeshedPart, guess: Guess) -> str:
    """A test of that scene for pytest."""
    pulled = 8000.0 if made.source.cavities == 1 else 0.06 * guess.length
    return f'''\
"""{name} comes to rest under its own weight, stays where it is held, and moves when it is told to."""

from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_scene

SCENE = Path(__file__).with_name("{name}.yaml")
LENGTH = {guess.length:.6g}  # in m


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    simulation = Simulation(load_scene(SCENE))
    for _ in range(150):
        simulation.step()
    return simulation


def test_it_rests(simulation: Simulation) -> None:
    before = simulation.positions.copy()
    simulation.step()
    assert np.isfinite(simulation.positions).all()
    assert np.abs(simulation.positions - before).max() < 1e-3 * LENGTH


def test_it_moves(simulation: Simulation) -> None:
    before = simulation.positions.copy()
    simulation.command([{pulled:.4g}])
    for _ in range(100):
        simulation.step()
    assert np.isfinite(simulation.positions).all()
    moved = np.linalg.norm(simulation.positions - before, axis=1)
    assert 1e-3 * LENGTH < moved.max() < LENGTH
    assert moved.min() < 1e-9  # where it is held
'''
