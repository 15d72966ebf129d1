"""The picture of `softsim material`: stress over stretch, the law and the measured points."""

from __future__ import annotations

from pathlib import Path

from softsim_core.errors import ConfigError
from softsim_ros.cli.robots.material_chart import Curve
from softsim_ros.figures import save_figure


def draw(curve: Curve, file: Path) -> None:
    """Write a picture.

    Raises:
        ConfigError: the file cannot be written, or its ending names no picture format.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot(curve.stretches, 1e-3 * curve.stresses, label=curve.title)
    axes.plot(curve.points[:, 0], 1e-3 * curve.points[:, 1], "o", label="measured, times the factor")
    axes.set(xlabel="stretch [-]", ylabel="nominal stress [kPa]")
    axes.grid(alpha=0.3)
    axes.legend()
    try:
        save_figure(figure, file)
    except (OSError, ValueError) as error:
        raise ConfigError(file, "", f"no picture was written: {error}; name a .png file") from error
