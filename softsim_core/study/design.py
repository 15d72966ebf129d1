"""The values of all runs of a study: grid, list, or spread over a box."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.stats import qmc

from softsim_core.arrays import Array
from softsim_core.errors import SceneError
from softsim_core.study.description import MOST_RUNS, StudyDescription, VariableDescription


def values_of_runs(study: StudyDescription) -> Array:
    """What the variables are in each run, shape (runs, p); the same study gives the same values.

    Raises:
        SceneError: the variables do not fit the kind of design, or there are too many runs.
    """
    variables, design = study.variables, study.design
    owner = f"study {study.name}: design {design.kind}"
    if design.kind == "grid":
        levels = [_levels(each, owner) for each in variables]
        count = int(np.prod([float(len(each)) for each in levels]))
        if count > MOST_RUNS:
            raise SceneError(f"{owner}: {count} runs are more than {MOST_RUNS}; take fewer values")
        return np.array(list(product(*levels)), dtype=float)
    if design.kind == "list":
        lengths = {each.name: len(each.values) for each in variables}
        if len(set(lengths.values())) > 1 or 0 in lengths.values():
            raise SceneError(f"{owner}: every variable needs values, as many as the others, not {lengths}")
        return np.array([each.values for each in variables], dtype=float).T
    assert design.samples is not None
    for each in variables:
        if each.lower is None:
            raise SceneError(f"{owner}: variable {each.name} needs lower and upper")
    shares = _shares(design.kind, len(variables), design.samples, design.seed)
    values = np.array(
        [[each.between(share) for each, share in zip(variables, row, strict=True)] for row in shares.tolist()]
    )
    if study.posterior is not None:
        values[:, : len(study.posterior.names)] = study.posterior.draw(design.samples, design.seed)
    return values


def _levels(variable: VariableDescription, owner: str) -> list[float]:
    if variable.values:
        return list(variable.values)
    if variable.count is None:
        raise SceneError(f"{owner}: variable {variable.name} needs values, or count beside its bounds")
    return [variable.between(k / (variable.count - 1)) for k in range(variable.count)]


def _shares(kind: str, dimensions: int, samples: int, seed: int) -> Array:
    """Points of the unit box, shape (samples, dimensions)."""
    if kind == "random":
        return np.random.default_rng(seed).random((samples, dimensions))
    if kind == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, seed=seed).random(samples))
    exponent = max(0, (samples - 1).bit_length())  # the first ones of a balanced set
    return np.asarray(qmc.Sobol(dimensions, seed=seed).random_base2(exponent)[:samples])
