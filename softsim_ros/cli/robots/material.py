"""`softsim material NAME`: show how an elastomer responds to tension, and the laws that fit it."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, SceneError
from softsim_core.physics.fem.materials import (
    DEFAULT_FIT,
    FITTED_LAWS,
    Elastomer,
    RestStiffness,
    elastomer,
    elastomer_names,
    material,
    rest_stiffness,
    stiffness_warning,
    tension,
)
from softsim_core.scene import MaterialDescription
from softsim_ros import save_figure
from softsim_ros.cli import CommandError, UsageError, add_number, add_out, require_matplotlib, table_lines

WIDTH, HEIGHT = 60, 16
"""Columns and lines of the chart."""


class Curve(NamedTuple):
    """A law's stress-stretch curve in tension and measured points.

    Attributes:
        title: Title of the chart.
        stretches: In [-], rising, shape (k,).
        stresses: Nominal, in [Pa], shape (k,).
        points: Measured stretch in [-] and stress in [Pa], shape (j, 2).
    """

    title: str
    stretches: Array
    stresses: Array
    points: Array


def terminal_chart(curve: Curve) -> list[str]:
    """Return the lines of the chart: the law in dots, points as o."""
    highest = float(max(curve.stresses.max(), curve.points[:, 1].max(initial=0.0)))
    first, last = float(curve.stretches[0]), float(curve.stretches[-1])
    cells = [[" "] * WIDTH for _ in range(HEIGHT)]

    def put(stretch: float, stress: float, mark: str) -> None:
        column = round((stretch - first) / (last - first) * (WIDTH - 1))
        row = round((1.0 - stress / highest) * (HEIGHT - 1))
        cells[min(max(row, 0), HEIGHT - 1)][min(max(column, 0), WIDTH - 1)] = mark

    for stretch in np.linspace(first, last, WIDTH).tolist():
        put(stretch, float(np.interp(stretch, curve.stretches, curve.stresses)), ".")
    for stretch, stress in curve.points.tolist():
        put(stretch, stress, "o")
    top, foot = f"{1e-3 * highest:.4g}", f"{first:g}"
    margin = len(top)
    labels = [top, *[""] * (HEIGHT - 2), "0"]
    lines = [f"{label:>{margin}} |{''.join(row)}".rstrip() for label, row in zip(labels, cells, strict=True)]
    axis = " " * (margin + 2) + foot + f"{last:g}".rjust(WIDTH - len(foot))
    return [
        f"nominal stress in kPa over stretch: . {curve.title}, o measured",
        *lines,
        " " * margin + " +" + "-" * WIDTH,
        axis,
    ]


def draw(curve: Curve, file: Path) -> None:
    """Write a picture; raises ConfigError as `save_figure`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(curve.stretches, 1e-3 * curve.stresses, label=curve.title)
    axes.plot(curve.points[:, 0], 1e-3 * curve.points[:, 1], "o", label="measured, times the factor")
    axes.set(xlabel="stretch [-]", ylabel="nominal stress [kPa]")
    axes.grid(alpha=0.3)
    axes.legend()
    save_figure(figure, file)


COMMON_DENSITY = 1070.0
"""Density in [kg/m^3], that of Dragon Skin 10, if the table has none."""
DAMPING = 0.05
"""Damping ratio of oscillating silicone; a time step should not add more than that."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("name", nargs="*", help="an elastomer, such as Dragon Skin 20; none lists all")
    parser.add_argument("--law", choices=FITTED_LAWS, default=DEFAULT_FIT, help=f"({DEFAULT_FIT})")
    add_number(parser, "--factor", 1.0, "K", "stiffness factor of your own test (1)")
    add_number(parser, "--poisson-ratio", float, "NU", "(0.499)")
    add_number(parser, "--density", float, "RHO", "in kg/m^3 (that of the table)")
    add_number(parser, "--size", 0.1, "M", "length in m of the bar of the advice (0.1)")
    add_out(parser, "PNG", "draw a picture into this file")
    parser.add_argument("--json", action="store_true", help="print the numbers and the curves as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the list, or one elastomer with its curve."""
    if arguments.out is not None:
        require_matplotlib("--out needs")
    for name in ("density", "size"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"--{name} must be a number > 0, not {value:g}")
    if not arguments.name:
        print("\n".join(_list()))
        return 0
    try:
        chosen = elastomer(" ".join(arguments.name))
        own = {} if arguments.poisson_ratio is None else {"poisson_ratio": arguments.poisson_ratio}
        made_of = MaterialDescription(
            preset=chosen.name, law=arguments.law, stiffness_factor=arguments.factor, **own
        )
    except SceneError as error:
        raise CommandError(str(error)) from error
    curve = _curve(chosen, made_of)
    stiffness = rest_stiffness(material(arguments.law), _values(made_of))
    density = arguments.density or chosen.density
    if arguments.json:
        print(json.dumps(_plain(made_of, stiffness, density, curve)))
    else:
        print("\n".join([*_report_lines(chosen, made_of, stiffness, density, arguments.size), ""]))
        print("\n".join(terminal_chart(curve)))
    if made_of.warning:
        print(f"softsim material: {stiffness_warning(chosen.name)}", file=sys.stderr)
    if arguments.out is not None:
        draw(curve, arguments.out)
        print(f"picture: {arguments.out}", file=sys.stderr)
    return 0


