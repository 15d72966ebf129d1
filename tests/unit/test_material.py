"""Material laws by name: parameters and their intervals, registration, locking."""

from __future__ import annotations

import math
import pickle
import warnings

import numpy as np
import pytest
from small_scenes import body, scene

from softsim_core import Simulation
from softsim_core.base import MaterialError, SceneError
from softsim_core.physics.fem.elements import ElementData, element, element_names, register_element
from softsim_core.physics.fem.materials import Corotational, lame, material, material_names, register_material
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import MaterialDescription
from softsim_core.scene.building import build


@pytest.mark.parametrize(("young", "poisson"), [(250e3, 0.45), (1.0, 0.0), (5e6, -0.5), (1e3, 0.499)])
def test_lame_parameters_are_those_of_the_textbook(young: float, poisson: float) -> None:
    lam, mu = lame(np.array([young, poisson]))
    assert mu * (3.0 * lam + 2.0 * mu) / (lam + mu) == pytest.approx(young)
    assert lam / (2.0 * (lam + mu)) == pytest.approx(poisson)
    assert lam + 2.0 * mu / 3.0 == pytest.approx(young / (3.0 * (1.0 - 2.0 * poisson)))  # bulk modulus


@pytest.mark.parametrize("young", [0.0, -1.0, math.nan, math.inf])
def test_young_modulus_is_positive(young: float) -> None:
    with pytest.raises(MaterialError, match=r"young_modulus.*must be > 0 Pa") as caught:
        material("corotational").values({"young_modulus": young, "poisson_ratio": 0.3})
    assert caught.value.name == "young_modulus"
    with pytest.raises(SceneError, match=r"material: young_modulus must be > 0 Pa"):
        MaterialDescription(young_modulus=young, poisson_ratio=0.3)


@pytest.mark.parametrize("poisson", [0.5, -1.0, 0.7, math.nan])
def test_poisson_ratio_keeps_its_interval(poisson: float) -> None:
    with pytest.raises(MaterialError, match=r"poisson_ratio.*between -1 and 0.5") as caught:
        material("stable_neo_hookean").values({"young_modulus": 1.0, "poisson_ratio": poisson})
    assert caught.value.name == "poisson_ratio"


def test_unknown_and_missing_parameters_are_sentences() -> None:
    with pytest.raises(
        MaterialError, match=r"parameter stiff = 3\.0 is unknown to the law corotational; known: you"
    ):
        material("corotational").values({"young_modulus": 1.0, "poisson_ratio": 0.3, "stiff": 3.0})
    with pytest.raises(MaterialError, match=r"poisson_ratio .*missing; it must be between -1 and 0\.5"):
        material("corotational").values({"young_modulus": 1.0})
    with pytest.raises(
        SceneError, match=r"the law corotational has no parameter 'c10'; known: young_modulus, "
    ):
        MaterialDescription(young_modulus=1.0, poisson_ratio=0.3, c10=1.0)


def test_a_law_that_is_not_known_is_a_sentence() -> None:
    with pytest.raises(
        SceneError, match=r"unknown material law 'rubber'; known: corotational, corotational_qr, st"
    ):
        MaterialDescription(law="rubber", young_modulus=1.0)
    with pytest.raises(SceneError, match=r"unknown element 'hex20'; did you mean hex8.* known: tet4"):
        element("hex20")


def test_descriptions_are_values() -> None:
    one = MaterialDescription(law="stable_neo_hookean", young_modulus=2e5, poisson_ratio=0.4)
    assert one == MaterialDescription(law="stable_neo_hookean", poisson_ratio=0.4, young_modulus=2e5)
    assert one != MaterialDescription(young_modulus=2e5, poisson_ratio=0.4)
    assert {one: 1}[pickle.loads(pickle.dumps(one))] == 1
    assert one.with_values(young_modulus=1.0).young_modulus == 1.0
    assert (one.young_modulus, one.law) == (2e5, "stable_neo_hookean")
    with pytest.raises(AttributeError, match="does not change"):
        one.young_modulus = 3.0
    with pytest.raises(AttributeError, match="no 'density'"):
        _ = one.density


def test_a_law_of_the_package_is_not_replaced_and_one_of_a_user_is() -> None:
    with pytest.raises(
        SceneError, match="'corotational' is the package's own; choose another name for yours"
    ):
        register_material(Corotational())

    class Renamed(Corotational):
        name = "renamed"

    first, second = Renamed(), Renamed()
    register_material(first)
    register_material(second)
    assert material("renamed") is second
    assert "renamed" in material_names()


def test_an_element_that_does_not_fit_together_is_refused() -> None:
    good = element("tet4")
    fields = {
        name: getattr(good, name) for name in ("reference", "points", "weights", "slopes", "edges", "faces")
    }
    for wrong, sentence in (
        ({"weights": np.array([0.1, 0.1])}, "must have the shapes"),
        ({"weights": np.array([-1.0])}, "weights must be > 0"),
        ({"slopes": 2.0 * good.slopes}, "a linear field is not met"),
    ):
        with pytest.raises(ValueError, match=sentence):
            register_element(ElementData(name="wrong", **{**fields, **wrong}))
    assert "wrong" not in element_names()


@pytest.mark.parametrize(("ratio", "warned"), [(0.489, False), (0.49, True), (0.4995, True)])
def test_nearly_incompressible_linear_tetrahedra_are_warned_of(ratio: float, warned: bool) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        build(scene(body(box_mesh((0.1, 0.1, 0.1), (2, 2, 2)), poisson_ratio=ratio)))
    sentences = [str(each.message) for each in caught]
    assert (
        any("too stiff: nearly incompressible linear tetrahedra lock" in each for each in sentences) == warned
    )


def test_parameters_of_any_law_are_tuned_by_name() -> None:
    block = body(box_mesh((0.1, 0.1, 0.1), (2, 2, 2)))
    simulation = Simulation(scene(block), backend="scipy")
    simulation.set_material("body", poisson_ratio=0.2)
    assert simulation.material("body") == MaterialDescription(young_modulus=1e5, poisson_ratio=0.2)
    with pytest.raises(MaterialError, match=r"c10 = 1\.0 is unknown to the law corotational"):
        simulation.set_material("body", c10=1.0)
    with pytest.warns(UserWarning, match="nearly incompressible linear tetrahedra lock"):
        simulation.set_material("body", poisson_ratio=0.495)
