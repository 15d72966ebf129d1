"""`softsim mjcf import|compare|export`: MuJoCo models as scenes, in both engines, and scenes as models."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from softsim_core.base import MjcfError, write_file
from softsim_ros.cli import add_number, add_words

if TYPE_CHECKING:
    from softsim_ros.cli.robots.mjcf_comparison import ModelComparison

SECONDS, ROUNDS = 3.0, 20
MUJOCO_LAW = "saint_venant_kirchhoff"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    words = parser.add_subparsers(dest="what", required=True, metavar="import|compare|export")
    reading = words.add_parser("import", help="make a scene of a MuJoCo model", allow_abbrev=False)
    reading.add_argument("model", type=Path, help="a MuJoCo model (MJCF, .xml)")
    reading.add_argument(
        "-o", "--out", "--to", type=Path, metavar="FOLDER", help="where to (a folder of the model's name)"
    )
    reading.add_argument(
        "--law",
        metavar="LAW",
        help=f"of soft bodies (corotational, which is compiled; {MUJOCO_LAW} is MuJoCo's, and slower here)",
    )
    both = words.add_parser("compare", help="run a MuJoCo model in MuJoCo and here", allow_abbrev=False)
    both.add_argument("model", type=Path, help="a MuJoCo model (MJCF, .xml)")
    laws = f"of soft bodies; may be said twice (corotational, {MUJOCO_LAW})"
    add_words(both, "--law", "LAW", laws)
    add_number(both, "--seconds", SECONDS, "S", f"simulated time ({SECONDS:g})")
    add_number(both, "--rounds", ROUNDS, "N", f"turns of each engine ({ROUNDS})")
    both.add_argument("--json", action="store_true", help="print the report as JSON, in SI units")
    writing = words.add_parser("export", help="make a MuJoCo model of a scene", allow_abbrev=False)
    writing.add_argument("scene", help="name or file of a robot or scene")
    writing.add_argument(
        "-o", "--out", "--to", type=Path, metavar="FILE", help="where to (NAME.xml in this folder)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Import, compare or export."""
    if arguments.what == "import":
        return _import(arguments)
    if arguments.what == "export":
        return _export(arguments)
    if not 0.0 < arguments.seconds < math.inf or arguments.rounds < 1:
        print("softsim mjcf compare: --seconds must be > 0 s and --rounds at least 1", file=sys.stderr)
        return 2
    return _compare(arguments)


def _import(arguments: argparse.Namespace) -> int:
    from softsim_core.mjcf import import_mjcf, write_imported

    imported = import_mjcf(arguments.model, arguments.law)
    folder = arguments.out or Path(arguments.model.stem)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise MjcfError(folder, "is there already and not empty; choose another folder with --out")
    file = write_imported(imported, folder, arguments.model.name)
    scene = imported.scene
    counts = (
        f"{len(scene.bodies)} soft bodies, {len(scene.rigid_bodies)} rigid, {len(scene.joints)} joints, "
        f"{len(scene.collisions)} surfaces that touch"
    )
    print(f"{file}: {counts}")
    print("\n".join(f"  {remark}" for remark in imported.remarks))
    print(f"next: softsim up ./{file}")
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from softsim_core.mjcf import export_mjcf
    from softsim_core.scene import load_scene

    scene = load_scene(arguments.scene).scene
    made = export_mjcf(scene)
    file = arguments.out or Path(f"{scene.name}.xml")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, made.text)
    except OSError as error:
        raise MjcfError(file, f"cannot be written: {error.strerror or error}") from error
    print(f"{file}: MuJoCo model of {scene.name}")
    print("\n".join(f"  {remark}" for remark in made.remarks))
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from softsim_core.base import describe_machine
    from softsim_ros.cli.robots.mjcf_comparison import LAWS, compare_model

    laws = tuple(dict.fromkeys(arguments.law or LAWS))
    found = compare_model(arguments.model, laws, arguments.seconds, arguments.rounds)
    if arguments.json:
        print(json.dumps({**dataclasses.asdict(found), "file": str(found.file)}))
    else:
        print("\n".join([*describe_machine(), *report(found)]))
    return 0


def report(found: ModelComparison) -> list[str]:
    """Return the comparison as lines of text."""
    theirs, *ours = found.rows
    lines = [
        f"{found.file}: {found.nodes} nodes, {found.elements} tetrahedra, dt {1e3 * found.dt:g} ms, "
        f"{found.seconds:g} s from the start; MuJoCo {found.version}",
        "",
        f"  {'engine':<32} {'min ms':>8} {'median':>8}  sag of the lowest point, mm",
    ]
    for row in found.rows:
        sags = ", ".join(
            f"{name} {1e3 * sag:.3f}{_off(sag, theirs.sags[name])}" for name, sag in row.sags.items()
        )
        lines.append(f"  {row.name:<32} {row.min_ms:8.3f} {row.median_ms:8.3f}  {sags or '-'}")
    lines += ["", f"  {'distance from MuJoCo, mm (largest, rms)':<32}"]
    for row in ours:
        lines.append(f"  {row.name}:")
        for each in row.moments:
            lines.append(f"    {each.time:8.3f} s  {1e3 * each.largest:10.4f} {1e3 * each.mean:10.4f}")
    fastest = max(row.speed for row in found.rows)
    rests = "everything rests" if fastest < 1e-4 else f"something still moves, at {1e3 * fastest:.3g} mm/s"
    lines += ["", f"  at the end {rests}; {theirs.samples} steps of each were timed, in turns"]
    lines += [f"  {row.name}: {row.method}" for row in found.rows]
    if found.warnings:
        lines.append(f"  MuJoCo gave {found.warnings} warnings, such as a solve that has not converged")
    return [
        *lines,
        "",
        "  not taken over, or otherwise than there:",
        *(f"    {remark}" for remark in found.remarks),
    ]


def _off(sag: float, theirs: float) -> str:
    if sag == theirs or abs(theirs) < 1e-6:
        return ""
    return f" ({100.0 * (sag / theirs - 1.0):+.2f} %)"
