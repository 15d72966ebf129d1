"""What passes a surface within a step, and pairs of edges that are looked at again."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.physics.contact import CollisionSurface, ContactSettings, Detector

SETTINGS = ContactSettings(alarm_distance=0.004, contact_distance=0.001).limits()
TOP = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]])
"""A triangle that faces up."""
TENT = np.array([[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, -0.01], [0.0, -0.01, -0.01]])
"""A ridge along x that looks up."""


def triangle(first: int, owner: int, *, down: bool = False) -> CollisionSurface:
    """One triangle over the vertices from `first` on."""
    order = [first, first + 2, first + 1] if down else [first, first + 1, first + 2]
    return CollisionSurface(
        name=f"sheet {owner}", vertices=slice(first, first + 3), triangles=np.array([order]), owner=owner
    )


def ridge(first: int, owner: int) -> CollisionSurface:
    """A TENT over the vertices from `first` on."""
    triangles = first + np.array([[0, 1, 2], [1, 0, 3]])
    return CollisionSurface(
        name=f"ridge {owner}", vertices=slice(first, first + 4), triangles=triangles, owner=owner
    )


def roof(height: float) -> np.ndarray:
    """A TENT along y that looks down from a height."""
    return TENT[:, [1, 0, 2]] * (1.0, 1.0, -1.0) + (0.0, 0.0, height)


@pytest.mark.parametrize(("down", "passes"), [(True, True), (False, False)])
def test_a_sheet_passes_another_one_only_where_the_two_face_each_other(down: bool, passes: bool) -> None:
    tilted = TOP * 0.3 + (0.003, 0.003, 0.0)
    before = np.concatenate([TOP, tilted + np.outer([0.001, 0.002, 0.002], [0, 0, 1])])
    after = before - np.repeat([0.0, 0.0015], 3)[:, None] * (0.0, 0.0, 1.0)
    detector = Detector((triangle(0, 0), triangle(3, 1, down=down)), before, SETTINGS)
    share = detector.free_share(before, after, np.array([True]))
    assert share == pytest.approx(2.0 / 3.0 if passes else 1.0)


def test_ridges_pass_each_other_when_they_meet_and_not_when_they_come_apart() -> None:
    apart, through = (np.concatenate([TENT, roof(height)]) for height in (0.001, -0.001))
    detector = Detector((ridge(0, 0), ridge(4, 1)), apart, SETTINGS)
    watched = np.array([True])
    assert detector.free_share(apart, through, watched) == pytest.approx(0.5)
    assert detector.free_share(through, apart, watched) == 1.0


def test_known_edges_are_looked_at_wherever_they_are() -> None:
    met = np.concatenate([TENT, roof(0.001)])
    detector = Detector((ridge(0, 0), ridge(4, 1)), met, SETTINGS)
    edges = detector.detect(met, 0.004)
    edges = edges.select(edges.seeker < 0)
    assert len(edges.key) == 1
    again = detector.again(edges.key, met)
    for name in ("key", "pair", "distance", "normal", "a", "b", "a_weights", "b_weights"):
        np.testing.assert_allclose(getattr(again, name), getattr(edges, name), atol=1e-12)
    beyond = np.concatenate([TENT, np.add(roof(0.001), (0.014, 0.0, 0.002))])  # past the end of the first one
    beside = detector.again(edges.key, beyond)
    np.testing.assert_allclose(beside.distance, [0.005])
    np.testing.assert_allclose(beside.normal, [[-0.8, 0.0, -0.6]], atol=1e-12)
    np.testing.assert_allclose(beside.a_weights, [[0.0, 1.0, 0.0]], atol=1e-12)
    crossed = np.concatenate([TENT, roof(-0.001)])
    assert len(detector.again(edges.key, crossed).key) == 0


def test_known_spheres_are_looked_at_in_front_of_what_they_met() -> None:
    def at(x: float, y: float, z: float) -> np.ndarray:
        return np.concatenate([TENT, [(x, y, z)]])

    ball = CollisionSurface(name="ball", vertices=slice(4, 5), owner=1, radius=0.0005)
    above = at(0.002, 0.0, 0.002)
    detector = Detector((ridge(0, 0), ball), above, SETTINGS)
    met = detector.detect(above, 0.004)
    again = detector.again(met.key, above)
    assert len(again.key) == 1
    for name in ("key", "pair", "distance", "normal", "seeker"):
        np.testing.assert_allclose(getattr(again, name), getattr(met, name), atol=1e-12)
    beside = at(0.005, 0.002, 0.001)  # in front of a face
    assert detector.detect(beside, 0.004).key != met.key
    again = detector.again(met.key, beside)
    np.testing.assert_allclose(again.distance, [np.hypot(0.002, 0.001) - 0.0005])
    np.testing.assert_allclose(again.normal, [np.array([0.0, -2.0, -1.0]) / np.sqrt(5.0)], atol=1e-12)
    ends = again.a_weights[0] @ beside[again.a[0]]
    np.testing.assert_allclose(ends, [0.005, 0.0, 0.0], atol=1e-12)
    face = detector.detect(beside, 0.004)
    np.testing.assert_allclose(detector.again(face.key, beside).distance, face.distance)
    for other in (at(0.011, 0.0, 0.001), at(0.002, 0.0, -0.001)):  # past the end, behind
        assert len(detector.again(met.key, other).key) == 0
    assert len(detector.again(met.key, above, edges_only=True).key) == 0
