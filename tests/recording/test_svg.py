"""Charts as SVG: what names stand in them."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("rosbags")

from matplotlib.figure import Figure

from softsim_ros import save_figure
from softsim_ros.recording import Chart, Curve, draw

NAMES = [r"$\frac{$", "$x$", r"\$", "<&>", "$"]
"""Names of joints or topics, of which some are faulty formulas."""


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_no_formula(name: str) -> None:
    times = np.linspace(0.0, 1.0, 5)
    chart = Chart(name, name, (Curve(name, times, times),))
    ElementTree.fromstring(draw(chart, 1.0))


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_with_such_a_name_is_drawn(tmp_path: Path, name: str) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0.0, 1.0], label=name)
    axes.set(xlabel=name, title=name)
    axes.legend()
    figure.suptitle(name)
    save_figure(figure, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
