"""The picture of `softsim workspace`: reachable positions from above and from the sides, and tilts."""

from __future__ import annotations

import math
from pathlib import Path

from softsim_core.base import ConfigError
from softsim_core.control.inverse import Workspace
from softsim_ros import save_figure


def draw(workspace: Workspace, robot: str, file: Path) -> None:
    """Write a picture; colour is the conditioning of the position Jacobian.

    Raises:
        ConfigError: the file cannot be written, or its suffix names no picture format.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
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
    try:
        save_figure(figure, file)
    except (OSError, ValueError) as error:
        raise ConfigError(file, "", f"no picture was written: {error}; name a .png file") from error
