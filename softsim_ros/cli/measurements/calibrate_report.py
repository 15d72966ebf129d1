"""Output of `softsim calibrate`: lines for the user, plain data, the fitted robot, a web page."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softsim_core.base import write_file
from softsim_core.scene.io import comment, given_values
from softsim_ros import render_page

if TYPE_CHECKING:
    from softsim_core.lab.identification import Calibration, Folds, NextPoses

WIDER = 1.2
"""Factor from which on the widening of intervals is reported."""

TOGETHER = 0.9
"""Correlation from which on two parameters count as identifiable only together."""


@dataclass(frozen=True, slots=True)
class RequestedResults:
    """Requested results beside the fit; None if not requested."""

    folds: Folds | None = None
    intervals: list[tuple[float, float]] | None = None
    poses: NextPoses | None = None

    def report_lines(self, result: Calibration) -> list[str]:
        """Return them as lines for the user."""
        lines = []
        if self.folds is not None:
            lines += [
                f"left out in {self.folds.count} folds: session {name}: {1e3 * error:.3f} mm, fitted "
                f"{1e3 * self.folds.fitted[name]:.3f} mm"
                for name, error in self.folds.left_out.items()
            ]
            more = 100.0 * (self.folds.ratio - 1.0)
            lines.append(f"the error of rows left out is {more:+.1f} % beside that of fitted ones")
        for name, unit, ends in zip(result.names, result.units, self.intervals or (), strict=False):
            lines.append(f"{name}: 95 % interval by profile {interval(*ends)} {unit}".rstrip())
        if self.poses is not None:
            lines.append(f"measure next ({', '.join(self.poses.joints)}), standard errors then:")
            for command, errors in zip(self.poses.commands, self.poses.errors[1:], strict=True):
                pose = ", ".join(f"{each:.3f}" for each in command)
                then = ", ".join(f"{n} {e:.3g}" for n, e in zip(result.names, errors, strict=True))
                lines.append(f"  {pose}: {then}")
        return lines

    def plain(self, result: Calibration) -> dict[str, Any]:
        """Return them as plain data; an end of an interval beyond a bound is null."""
        values: dict[str, Any] = {}
        if self.folds is not None:
            values["folds"] = {
                name: {"fitted_mm": 1e3 * self.folds.fitted[name], "left_out_mm": 1e3 * error}
                for name, error in self.folds.left_out.items()
            }
        if self.intervals is not None:
            values["profile_intervals"] = {
                name: [each if np.isfinite(each) else None for each in ends]
                for name, ends in zip(result.names, self.intervals, strict=True)
            }
        if self.poses is not None:
            values["next_poses"] = {
                "session": self.poses.session,
                "joints": list(self.poses.joints),
                "commands": self.poses.commands.tolist(),
                "standard_errors": self.poses.errors.tolist(),
            }
        return values


def interval(low: float, high: float) -> str:
    """Return both ends of an interval as text."""
    ends = [f"{each:.4g}" if np.isfinite(each) else "beyond its bound" for each in (low, high)]
    return f"{ends[0]} to {ends[1]}"


def report_lines(result: Calibration) -> list[str]:
    """Return the result as lines for the user."""
    lines = ["interrupted: the best that was tried follows"] if result.stopped else []
    width = max(len(each) for each in result.names)
    starts = result.problem.values(result.problem.start)
    for k, name in enumerate(result.names):
        half = result.quantiles[k] * result.errors[k]
        found = f"+- {half:.3g}" if np.isfinite(half) else "+- ?"
        line = f"{name:<{width}}  {result.values[k]:>10.4g} {found:<11} {result.units[k]:<12}"
        said = verdict(result, k)
        lines.append(f"{line} began at {starts[k]:g}{said and '  '}{said}")
    lines += describe_neighbours(result) + describe_priors(result)
    if len(result.endings) > 1:
        lines.append(describe_endings(result))
    lines += [
        f"only the combination of {one} and {other} is determined: correlation {value:+.2f}"
        for one, other, value in together(result)
    ]
    lines += [
        f"session {name}: {count} rows, mean error {1e3 * result.before[name]:.3f} mm before, "
        f"{1e3 * result.after[name]:.3f} mm after"
        for name, count in result.rows.items()
    ]
    return lines


def describe_neighbours(result: Calibration) -> list[str]:
    """Return by how much intervals are wider because neighbouring rows have correlated errors.

    Return nothing if they hardly are.
    """
    if result.stopped or result.widening.max() < WIDER:
        return []
    widths = zip(result.names, result.half_widths, strict=True)
    each = ", ".join(f"{name} +- {value:.3g}" for name, value in widths)
    return [f"neighbouring rows err alike, so intervals are wider than reported above: {each}"]


def describe_priors(result: Calibration) -> list[str]:
    """Return which priors the rows contradict; these were left out."""
    return [
        f"PRIOR LEFT OUT: {each.name} was given as {each.mean:.4g} +- {each.deviation:.3g}, and the rows "
        f"tell {each.from_rows:.4g} +- {each.error:.3g} (standard deviations), which chance makes in "
        f"{100.0 * each.chance:.2g} % of all calibrations; check the prior, the units and the model"
        for each in result.conflicts
    ]


def describe_endings(result: Calibration) -> str:
    """Return whether searches from several starts ended at the same values."""
    others = result.other_endings
    alike = f"{len(result.endings) - len(others)} of {len(result.endings)} searches ended here"
    if not others:
        return alike
    best = min(others, key=lambda each: each.mean)
    where = ", ".join(f"{name} {value:.4g}" for name, value in zip(result.names, best.values, strict=True))
    return f"{alike}; the best of the others at {where}, mean error {1e3 * best.mean:.3f} mm"


def verdict(result: Calibration, k: int) -> str:
    """Return a remark about a parameter; an empty string if there is none."""
    if result.stopped:
        return ""
    if not result.found[k]:
        return "NOT FOUND: these rows do not determine it"
    return "at its bound" if result.at_bounds[k] else ""


def together(result: Calibration) -> list[tuple[str, str, float]]:
    """Return pairs of parameters that are hard to distinguish, and their correlation."""
    names = result.names
    return [
        (names[i], names[j], float(result.correlation[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(result.correlation[i, j]) > TOGETHER
    ]


def plain(result: Calibration) -> dict[str, Any]:
    """Return the result as plain data; undetermined values are null."""

    def number(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return {
        "name": result.description.name,
        "parameters": [
            {
                "name": name,
                "unit": result.units[k],
                "value": float(result.values[k]),
                "standard_error": number(result.errors[k]),
                "widening": number(result.widening[k]),
                "interval": [number(result.values[k] + side * result.half_widths[k]) for side in (-1.0, 1.0)],
                "found": bool(result.found[k]),
                "at_bound": bool(result.at_bounds[k]),
            }
            for k, name in enumerate(result.names)
        ],
        "priors_left_out": [
            {
                "name": each.name,
                "mean": each.mean,
                "standard_deviation": each.deviation,
                "rows_tell": each.from_rows,
                "rows_standard_error": number(each.error),
                "chance": each.chance,
            }
            for each in result.conflicts
        ],
        "noise_mm": 1e3 * result.problem.noise,
        "endings": [{"values": list(each.values), "mean_mm": 1e3 * each.mean} for each in result.endings],
        "correlation": [[number(each) for each in row] for row in result.correlation.tolist()],
        "sessions": {
            name: {
                "rows": count,
                "mean_before_mm": 1e3 * result.before[name],
                "mean_after_mm": 1e3 * result.after[name],
            }
            for name, count in result.rows.items()
        },
        "evaluations": result.evaluations,
        "interrupted": result.stopped,
        "overlay": result.overlay,
    }


def write_overlay(file: Path, robot: str, result: Calibration, further: RequestedResults) -> None:
    """Write a scene file that extends the robot by the parameters found."""
    import yaml

    base = _beside(robot, file)
    comment_lines = [*report_lines(result), *further.report_lines(result)]
    text = yaml.safe_dump({"extends": base, **result.overlay}, sort_keys=False, default_flow_style=None)
    head = comment(f"Found by softsim calibrate {result.description.name}.", *comment_lines)
    write_file(file, head + text)


def write_distribution(file: Path, robot: str, result: Calibration) -> None:
    """Write a file that `load_distribution` reads."""
    import yaml

    from softsim_core.lab.identification import distribution_of

    distribution = given_values(distribution_of(result, _beside(robot, file)))
    head = comment(f"What softsim calibrate {result.description.name} leaves open.")
    write_file(file, head + yaml.safe_dump(distribution, sort_keys=False, default_flow_style=None))


def _beside(robot: str, file: Path) -> str:
    """Return the path of a robot's file relative to the folder of another file."""
    from softsim_core import find_config

    return os.path.relpath(find_config(robot), file.absolute().parent)


