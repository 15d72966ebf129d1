"""The web page of `softsim sweep --report`: one self-contained file."""

from __future__ import annotations

from typing import Any

import numpy as np

from softsim_core.base import Array, StudyError
from softsim_core.lab.study import StudyResults, response_surface
from softsim_ros import render_page

MOST_RUNS = 3000
"""Largest number of drawn runs; of more, an evenly spaced selection. Printed numbers refer to all runs."""


def page(results: StudyResults) -> str:
    """Return the page as HTML.

    Raises:
        StudyError: no run is done.
    """
    if not results.done.any():
        raise StudyError(f"{results.folder}: no run is done, there is nothing to draw")
    study = results.attributes["study"]
    return render_page(
        "sweep.html",
        title=study["name"],
        study=study,
        results=results,
        counts=", ".join(f"{count} {word.replace('_', ' ')}" for word, count in results.counts.items()),
        failed=[(number, error) for number, error in enumerate(results.errors) if error],
        data=_data(results),
    )


def _data(results: StudyResults) -> dict[str, Any]:
    """Return the data that the page draws: finished runs, and a fitted surface of each quantity."""
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
