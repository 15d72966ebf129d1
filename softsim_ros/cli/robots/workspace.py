"""`softsim workspace ROBOT`: how far its effector reaches, how well it moves there, and a picture of it."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from softsim_ros import save_figure
from softsim_ros.cli import ProgressLine, UsageError, add_number, add_out, require_matplotlib

if TYPE_CHECKING:
    from softsim_core.control.inverse import Workspace


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "robot", nargs="?", default="tripod", help="robot or scene: a name or a file (tripod)"
    )
    add_number(parser, "--samples", 200, "N", "equilibria to look at (200, about 0.1 s each)")
    add_number(parser, "--base-shift", float, "M", "shift of the joint bases in m (that of the start move)")
    add_out(parser, "PNG", "draw a picture into this file")
    parser.add_argument("--json", action="store_true", help="print every sample as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Sample, print the summary, draw."""
    if arguments.out is not None:
        require_matplotlib("--out needs")
    if arguments.base_shift is not None and not math.isfinite(arguments.base_shift):
        raise UsageError("--base-shift must be a finite number of metres")
    if arguments.samples < 4:
        raise UsageError("--samples must be 4 or more")
    from softsim_core.control.inverse import sample_workspace
    from softsim_core.scene import load_scene

    scene = load_scene(arguments.robot)
    line = ProgressLine(sys.stderr)

    workspace = sample_workspace(
        scene,
        arguments.samples,
        arguments.base_shift,
        lambda done, total: line.show(f"equilibria {done}/{total}", at_once=done == total),
    )
    line.end()
    if arguments.json:
        samples = {
            "joints": workspace.joints,
            "positions_m": workspace.positions,
            "quaternions_xyzw": workspace.quaternions,
            "conditions": workspace.conditions,
            "failed_joints": workspace.failed,
        }
        lists = {name: each.tolist() for name, each in samples.items()}
        print(json.dumps({"robot": scene.name, **workspace.summary(), **lists}))
    else:
        print("\n".join(_report_lines(scene.name, workspace)))
    if arguments.out is not None:
        draw(workspace, scene.name, arguments.out)
        print(f"picture: {arguments.out}", file=sys.stderr)
    return 0


def _report_lines(robot: str, workspace: Workspace) -> list[str]:
    low, high = 1e3 * workspace.extents
    tilt_low, tilt_high = (math.degrees(1.0) * each for each in workspace.tilt_range)
    conditions = sorted(workspace.conditions.tolist())
    best, median, worst = conditions[0], conditions[len(conditions) // 2], conditions[-1]
    count = len(workspace.joints)
    rows = [("reachable volume (convex hull)", f"{1e6 * workspace.volume:.2f} cm^3")]
    rows += [(f"{axis} of the effector", f"{low[k]:.1f} to {high[k]:.1f} mm") for k, axis in enumerate("xyz")]
    rows += [
        (f"tilt about {axis}", f"{tilt_low[k]:.1f} to {tilt_high[k]:.1f} deg") for k, axis in enumerate("xy")
    ]
    text = f"{best:.2f} at best, {median:.2f} median, {worst:.3g} at worst"
    rows.append(("conditioning of the Jacobian", text))
    if len(workspace.failed):
        rows.append(("no equilibrium was found at", f"{len(workspace.failed)} joint positions"))
    title = f"{robot}: {count} equilibria, joint bases shifted by {1e3 * workspace.base_shift:g} mm"
    return [title, *(f"  {name:<31} {value}" for name, value in rows)]


def draw(workspace: Workspace, robot: str, file: Path) -> None:
    """Write a picture, colour is the conditioning of the position Jacobian; raises as `save_figure`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    axes = figure.subplots(2, 2)
    points, tilts = 1e3 * workspace.positions, math.degrees(1.0) * workspace.tilts
    panels = (
        ("from above", points[:, 0], points[:, 1], "x [mm]", "y [mm]"),
        ("from the front", points[:, 0], points[:, 2], "x [mm]", "z [mm]"),
        ("from the side", points[:, 1], points[:, 2], "y [mm]", "z [mm]"),
        ("tilts", tilts[:, 0], tilts[:, 1], "about x [deg]", "about y [deg]"),
    )
    dots = None
    for axis, (title, horizontal, vertical, name, other) in zip(axes.flat, panels, strict=True):
        dots = axis.scatter(horizontal, vertical, c=workspace.conditions, s=12, vmin=1.0, vmax=4.0)
        axis.set(title=title, xlabel=name, ylabel=other, aspect="equal")
        axis.grid(alpha=0.3)
    assert dots is not None
    figure.colorbar(
        dots, ax=axes, label="conditioning of the Jacobian (1: equal in every direction)", extend="max"
    )
    figure.suptitle(
        f"{robot}: {len(points)} equilibria, bases shifted by {1e3 * workspace.base_shift:g} mm, "
        f"hull {1e6 * workspace.volume:.1f} cm³"
    )
    save_figure(figure, file)