def page(robot: str, result: Calibration, further: RequestedResults) -> str:
    """Return the page as HTML; `robot` is the model that was fitted."""
    return render_page(
        "calibration.html",
        title=f"{result.description.name}: what was found of {robot}",
        result=result,
        folds=further.folds,
        intervals=further.intervals,
        parameters=[_parameter(result, further, k) for k in range(len(result.names))],
        correlations=zip(result.names, plain(result)["correlation"], strict=True),
        lines=[*report_lines(result), *further.report_lines(result)],
    )


def _parameter(result: Calibration, further: RequestedResults, k: int) -> dict[str, Any]:
    """Return the cells of a parameter in the table, and places on its bar: 0 and 1 are its bounds."""
    problem = result.problem
    value, start = float(result.values[k]), float(problem.values(problem.start)[k])
    half = float(result.half_widths[k])
    finite = bool(np.isfinite(half))
    reach = half if finite else float(problem.span[k])
    places = {"low": value - reach, "high": value + reach, "value": value, "start": start}
    return {
        "cells": (
            result.names[k],
            f"{value:.4g}",
            f"{half:.3g}" if finite else "?",
            result.units[k],
            "" if further.intervals is None else interval(*further.intervals[k]),
            f"{start:g}",
            verdict(result, k).partition(":")[0],
        ),
        "found": result.found[k],
        **{name: np.clip((at - problem.low[k]) / problem.span[k], 0.0, 1.0) for name, at in places.items()},
    }
