"""Isotropic materials and their interval."""

from __future__ import annotations

import math

import pytest

from softsim_core.errors import MaterialError
from softsim_core.fem.material import LinearMaterial


@pytest.mark.parametrize(("young", "poisson"), [(250e3, 0.45), (1.0, 0.0), (5e6, -0.5), (1e3, 0.499)])
def test_lame_parameters_give_the_material_back(young: float, poisson: float) -> None:
    lam, mu = LinearMaterial(young, poisson).lame
    assert mu * (3.0 * lam + 2.0 * mu) / (lam + mu) == pytest.approx(young)
    assert lam / (2.0 * (lam + mu)) == pytest.approx(poisson)
    assert lam + 2.0 * mu / 3.0 == pytest.approx(young / (3.0 * (1.0 - 2.0 * poisson)))  # bulk modulus


@pytest.mark.parametrize("young", [0.0, -1.0, math.nan, math.inf])
def test_young_modulus_is_positive(young: float) -> None:
    with pytest.raises(MaterialError, match=r"young_modulus.*must be > 0 Pa") as caught:
        LinearMaterial(young, 0.3)
    assert caught.value.name == "young_modulus"


@pytest.mark.parametrize("poisson", [0.5, -1.0, 0.7, math.nan])
def test_poisson_ratio_keeps_its_interval(poisson: float) -> None:
    with pytest.raises(MaterialError, match=r"poisson_ratio.*\(-1, 0.5\)") as caught:
        LinearMaterial(1.0, poisson)
    assert caught.value.name == "poisson_ratio"