def _values(made_of: MaterialDescription) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array(list(made_of.values.values()))


def _curve(chosen: Elastomer, made_of: MaterialDescription) -> Curve:
    """Return stress over stretch to the end of the fit, with the points in that range, scaled as the law."""
    law = made_of.law or DEFAULT_FIT
    end = chosen.fit(law).to_stretch
    stretches = np.linspace(1.0, end, 61)
    points = chosen.points[chosen.points[:, 0] <= end] * (1.0, made_of.values["stiffness_factor"])
    title = f"{chosen.name}, {law}, stiffness factor {made_of.values['stiffness_factor']:g}"
    return Curve(title, stretches, tension(material(law), _values(made_of), stretches)[1], points)


def _list() -> list[str]:
    rows = [("", "E at rest", "fits to stretch", "tears at", "density")]
    for name in elastomer_names():
        one, made_of = elastomer(name), MaterialDescription(preset=name)
        young = rest_stiffness(material(DEFAULT_FIT), _values(made_of)).young
        ends = " / ".join(f"{one.fit(law).to_stretch:g}" for law in FITTED_LAWS)
        density = "not known" if one.density is None else f"{one.density:g} kg/m^3"
        rows.append((name, f"{1e-3 * young:.3g} kPa", ends, f"{one.break_stretch:.3g}", density))
    return [
        *table_lines(rows),
        f"fits: {' / '.join(FITTED_LAWS)}; source: {elastomer(elastomer_names()[0]).source}",
        "The table's stiffness is too low: set stiffness_factor from a test of your own.",
    ]


def _report_lines(
    chosen: Elastomer,
    made_of: MaterialDescription,
    stiffness: RestStiffness,
    density: float | None,
    size: float,
) -> list[str]:
    fit = chosen.fit(made_of.law or DEFAULT_FIT)
    mass = density or COMMON_DENSITY
    density_text = f"{mass:g} kg/m^3" + ("" if density else " (assumed, the table has none: weigh a casting)")
    waves = (
        f"{stiffness.bar_speed(mass):.3g} m/s along a bar, {stiffness.shear_speed(mass):.3g} m/s in shear, "
        f"{stiffness.pressure_speed(mass):.3g} m/s of pressure"
    )
    periods = _periods(stiffness, mass, size)
    constants = ", ".join(f"{name} {value:g}" for name, value in made_of.values.items())
    fits = f"stretch 1.02 to {fit.to_stretch:g}, tension only"
    every_dt = "every dt is stable; implicit Euler adds pi dt / T to the damping ratio of a period T."
    bending, stretching = (_ms(DAMPING * period / math.pi) for period in periods)
    rows = [
        ("source", chosen.source),
        (f"law {made_of.law}", constants),
        ("fits", f"{fits}; the bar tore at {chosen.break_stretch:g}"),
        ("at rest", f"E {1e-3 * stiffness.young:.4g} kPa, Poisson ratio {stiffness.poisson:.4g},"),
        ("", f"shear {1e-3 * stiffness.shear:.4g} kPa, bulk {1e-6 * stiffness.bulk:.4g} MPa"),
        ("density", density_text),
        ("waves", waves),
        ("time step", every_dt),
        ("", f"A bar of {size:g} m, a third as thick, bends with T = {_ms(periods[0])} and stretches with"),
        ("", f"T = {_ms(periods[1])}: up to dt = {bending} and {stretching} it adds less than {DAMPING:g}"),
    ]
    return [chosen.name, *(f"  {name:<10} {value}" for name, value in rows)]


def _periods(stiffness: RestStiffness, density: float, size: float) -> tuple[float, float]:
    """Return the periods in [s] of bending and stretching of a square bar clamped at one end.

    The bar is a third as thick as it is long.
    """
    speed = stiffness.bar_speed(density)
    bending = 1.8751**2 / (2.0 * math.pi) * (size / 3.0) / math.sqrt(12.0) * speed / size**2
    return 1.0 / bending, 4.0 * size / speed


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def _plain(
    made_of: MaterialDescription, stiffness: RestStiffness, density: float | None, curve: Curve
) -> dict[str, object]:
    mass = density or COMMON_DENSITY
    return {
        "material": made_of.plain(),
        "values": made_of.values,
        "young_modulus_pa": stiffness.young,
        "poisson_ratio": stiffness.poisson,
        "shear_modulus_pa": stiffness.shear,
        "bulk_modulus_pa": stiffness.bulk,
        "density_kg_m3": density,
        "bar_speed_m_s": stiffness.bar_speed(mass),
        "stretches": curve.stretches.tolist(),
        "stresses_pa": curve.stresses.tolist(),
        "points": curve.points.tolist(),
    }
