"""`softsim mesh PART.stl`: fill a part that a CAD program exported with tetrahedra, and assess them."""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import MeshError
from softsim_core.lab.meshing import UNITS, MeshedPart, MeshingOptions, mesh_part
from softsim_core.physics.mesh import boundary_surface, dihedral_angles_deg, write_tets
from softsim_ros import save_figure
from softsim_ros.cli import UsageError, add_number, require_matplotlib

WRITTEN = (".vtk", ".msh")
_LENGTHS = ("size", "holes", "deviation")
STEPS_MS = (2, 5, 10, 20, 50, 100)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("part", type=Path, help="closed surface: .stl, .obj, .ply, .off")
    add_options(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        action="append",
        metavar="FILE",
        help=f"where to write, {' or '.join(WRITTEN)}; may be said twice (PART.vtk in this folder)",
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the mesh and its angles")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--no-speed", action="store_true", help="do not measure the time of a step")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments about how a part is meshed."""
    parser.add_argument(
        "--unit", choices=tuple(UNITS), default="mm", help="unit of the file, and of lengths (mm)"
    )
    size = parser.add_mutually_exclusive_group()
    add_number(size, "--size", float, "L", "requested length of edges")
    add_number(size, "--nodes", int, "N", "requested number of nodes (1000)")
    parser.add_argument("--order", type=int, choices=(1, 2), default=1, help="2: quadratic elements (1)")
    add_number(parser, "--holes", float, "L", "close holes up to this size (longest side / 20)")
    parser.add_argument("--largest", action="store_true", help="keep the largest of several bodies")
    parser.add_argument("--plug", action="store_true", help="close the openings of hollows with plugs")
    add_number(parser, "--deviation", float, "L", "the mesh may be off by so much (diagonal / 1000)")
    add_number(parser, "--time-limit", 300.0, "S", "of one run of the mesher (300)")


def options(arguments: argparse.Namespace) -> MeshingOptions:
    """Return the meshing options that the arguments ask for.

    Raises:
        MeshError: a length or a time is no number > 0.
    """
    for name in (*_LENGTHS, "time_limit"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < math.inf:
            raise MeshError(arguments.part, f"--{name.replace('_', '-')} must be a number > 0, not {value:g}")
    lengths = {name: getattr(arguments, name) for name in _LENGTHS}
    metres = {name: value and value * UNITS[arguments.unit] for name, value in lengths.items()}  # or None
    return MeshingOptions(
        unit=arguments.unit,
        size=metres["size"],
        nodes=arguments.nodes,
        order=arguments.order,
        hole=metres["holes"],
        largest=arguments.largest,
        plug=arguments.plug,
        deviation=metres["deviation"],
        time_limit=arguments.time_limit,
    )


def run(arguments: argparse.Namespace) -> int:
    """Mesh the part, write the files, print the report."""
    files = arguments.out or [Path(arguments.part.stem + ".vtk")]
    unknown = [str(file) for file in files if file.suffix.lower() not in WRITTEN]
    if unknown:
        raise UsageError(f"--out {unknown[0]} must end in {' or '.join(WRITTEN)}")
    if arguments.picture is not None:
        require_matplotlib("--picture needs")
    made = mesh_part(arguments.part, options(arguments), say)
    for file in files:
        write_tets(file, made.mesh)
    seconds = None if arguments.no_speed else measure_step_time(made)
    if arguments.json:
        print(json.dumps(plain(made, files, seconds)))
    else:
        print("\n".join(report_lines(made, files, seconds)))
    if arguments.picture is not None:
        draw(made, arguments.picture)
        print(f"picture: {arguments.picture}", file=sys.stderr)
    return 0


def say(message: str) -> None:
    """Print a line of progress."""
    print(f"softsim: {message} ...", file=sys.stderr, flush=True)


def measure_step_time(made: MeshedPart) -> float:
    """Return the time in [s] of a step of the part."""
    from softsim_ros.cli.robots.mesh_speed import step_time

    say("measuring a step (the first one on a machine compiles for about a minute)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return step_time(made.mesh)


def report_lines(made: MeshedPart, files: list[Path], seconds: float | None) -> list[str]:
    """Return the report as lines of text."""
    report, source, unit = made.report, made.source, made.source.unit
    size = source.surface.points.max(axis=0) - source.surface.points.min(axis=0)
    error = made.volume_error
    cells = "linear" if made.mesh.order == 1 else "quadratic"
    cubic = unit.metres**3
    rows = [("surface", f"{len(source.surface.triangles)} triangles, {unit.size(size)}")]
    rows += [("", remark) for remark in made.remarks]
    shortest, longest, requested = map(unit.length, (report.min_edge, report.max_edge, made.edge))
    off = "the surface overlaps itself" if error is None else f"{100.0 * error:+.2f} % of the surface's"
    angles = f"{report.min_dihedral_deg:.1f} to {report.max_dihedral_deg:.1f} degrees (70.5 is regular)"
    mesh = f"{report.nodes} nodes, {report.elements} {cells} tetrahedra"
    shapes = f"{report.min_radius_ratio:.2f} at worst, {report.mean_radius_ratio:.2f} mean (1 is regular)"
    rows += [
        ("mesh", mesh + ", made before" * made.from_cache),
        ("edges", f"{shortest} to {longest}, requested {requested}"),
        ("angles", angles),
        ("shapes", shapes),
        ("volume", f"{report.volume / cubic:.5g} {unit.name}^3, {off}"),
        ("deviation", f"at most {unit.length(made.distance)} from the surface"),
    ]
    if seconds is not None:
        rows.append(("step", fitness(seconds)))
    rows += [("written", str(file)) for file in files]
    return [str(source.surface.name), *(f"  {name:<10} {value}" for name, value in rows)]


def fitness(seconds: float) -> str:
    """Return which time steps allow real time with a mesh, given the time in [s] of its step."""
    fit = [step for step in STEPS_MS if 1e3 * seconds < 0.8 * step]
    text = f"real time needs dt >= {fit[0]} ms" if fit else "too slow for real time: ask for fewer nodes"
    return f"{1e3 * seconds:.3g} ms on this machine, alone in silicone; any dt is stable; {text}"


def plain(made: MeshedPart, files: list[Path], seconds: float | None) -> dict[str, object]:
    """Return the report for programs, in SI units."""
    report, source = made.report, made.source
    return {
        "part": str(source.surface.name),
        "unit": source.unit.name,
        "files": [str(file) for file in files],
        "surface_triangles": len(source.surface.triangles),
        "size_m": (source.surface.points.max(axis=0) - source.surface.points.min(axis=0)).tolist(),
        "told": list(made.remarks),
        "cavities": source.cavities,
        "nodes": report.nodes,
        "elements": report.elements,
        "order": made.mesh.order,
        "edge_m": made.edge,
        "min_dihedral_deg": report.min_dihedral_deg,
        "max_dihedral_deg": report.max_dihedral_deg,
        "min_radius_ratio": report.min_radius_ratio,
        "mean_radius_ratio": report.mean_radius_ratio,
        "volume_m3": report.volume,
        "surface_volume_m3": None if source.crosses else source.volume,
        "largest_distance_m": made.distance,
        "step_s": seconds,
        "from_cache": made.from_cache,
    }


def draw(made: MeshedPart, file: Path) -> None:
    """Draw the boundary in the file's unit, and a histogram of dihedral angles."""
    from matplotlib.figure import Figure

    skin, unit = boundary_surface(made.mesh), made.source.unit
    points = skin.points / unit.metres
    figure = Figure(figsize=(11.0, 5.5))
    body: Any = figure.add_subplot(1, 2, 1, projection="3d")
    body.plot_trisurf(
        *points.T, triangles=skin.triangles, color="#f2c27a", edgecolor="#7a5a20", linewidth=0.2
    )
    body.set_box_aspect(np.maximum(np.ptp(points, axis=0), 1e-9))
    body.set(xlabel=f"x [{unit.name}]", ylabel=f"y [{unit.name}]", zlabel=f"z [{unit.name}]")
    body.set_title(f"{made.report.nodes} nodes, {made.report.elements} tetrahedra")
    angles = figure.add_subplot(1, 2, 2)
    angles.hist(dihedral_angles_deg(made.mesh.points, made.mesh.tets[:, :4]).reshape(-1), 60, color="#4a7ba6")
    angles.set(xlabel="dihedral angle [deg]", ylabel="how many", xlim=(0.0, 180.0))
    angles.set_title(f"{made.report.min_dihedral_deg:.1f} to {made.report.max_dihedral_deg:.1f} degrees")
    save_figure(figure, file)
