"""`softsim new NAME --from PART`: create a folder with a robot of that part, which runs at once."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softsim_core.base import Box, ConfigError, SceneError, listing, on_one_line, write_file
from softsim_core.lab.meshing import Guess, MeshedPart, RepairedSurface, guess, mesh_part, open_hollows
from softsim_core.physics.fem.materials import elastomer
from softsim_core.physics.mechanics import euler_of, rotation_euler
from softsim_core.physics.mesh import write_tets
from softsim_core.scene.arm import RigidRobot, read_urdf
from softsim_core.scene.io import scalar
from softsim_ros.cli import CommandError, UsageError
from softsim_ros.cli.robots.mesh import add_options, options, say
from softsim_ros.cli.robots.mesh_speed import DENSITY, POISSON, PRESET, STIFFNESS_FACTOR

_DT = 0.01


def scene_text(
    name: str,
    made: MeshedPart,
    guess: Guess,
    preset: str,
    factor: float,
    doubts: Sequence[str] = (),
) -> str:
    """Return the scene in YAML.

    Args:
        name: Name of the robot, and of its files.
        made: Its mesh.
        guess: Assumptions about it.
        preset: Name of an elastomer.
        factor: Factor of its stiffness.
        doubts: Arguments against the guess of a cable.
    """
    order, tilt = made.mesh.order, guess.tilt_deg
    order_line = "\n    order: 2  # quadratic elements" if order == 2 else ""
    at = (
        "its lowest face"
        if guess.axis == 2
        else f"the low end of its longest side, along {'xyz'[guess.axis]}"
    ) + (f" (of its own axes: it lies askew by {tilt:.0f} degrees in its file)" if tilt else "")
    hollow = made.source.cavities == 1
    joint = _CHAMBER if hollow else "".join(f"  # {each}\n" for each in doubts) + _cable(guess)
    step, unit = (1000.0, "Pa") if hollow else (0.01 * guess.length, "m")
    pulled = 8000.0 if hollow else 0.06 * guess.length
    moves = ("pump", "let air out") if hollow else ("pull the cable", "let the cable go")
    nodes = made.report.nodes
    file, mass = on_one_line(Path(made.source.surface.name).name), 1e3 * DENSITY * made.report.volume
    return f"""\
# {name}: made of {file} by `softsim new`. SI units (m, kg, s, Pa), z up.
# What is a GUESS here is marked so: look at each in the page (softsim up), then correct it.
name: {name}
dt: {number(_DT)}  # time step; every dt is stable, a smaller one damps less
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
  - {{name: base, body: part, to: world, box: {_box(guess.base_box)}}}
  # the tip, whose pose is published on a topic and moved by inverse control
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


_CHAMBER = """\
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
    """Return a YAML list of such numbers."""
    return "[" + ", ".join(number(each) for each in values) + "]"


def number(value: float) -> str:
    """Return a number that YAML reads as one: with a point and without an exponent, to a nanometre."""
    text = f"{value:.9f}".rstrip("0")
    return "0.0" if float(text) == 0.0 else text + "0" * text.endswith(".")


def test_text(name: str, made: MeshedPart, guess: Guess) -> str:
    """Return a pytest test of that scene."""
    pulled = 8000.0 if made.source.cavities == 1 else 0.06 * guess.length
    return f'''\
"""{name} comes to rest under its own weight, stays where it is held, and moves when it is commanded."""

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


_ALONG_Z = ((0.0, -90.0, 0.0), (90.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Rotations in [deg] that turn x, y and z to z."""
_FELT = """
sensors:  # what the arm feels there: weight, and every acceleration
  - {{name: flange, kind: force_torque, on: {joint}}}
"""


def arm_text(name: str, urdf: Path, rigid: RigidRobot, link: str, guess: Guess) -> str:
    """Return the scene in YAML, which lies beside that of the robot.

    Args:
        name: Name of the robot.
        urdf: The arm's file.
        rigid: The arm described in it.
        link: Link that carries the robot.
        guess: Assumptions about it, such as the end that is fixed.
    """
    turned = _ALONG_Z[guess.axis]
    if guess.tilt_deg:
        upright = rotation_euler(np.radians(turned)) @ guess.axes.T
        x, y, z = np.degrees(euler_of(upright)).tolist()
        turned = (x, y, z)
    base_center = rotation_euler(np.radians(turned)) @ np.array(guess.base_box.center)
    moving = [joint.name for joint in rigid.joints if joint.kind != "fixed"]
    file, listed = on_one_line(urdf.name), on_one_line(", ".join(moving))
    carrier = _carrier(rigid, link)
    pairs = (("left", "right"), ("up", "down"))
    keys = "\n".join(
        f"  {key}: {{joints: [{scalar(joint)}], by: {sign}0.05, help: {scalar(f'move {joint}')}}}"
        for joint, both in zip(moving, pairs, strict=False)
        for key, sign in zip(both, ("", "-"), strict=True)
    )
    return f"""\
# {name}_on_arm: {name} on the arm of {file}. Commands are the arm's joints, then those of {name}.
name: {name}_on_arm
arm:
  urdf: {scalar(os.path.relpath(urdf.resolve(), Path(name).resolve()))}
  start: {{}}  # positions of its joints at the start in rad or m; others at 0: {listed}
  tools:
    # GUESS: held end at the origin of the last link, along its +z
    - robot: {name}.yaml
      on: {scalar(link)}
      pose: {{rotation_deg: {number_list(turned)}, translation: {number_list(tuple(0.0 - base_center))}}}
{_FELT.format(joint=scalar(carrier)) if carrier else ""}
keys:  # those of {name} are there, too
{keys or "  {}"}
"""


