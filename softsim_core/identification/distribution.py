"""What a calibration leaves open, as a distribution of its parameters that others draw from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError
from softsim_core.identification.expressions import filled
from softsim_core.identification.fit import Calibration
from softsim_core.scene.structure import structured
from softsim_core.scene.yaml_source import read_extended
from softsim_core.values import FieldError


@dataclass(frozen=True, slots=True, kw_only=True)
class DistributionDescription:
    """A normal distribution of parameters, cut at their bounds.

    Attributes:
        name: What messages call it.
        robot: The model that it belongs to: a name, or a file relative to this one.
        names: Of the parameters.
        units: Of them, for people.
        mean: Of them.
        covariance: Of them, row by row.
        lower, upper: Their bounds.
        overlay: Laid over the robot, with expressions of the parameters.
    """

    name: str
    robot: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    overlay: dict[str, Any]

    def __post_init__(self) -> None:
        count, owner = len(self.names), f"distribution {self.name}"
        for field in ("mean", "lower", "upper", "covariance", "units"):
            if len(getattr(self, field)) != count:
                raise FieldError(owner, field, f"{len(getattr(self, field))} values", f"{count}, as names")
        matrix = np.array(self.covariance)
        if matrix.shape != (count, count) or not np.isfinite(matrix).all():
            raise FieldError(owner, "covariance", f"shape {matrix.shape}", f"{count} rows of {count} numbers")
        scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        if np.linalg.eigvalsh(matrix / np.multiply.outer(scale, scale)).min() < -1e-8:
            raise FieldError(owner, "covariance", "of some direction is negative", "that of real numbers")
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise FieldError(owner, "lower", str(self.lower), "less than upper")

    def draw(self, count: int, seed: int = 0) -> Array:
        """Parameters drawn, shape (count, p), none outside the bounds."""
        generator, size = np.random.default_rng(seed), len(self.names)
        low, high = np.array(self.lower), np.array(self.upper)
        values, root = np.zeros((0, size)), _root(np.array(self.covariance))
        for _ in range(1000):
            drawn = np.array(self.mean) + generator.standard_normal((count, size)) @ root.T
            inside = ((drawn >= low) & (drawn <= high)).all(axis=1)
            values = np.concatenate([values, drawn[inside]])
            if len(values) >= count:
                return values[:count]
        raise FieldError(
            f"distribution {self.name}", "mean", str(self.mean), "one from which the bounds are reached"
        )

    def overlaid(self, values: Sequence[float]) -> dict[str, Any]:
        """What lays drawn values (p,) over the robot."""
        given = dict(zip(self.names, (float(each) for each in values), strict=True))
        overlay = filled(self.overlay, given)
        assert isinstance(overlay, dict)
        return overlay


def _root(covariance: Array) -> Array:
    """A matrix L with L L^T = covariance, of one that may be singular."""
    sizes, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(sizes, 0.0)))


def distribution_of(result: Calibration, robot: str) -> DistributionDescription:
    """That of a calibration: normal, of what the rows do not tell as wide as the bounds.

    A parameter that each session has its own of is that of a new session: about the mean of the n sessions
    with their variance :math:`s^2`, which has n - 1 degrees of freedom, times :math:`1 + 1/n`. The errors of
    the sessions' own values are in :math:`s^2`; where these are by chance alike, they stand in its place.

    Args:
        result: The calibration, not interrupted.
        robot: What the overlay is laid over.
    """
    problem, wanted = result.problem, result.description.parameters
    errors = np.minimum(result.widening * result.errors, problem.span / np.sqrt(12.0))
    correlation = np.where(np.isfinite(result.correlation), result.correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    covariance = correlation * np.multiply.outer(errors, errors)
    of = [name.partition(" ")[0] for name in result.names]
    chosen = np.array([[name == each.name for name in of] for each in wanted], dtype=float)
    counts = chosen.sum(axis=1)
    chosen /= counts[:, None]
    mean = chosen @ result.values
    between = (chosen @ result.values**2 - mean**2) * counts / np.maximum(counts - 1.0, 1.0)
    shared = chosen @ covariance @ chosen.T
    within = chosen @ np.diagonal(covariance)
    new = np.maximum(between, within) * (1.0 + 1.0 / counts)
    np.fill_diagonal(shared, np.where(counts > 1.0, new, np.diagonal(shared)))
    sizes, axes = np.linalg.eigh(shared)
    shared = (axes * np.maximum(sizes, 0.0)) @ axes.T
    return DistributionDescription(
        name=result.description.name,
        robot=robot,
        names=tuple(each.name for each in wanted),
        units=tuple(each.unit for each in wanted),
        mean=tuple(mean.tolist()),
        covariance=tuple(tuple(row) for row in shared.tolist()),
        lower=tuple(each.lower for each in wanted),
        upper=tuple(each.upper for each in wanted),
        overlay=result.description.overlay,
    )


def load_distribution(file: str | Path) -> DistributionDescription:
    """A distribution from its file.

    Raises:
        ConfigError: it is not there, or any problem in it, in one sentence.
    """
    path = Path(file).expanduser().absolute()
    if not path.is_file():
        raise ConfigError(str(file), "", "no such file")
    return structured(read_extended(path), DistributionDescription, path, find_files=False)


def plain_distribution(distribution: DistributionDescription) -> dict[str, Any]:
    """A distribution as plain data, for a file that `load_distribution` reads."""
    return {
        "name": distribution.name,
        "robot": distribution.robot,
        "names": list(distribution.names),
        "units": list(distribution.units),
        "mean": list(distribution.mean),
        "covariance": [list(row) for row in distribution.covariance],
        "lower": list(distribution.lower),
        "upper": list(distribution.upper),
        "overlay": _plain(distribution.overlay),
    }


def _plain(data: Any) -> Any:
    """Mappings and lists as those that YAML writes."""
    if isinstance(data, Mapping):
        return {key: _plain(each) for key, each in data.items()}
    return [_plain(each) for each in data] if isinstance(data, list | tuple) else data
