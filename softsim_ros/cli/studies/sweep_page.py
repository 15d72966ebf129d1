"""The web page of `softsim sweep --report`: one file that loads nothing, drawn from the store of a study."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import StudyError
from softsim_core.file_writing import write_file
from softsim_core.study.response import response_surface
from softsim_core.study.results import StudyResults
from softsim_ros.cli.measurements.validate_page import PAGE
from softsim_ros.cli.studies.sweep_script import SCRIPT, STYLE

MOST_RUNS = 3000
"""Runs that are drawn; of more, evenly some. What is told in numbers is of all."""

MOST_ERRORS = 20

VIEW = """
<nav id="quantities"></nav>
<div><h2>All runs</h2><svg id="lines" viewBox="0 0 1200 330"></svg>
<p>A line is a run, coloured by what is chosen above. Drag along an axis to keep the runs that pass
there, click beside the axes to keep all.</p></div>
<h2>Main effects</h2><div class="row" id="effects"></div>
<p>Points are runs; the line is their mean at each value, or in ten equal parts of the range.</p>
<div class="row"><div><h2>Response surface</h2>
<p>over <select id="first"></select> and <select id="second"></select>; other variables at their middle</p>
<canvas id="surface" width="560" height="420"></canvas><p id="fit"></p></div>
<div><h2>Best and worst runs</h2><table class="numbers" id="extremes"></table></div></div>
"""


def write(file: Path, results: StudyResults) -> None:
    """Write the page.

    Raises:
        StudyError: the file cannot be written, or no run is done.
    """
    try:
        write_file(file, page(results))
    except OSError as error:
        raise StudyError(f"{file} cannot be written ({error.strerror})") from error


def page(results: StudyResults) -> str:
    """The page's text.

    Raises:
        StudyError: no run is done.
    """
    if not results.done.any():
        raise StudyError(f"{results.folder}: no run is done, there is nothing to draw")
    study = results.attributes["study"]
    text = escape(results.attributes["study_text"])
    counted = ", ".join(f"{count} {word.replace('_', ' ')}" for word, count in results.counts.items())
    parts = [
        f"<p>{escape(study['about'])}</p>",
        f"<p><b>{len(results.status)} runs</b> of {escape(study['scene'])}: {escape(counted)}</p>",
        VIEW,
        _errors(results),
        f"<details><summary>The study</summary><pre>{text}</pre></details>",
    ]
    data = json.dumps(_data(results), allow_nan=False)
    return PAGE.format(
        title=escape(study["name"]),
        style=STYLE,
        body="\n".join(parts),
        data=data.replace("<", "\\u003c"),
        script=SCRIPT,
    )


def _errors(results: StudyResults) -> str:
    failed = [(number, error) for number, error in enumerate(results.errors) if error]
    if not failed:
        return ""
    rows = "".join(f"<tr><td>{number}<td>{escape(error)}" for number, error in failed[:MOST_ERRORS])
    more = f"<p>and {len(failed) - MOST_ERRORS} more</p>" if len(failed) > MOST_ERRORS else ""
    return f"<h2>Runs that failed</h2><table><tr><th>run<th>why{rows}</table>{more}"


def _data(results: StudyResults) -> dict[str, Any]:
    """What the page draws: runs that are done, and a fitted surface of each quantity."""
    done = np.flatnonzero(results.done)
    shown = done[np.unique(np.linspace(0, len(done) - 1, min(len(done), MOST_RUNS)).astype(int))]
    varied = {name: each for name, each in results.variables.items() if np.ptp(each[done]) > 0.0}
    points = np.array([each[done] for each in varied.values()]).T.reshape(len(done), len(varied))
    surfaces = {
        name: response_surface(points, each[done]).plain()
        for name, each in results.quantities.items()
        if np.isfinite(each[done]).all()
    }
    return {
        "runs": shown.tolist(),
        "variables": [_axis(results, name, each[shown]) for name, each in varied.items()],
        "quantities": [
            _axis(results, name, results.quantities[name][shown]) | {"surface": surface}
            for name, surface in surfaces.items()
        ],
    }


def _axis(results: StudyResults, name: str, values: Array) -> dict[str, Any]:
    return {"name": name, "unit": results.units[name], "values": [float(f"{each:.7g}") for each in values]}