def _carrier(rigid: RigidRobot, link: str) -> str | None:
    """Return the last moving joint before a link."""
    carried_by = {joint.child: joint for joint in rigid.joints}
    while (joint := carried_by.get(link)) is not None and joint.kind == "fixed":
        link = joint.parent
    return None if joint is None else joint.name


_NAME = re.compile(r"[a-z][a-z0-9_]*")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("name", help="of the robot and of its folder: small letters, digits, _")
    parser.add_argument(
        "--from", dest="part", type=Path, required=True, metavar="PART", help="STL, OBJ, PLY, OFF"
    )
    parser.add_argument(
        "--material",
        default=PRESET,
        metavar="ELASTOMER",
        help=f"one that `softsim material` lists ({PRESET})",
    )
    parser.add_argument(
        "--arm",
        type=Path,
        metavar="URDF",
        help="a rigid arm (URDF, xacro) that shall carry it: another scene is written",
    )
    parser.add_argument("--link", metavar="LINK", help="of the arm, which carries it (its last one)")
    add_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Mesh the part, guess the rest, write the files and print what to try."""
    name: str = arguments.name
    folder = Path(name)
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is no name: small letters, digits and _, a letter first")
    if folder.exists():
        raise ConfigError(folder, "", "is there already; choose another name, or move it away")
    if arguments.link is not None and arguments.arm is None:
        raise UsageError("--link names a link of an arm; name the arm's file, too: --arm URDF")
    try:
        preset = elastomer(arguments.material).name
        rigid = None if arguments.arm is None else read_urdf(arguments.arm)
        link = "" if rigid is None else arguments.link or rigid.last_link
        if rigid is not None and link not in rigid.shapes:
            raise SceneError(f"{link!r} is no link of {rigid.name}; known: {listing(rigid.shapes)}")
    except SceneError as error:
        raise CommandError(str(error)) from error
    made = mesh_part(arguments.part, options(arguments), say)
    assumed = guess(made.mesh)
    on_arm = "" if rigid is None else arm_text(name, arguments.arm, rigid, link, assumed)
    inlets = inlet_notes(made.source) if made.source.cavities != 1 else []
    factor = STIFFNESS_FACTOR if preset == PRESET else 1.0
    scene = scene_text(name, made, assumed, preset, factor, inlets)
    try:
        folder.mkdir(parents=True)
        write_tets(folder / f"{name}.vtk", made.mesh)
        write_file(folder / f"{name}.yaml", scene)
        write_file(folder / f"test_{name}.py", test_text(name, made, assumed))
        if on_arm:
            write_file(folder / f"{name}_on_arm.yaml", on_arm)
    except OSError as error:
        raise ConfigError(folder, "", f"cannot be written: {error.strerror or error}") from error
    print("\n".join(_describe_result(name, made, assumed, link, inlets)))
    return 0


def inlet_notes(source: RepairedSurface) -> list[str]:
    """Return a message for each hollow that an inlet opens to the outside; it is no air chamber."""
    return [
        f"a hollow of about {1e6 * each.volume:.2g} cm^3 is open to the outside, about "
        f"{source.unit.length(each.width)} wide at {source.unit.place(each.place)}: an air chamber needs a "
        "closed hollow. To drive it by air, make the robot again with --plug, or close the opening in CAD "
        "with a plug (the hose is not modelled)"
        for each in open_hollows(source.surface)
    ]


def _describe_result(name: str, made: MeshedPart, assumed: Guess, link: str, inlets: list[str]) -> list[str]:
    scene = f"./{name}/{name}.yaml"
    moved = "the pressure of its hollow" if made.source.cavities == 1 else "one cable"
    askew = f"it lies askew by {assumed.tilt_deg:.0f} degrees in its file; guesses are along its own axes"
    hangs = [f"  softsim up ./{name}/{name}_on_arm.yaml --watch  # it hangs on the arm's link {link}"]
    return [
        f"{name}/: {name}.yaml (scene), {name}.vtk ({made.report.nodes} nodes), test_{name}.py",
        *(f"  {remark}" for remark in made.remarks),
        *([f"  {askew}"] if assumed.tilt_deg else []),
        *(f"  {each}" for each in inlets),
        f"guessed: silicone, held at one end, {moved}; each guess is marked in the scene",
        "next:",
        f"  softsim up {scene} --watch  # see it, press + and -, correct the guesses in the tab Edit",
        *(hangs if link else []),
        f"  {sys.executable} -m pytest {name}  # its test",
        "  softsim material  # other elastomers",
    ]
