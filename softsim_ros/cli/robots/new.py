"""`softsim new NAME --from PART`: a folder with a robot of that part, which runs at once."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from softsim_core.errors import ConfigError, SceneError
from softsim_core.fem.materials.elastomers import elastomer
from softsim_core.file_writing import write_file
from softsim_core.mesh.writers import write_tets
from softsim_core.meshing import MeshedPart, mesh_part
from softsim_core.meshing.guesses import Guess, guess
from softsim_core.meshing.openings import open_hollows
from softsim_core.meshing.repair import Repaired
from softsim_core.scene.arm.urdf_file import read_urdf
from softsim_ros.cli.robots.mesh import add_options, options, say
from softsim_ros.cli.robots.mesh_speed import PRESET, STIFFNESS_FACTOR
from softsim_ros.cli.robots.new_on_arm import arm_text, chosen_link
from softsim_ros.cli.robots.new_scene import scene_text, test_text

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
    """Mesh the part, guess the rest, write the files and say what to try."""
    name: str = arguments.name
    folder = Path(name)
    if not _NAME.fullmatch(name):
        print(
            f"softsim new: {name!r} is no name: small letters, digits and _, a letter first", file=sys.stderr
        )
        return 2
    if folder.exists():
        raise ConfigError(folder, "", "is there already; choose another name, or move it away")
    if arguments.link is not None and arguments.arm is None:
        print(
            "softsim new: --link names a link of an arm; name the arm's file, too: --arm URDF",
            file=sys.stderr,
        )
        return 2
    try:
        preset = elastomer(arguments.material).name
        rigid = None if arguments.arm is None else read_urdf(arguments.arm)
        link = "" if rigid is None else chosen_link(rigid, arguments.link)
    except SceneError as error:
        print(f"softsim new: {error}", file=sys.stderr)
        return 1
    made = mesh_part(arguments.part, options(arguments), say)
    assumed = guess(made.mesh)
    on_arm = "" if rigid is None else arm_text(name, arguments.arm, rigid, link, assumed)
    inlets = inlet_notes(made.source) if made.source.cavities != 1 else []
    factor = STIFFNESS_FACTOR if preset == PRESET else 1.0
    scene = scene_text(name, made, assumed, preset, factor, inlets)
    _write(folder, name, scene, made, assumed, on_arm)
    print("\n".join(_told(name, made, assumed, link, inlets)))
    return 0


def inlet_notes(source: Repaired) -> list[str]:
    """Return a message for each hollow that an inlet opens to the outside, which is no air chamber then."""
    return [
        f"a hollow of about {1e6 * each.volume:.2g} cm^3 is open to the outside, about "
        f"{source.unit.length(each.width)} wide at {source.unit.place(each.place)}: an air chamber needs a "
        "closed hollow. To drive it by air, make the robot anew with --plug, or close the opening in CAD "
        "with a plug (the hose is not modelled)"
        for each in open_hollows(source.surface)
    ]


def _write(folder: Path, name: str, scene: str, made: MeshedPart, assumed: Guess, on_arm: str) -> None:
    try:
        folder.mkdir(parents=True)
        write_tets(folder / f"{name}.vtk", made.mesh)
        write_file(folder / f"{name}.yaml", scene)
        write_file(folder / f"test_{name}.py", test_text(name, made, assumed))
        if on_arm:
            write_file(folder / f"{name}_on_arm.yaml", on_arm)
    except OSError as error:
        raise ConfigError(folder, "", f"cannot be written: {error.strerror or error}") from error


def _told(name: str, made: MeshedPart, assumed: Guess, link: str, inlets: list[str]) -> list[str]:
    scene = f"./{name}/{name}.yaml"
    moved = "the pressure of its hollow" if made.source.cavities == 1 else "one cable"
    askew = f"it lies askew by {assumed.tilt_deg:.0f} degrees in its file; guesses are along its own axes"
    hangs = [f"  softsim up ./{name}/{name}_on_arm.yaml --watch  # it hangs on the arm's link {link}"]
    return [
        f"{name}/: {name}.yaml (scene), {name}.vtk ({made.report.nodes} nodes), test_{name}.py",
        *(f"  {told}" for told in made.told),
        *([f"  {askew}"] if assumed.tilt_deg else []),
        *(f"  {each}" for each in inlets),
        f"guessed: silicone, held at one end, {moved}; each guess is marked in the scene",
        "next:",
        f"  softsim up {scene} --watch  # see it, press + and -, correct the guesses in the tab Edit",
        *(hangs if link else []),
        f"  {sys.executable} -m pytest {name}  # its test",
        "  softsim material  # other elastomers",
    ]
