"""95 % intervals of many made measurements hold the truth in 95 % of them: losses, priors, few rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t

from softsim_core.base import Array
from softsim_core.lab.identification import (
    QUANTILE,
    AlignmentDescription,
    Calibration,
    CalibrationDescription,
    Loss,
    Misfit,
    Near,
    ParameterDescription,
    PointLoss,
    Prediction,
    SensorDescription,
    Session,
    SessionDescription,
    Table,
    cross_validated,
    distribution_of,
    fit,
    locate_sensors,
    profiled,
)
from softsim_core.physics.mechanics import rotation_exp
from softsim_ros.cli.measurements import plain, report_lines

TRUE = {"zero": 0.08, "sag": 2.6}
NOISE = 2e-4
ZERO = ParameterDescription(name="zero", start=0.0, lower=-0.3, upper=0.3)
SAG = ParameterDescription(name="sag", start=2.0, lower=0.1, upper=6.0)


class ArmMisfit(Misfit):
    """Rows of an arm in closed form: it turns by its command, and sags."""

    def replay_sessions(self, values: Array, near: Sequence[Near] | None = None) -> list[Prediction]:
        """What the arm does in each session with values (p,)."""
        return [
            arm(
                each,
                {
                    wanted.name: value
                    for (wanted, of), value in zip(self._acting, values, strict=True)
                    if of in (None, k)
                },
            )
            for k, each in enumerate(self.sessions)
        ]

    def follow(self, values: Array, told: object) -> None:
        """There is one equilibrium for each command."""


def arm(session: Session, values: dict[str, float]) -> Prediction:
    """Where the tip is, and how it is turned, with an angle of zero and a sag in [cm]."""
    turned = session.table.numbers("angle") + values["zero"]
    level = np.cos(turned)
    places = np.column_stack([0.2 * level, 0.0 * turned, 0.2 * np.sin(turned) - 0.01 * values["sag"] * level])
    rotations = np.stack([rotation_exp(np.array([0.0, -each, 0.0])) for each in turned])
    return Prediction(places[:, None], rotations[:, None], np.ones(len(turned), bool))


@dataclass(frozen=True)
class Bench:
    """How measurements are made and fitted.

    Attributes:
        rows: Of each session.
        sessions: How many; each has its own zero where there is more than one.
        priors: Standard deviations of priors, whose means are drawn about the truth.
        wrong: By how many standard deviations the prior of sag is wrong beside.
        outliers: Share of the rows that are wrong by 2 cm in any direction.
        point: Whether the place of the sensor is fitted, too.
        given: What the description says.
    """

    rows: int = 20
    sessions: int = 1
    priors: tuple[tuple[str, float], ...] = ()
    wrong: float = 0.0
    outliers: float = 0.0
    point: bool = False
    given: tuple[tuple[str, Any], ...] = ()

    def fitted(self, seed: int) -> tuple[Calibration, Array]:
        """A calibration, and the truth of its parameters."""
        random = np.random.default_rng(seed)
        truth = [TRUE["zero"] + 0.05 * k for k in range(self.sessions)]
        sessions = [self._measured(k, {**TRUE, "zero": zero}, random) for k, zero in enumerate(truth)]
        parameters = []
        for each in (replace(ZERO, per_session=self.sessions > 1), SAG):
            if (deviation := dict(self.priors).get(each.name)) is not None:
                off = random.standard_normal() + self.wrong * (each.name == "sag")
                each = replace(each, start=TRUE[each.name] + deviation * off, prior=deviation)
            parameters.append(each)
        description = CalibrationDescription(
            name="arm",
            data_set=".",
            parameters=tuple(parameters),
            overlay={"zero": "= zero", "sag": "= sag"},
            **dict(self.given),
        )
        result = fit(description, ArmMisfit(description, "arm", sessions))
        return result, np.array([*truth, TRUE["sag"]])

    def _measured(self, number: int, values: dict[str, float], random: np.random.Generator) -> Session:
        sensor = SensorDescription(name="tip", columns=("x", "y", "z"))
        description = SessionDescription(
            name=f"s{number}",
            file=Path("s.csv"),
            sensors=(sensor,),
            alignment=AlignmentDescription(point=self.point),
        )
        table = Table(Path("s.csv"), {"angle": np.linspace(-1.1, 1.1, self.rows)}, range(self.rows))
        used = np.ones(self.rows, bool)
        session = Session(description, table, np.zeros((self.rows, 1, 3)), {}, used, used, None)
        made = arm(session, values)
        places = locate_sensors(made.positions, made.rotations, np.zeros((1, 3)))
        noise = NOISE * random.standard_normal(places.shape)
        wrong = random.standard_normal(places.shape)
        wrong *= (
            0.02
            * (random.random(self.rows) < self.outliers)[:, None, None]
            / np.linalg.norm(wrong, axis=-1, keepdims=True)
        )
        return replace(session, measured=places + noise + wrong)


BENCHES = {
    "no prior": Bench(),
    "strong prior": Bench(priors=(("sag", 0.003),)),
    "two priors": Bench(priors=(("sag", 0.05), ("zero", 2e-4))),
    "wrong prior": Bench(priors=(("sag", 0.003),), wrong=25.0),
    "outliers": Bench(rows=40, outliers=0.05, given=(("loss", "soft_l1"), ("scale_mm", 0.5))),
    "outliers and a prior": Bench(
        rows=40, outliers=0.05, priors=(("sag", 0.02),), given=(("loss", "soft_l1"), ("scale_mm", 0.3))
    ),
    "eight rows": Bench(rows=8),
    "eight rows and a prior": Bench(rows=8, priors=(("sag", 0.02),)),
    "eight rows and the place of the sensor": Bench(rows=8, point=True, priors=(("zero", 0.002),)),
    "three sessions": Bench(rows=12, sessions=3),
}


def standardised(name: str, count: int) -> tuple[Array, list[int]]:
    """Errors of made fits over half of their intervals, (count, p), and how many priors each left out."""
    errors, left_out = [], []
    for seed in range(count):
        result, truth = BENCHES[name].fitted(seed)
        errors.append((result.values - truth) / result.half_widths)
        left_out.append(len(result.conflicts))
    return np.array(errors), left_out


DAILY = ("no prior", "wrong prior", "outliers and a prior", "eight rows and the place of the sensor")
"""Each loss, a prior, few rows, an alignment; the exhaustive test below takes all, and more fits."""


@pytest.mark.slow
@pytest.mark.parametrize("name", DAILY)
def test_standard_errors_are_those_of_many_fits(name: str) -> None:
    """Bounds are five standard deviations away for 50 fits."""
    errors, left_out = standardised(name, 50)
    assert np.mean(np.abs(errors) < 1.0) > 0.84
    assert 0.5 < QUANTILE * np.sqrt((errors**2).mean()) < 1.5
    assert np.mean(left_out) == 1.0 if BENCHES[name].wrong else np.mean(left_out) < 0.1


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", BENCHES)
def test_intervals_hold_the_truth_as_often_as_told(name: str) -> None:
    errors, left_out = standardised(name, 400)
    assert 0.93 < np.mean(np.abs(errors) < 1.0) < 0.97
    assert np.mean(left_out) == 1.0 if BENCHES[name].wrong else np.mean(left_out) < 0.03


def test_a_prior_is_weighed_against_the_noise_of_the_rows_alone() -> None:
    """Least squares has no outliers, so their scale does not matter."""
    bench = BENCHES["strong prior"]
    values = [replace(bench, given=(("scale_mm", scale),)).fitted(3)[0].values for scale in (0.1, 10.0)]
    assert values[0] == pytest.approx(values[1], rel=1e-4)


def test_a_prior_that_rows_contradict_is_left_out_and_reported() -> None:
    result, truth = BENCHES["wrong prior"].fitted(0)
    (conflict,) = result.conflicts
    assert (conflict.parameter, conflict.name) == (1, "sag")
    assert conflict.deviation == pytest.approx(0.003)
    assert conflict.from_rows == pytest.approx(truth[1], abs=4.0 * conflict.error)
    assert conflict.error == pytest.approx(result.errors[1], rel=0.2)
    assert conflict.chance < 1e-3
    assert any("PRIOR LEFT OUT: sag" in line for line in report_lines(result))
    assert plain(result)["priors_left_out"][0]["name"] == "sag"


def test_quantiles_are_those_of_the_rows_that_tell_the_noise() -> None:
    few = BENCHES["eight rows"].fitted(0)[0]
    assert few.quantiles == pytest.approx(t.ppf(0.975, 24 - 2))
    known = replace(BENCHES["eight rows"], priors=(("sag", 1e-5),)).fitted(0)[0]
    assert known.quantiles[1] == pytest.approx(QUANTILE, abs=1e-3)
    assert known.quantiles[0] == pytest.approx(few.quantiles[0], abs=0.01)


@pytest.mark.parametrize("name", ["strong prior", "outliers", "outliers and a prior", "eight rows"])
def test_profiles_agree_with_standard_errors(name: str) -> None:
    result, _ = BENCHES[name].fitted(1)
    for k in range(2):
        assert profiled(result, k) == pytest.approx(
            result.values[k] + result.half_widths[k] * np.array([-1.0, 1.0]), abs=0.15 * result.half_widths[k]
        )


def test_folds_are_fitted_with_the_loss_of_the_whole() -> None:
    result, _ = BENCHES["outliers"].fitted(1)
    folds = cross_validated(result, 5)
    assert folds.fitted["s0"] == pytest.approx(result.after["s0"], rel=0.005)


@pytest.mark.parametrize("kind", ["linear", "soft_l1"])
def test_a_loss_is_that_of_points_in_any_frame(kind: Loss) -> None:
    loss, random = PointLoss(kind, 0.7), np.random.default_rng(4)
    errors, slopes = random.standard_normal(15), random.standard_normal((15, 2))
    turned = (errors.reshape(-1, 3) @ rotation_exp(np.array([0.3, -1.0, 0.4]))).ravel()

    def total(each: Array) -> float:
        return float((loss.residuals(each) ** 2).sum())

    assert total(turned) == pytest.approx(total(errors))
    step = 1e-6
    by_differences = [
        (loss.residuals(errors + step * each) - loss.residuals(errors - step * each)) / (2.0 * step)
        for each in slopes.T
    ]
    assert loss.slopes(errors, slopes) == pytest.approx(np.array(by_differences).T, abs=1e-8)
    gradient = [
        (total(errors + step * each) - total(errors - step * each)) / (4.0 * step) for each in np.eye(15)
    ]
    assert loss.scores(errors) == pytest.approx(gradient, abs=1e-8)
    bends = [
        (loss.scores(errors + step * each) - loss.scores(errors - step * each)) @ each / (2.0 * step)
        for each in np.eye(15)
    ]
    assert loss.curvature(errors) == pytest.approx(np.mean(bends), abs=1e-8)


def test_a_new_session_varies_as_those_there_are_and_as_their_mean_is_unknown() -> None:
    result, truth = BENCHES["three sessions"].fitted(0)
    left_open = distribution_of(result, "arm")
    assert left_open.names == ("zero", "sag")
    assert left_open.covariance[0][0] == pytest.approx(np.var(result.values[:3], ddof=1) * (1 + 1 / 3))
    assert left_open.covariance[0][0] == pytest.approx(np.var(truth[:3], ddof=1) * (1 + 1 / 3), rel=0.02)
    alike = distribution_of(replace(result, values=result.values[[0, 0, 0, 3]]), "arm")
    within = np.mean((result.widening * result.errors)[:3] ** 2)
    assert alike.covariance[0][0] == pytest.approx(within * (1 + 1 / 3))
