"""Rods against closed forms of slender bodies, and against the same bodies of tetrahedra."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.linalg import eigh, expm
from scipy.optimize import brentq

from softsim_core.base import Array, Sphere, Vector
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.dynamics import Unknowns, node_stiffness
from softsim_core.physics.fem import cell_energy, cell_forces, cell_stiffness
from softsim_core.physics.fem.rods import RodGroup
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import box_mesh, quadratic
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    LayerOfRodDescription,
    MaterialDescription,
    RodClampDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)
from softsim_core.scene.building import SHEAR_SHARE
from softsim_core.simulation import Simulation

LENGTH, THICK, WIDE, YOUNG, POISSON, DENSITY = 0.2, 0.004, 0.006, 2e7, 0.3, 1200.0
AREA, SHEAR = THICK * WIDE, YOUNG / (2.0 * (1.0 + POISSON))
BEND = YOUNG * WIDE * THICK**3 / 12.0
RECTANGLE = RodSectionDescription(shape="rectangle", size=(THICK, WIDE))
STRAIGHT = ((0.0, 0.0, 0.0), (LENGTH, 0.0, 0.0))


def rod(**fields: object) -> RodDescription:
    given = {"centreline": STRAIGHT, "section": RECTANGLE, **fields}
    return RodDescription(**given)  # type: ignore[arg-type]


def made_of(**values: float) -> MaterialDescription:
    return MaterialDescription(law="rod", **{"young_modulus": YOUNG, "poisson_ratio": POISSON, **values})


def body(described: RodDescription, name: str = "rod", **values: float) -> BodyDescription:
    return BodyDescription(name=name, rod=described, material=made_of(**values), density=DENSITY)


def held_at(place: Vector, name: str = "clamp", to: str = "world", of: str = "rod") -> AttachmentDescription:
    return AttachmentDescription(name=name, body=of, to=to, sphere=Sphere(center=place, radius=1e-6))


def cantilever(described: RodDescription, gravity: Vector = (0.0, 0.0, 0.0), **values: float) -> Simulation:
    clamp = held_at(tuple(described.centreline[0]))
    return Simulation(
        SceneDescription(
            name="rod", gravity=gravity, bodies=(body(described, **values),), attachments=(clamp,)
        ),
        backend="scipy",
    )


def tip(simulation: Simulation, force: Vector) -> Array:
    """Where the centre of the last section is under a force there."""
    simulation.forces[-3:] = np.array(force) / 3.0
    return np.asarray(simulation.equilibrium().state.positions[-3:].mean(axis=0))


@pytest.fixture(scope="module")
def curved() -> tuple[RodGroup, Array, Array]:
    """A tapered, layered, curved rod with a clamp; its nodes, and the values of its law."""
    layers = (
        LayerOfRodDescription(share=0.3, modulus_ratio=4.0),
        LayerOfRodDescription(share=0.7, modulus_ratio=0.5),
    )
    section = RodSectionDescription(
        shape="rectangle", size=(0.004, 0.006), end_size=(0.003, 0.002), layers=layers
    )
    line = ((0.0, 0.0, 0.0), (0.05, 0.02, 0.0), (0.1, 0.0, 0.03), (0.15, 0.05, 0.05))
    clamp = RodClampDescription(rotation=(0.2, 0.3, math.inf))
    described = rod(
        centreline=line, section=section, elements=4, start_clamp=clamp, curvature=(3.0, -2.0, 4.0)
    )
    built = cantilever(replace(described, start_clamp=None), twist_factor=1.7).model
    clamped = Simulation(
        SceneDescription(name="rod", bodies=(body(described, twist_factor=1.7),)), backend="scipy"
    ).model
    assert len(clamped.groups[0].cells) == len(built.groups[0].cells) + 1
    group = clamped.groups[0]
    assert isinstance(group, RodGroup)
    values = group.values([dict(made_of(twist_factor=1.7).values)])
    return group, clamped.rest, values


def moved(points: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return np.asarray(
        (points + 3e-4 * rng.standard_normal(points.shape)) @ rotation_exp(rng.uniform(-2, 2, 3)).T
    )


@pytest.mark.parametrize("seed", range(3))
def test_forces_and_stiffness_are_derivatives_of_the_energy(
    curved: tuple[RodGroup, Array, Array], seed: int
) -> None:
    group, rest, p = curved
    x, h = moved(rest, seed), 1e-8
    way = np.random.default_rng(seed).standard_normal(x.shape)

    def forces(at: Array) -> Array:
        result = np.zeros_like(at)
        np.add.at(result, group.cells, cell_forces(group, at, p))
        return result

    slope = (cell_energy(group, x + h * way, p) - cell_energy(group, x - h * way, p)).sum() / (2 * h)
    assert slope == pytest.approx(-(forces(x) * way).sum(), rel=1e-6)
    answer = np.zeros_like(x)
    np.add.at(answer, group.cells, np.einsum("mabij,mbj->mai", cell_stiffness(group, x, p), way[group.cells]))
    differences = -(forces(x + h * way) - forces(x - h * way)) / (2 * h)
    assert np.abs(answer - differences).max() < 1e-6 * np.abs(answer).max()


def test_turning_changes_no_energy_and_strains_alone_do(curved: tuple[RodGroup, Array, Array]) -> None:
    group, rest, p = curved
    x = moved(rest, 7)
    turned = x @ rotation_exp(np.array([1.0, -2.0, 0.5])).T + np.array([3.0, 1.0, -2.0])
    assert cell_energy(group, turned, p).sum() == pytest.approx(cell_energy(group, x, p).sum(), rel=1e-9)
    plain = cantilever(rod(elements=3)).model
    values = plain.groups[0].values([dict(made_of().values)])
    whole = np.zeros((3 * len(plain.rest),) * 2)
    blocks = cell_stiffness(plain.groups[0], plain.rest, values)
    for cell, of_cell in zip(plain.groups[0].cells, blocks, strict=True):
        places = (3 * cell[:, None] + np.arange(3)).ravel()
        whole[np.ix_(places, places)] += of_cell.swapaxes(1, 2).reshape(27, 27)
    eigenvalues = np.linalg.eigvalsh(whole)
    assert np.abs(eigenvalues[:6]).max() < 1e-4 * eigenvalues[6]  # no motion but of the whole is free


@pytest.mark.parametrize("seed", range(3))
def test_positive_stiffness_has_no_negative_eigenvalues(
    curved: tuple[RodGroup, Array, Array], seed: int
) -> None:
    group, rest, p = curved
    blocks = cell_stiffness(group, moved(rest, seed), p, positive=True)
    matrices = blocks.swapaxes(2, 3).reshape(len(blocks), 27, 27)
    assert np.linalg.eigvalsh(matrices).min() > -1e-9 * np.abs(matrices).max()


def elastica(load: float, stretch: float) -> Array:
    """Tip of a clamped elastica under load EI / L^2 across, in lengths; `stretch`: EI / (EA L^2)."""

    def slopes(s: Array, y: Array) -> Array:
        grown = 1.0 - part * stretch * np.sin(y[0])
        return np.vstack([y[1], grown * part * np.cos(y[0]), grown * np.cos(y[0]), grown * np.sin(y[0])])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 200)
    guess = np.zeros((4, 200))
    for part in (np.linspace(0.05, 1.0, 20) * load).tolist():  # noqa: B007 (see `slopes`)
        found = solve_bvp(slopes, ends, s, guess, tol=1e-8)
        guess = found.sol(s)
    return np.asarray(found.sol(1.0)[2:])


@pytest.mark.parametrize("share", [-0.4, -0.1, 0.5])
def test_pressed_and_pulled_it_gets_shorter_and_longer_as_hooke_says(share: float) -> None:
    """Far: a law that is linear in the square of the length gives way at 0.19 of the stiffness."""
    line = ((0.0, 0.0, 0.0), (0.4 * THICK, 0.3 * THICK, 0.0))  # short, else it would buckle
    short = rod(centreline=line, first_axis=(0.0, 0.0, 1.0), elements=2)
    pulled = tip(
        cantilever(short, shear_factor=100.0), tuple(share * YOUNG * AREA * np.array([0.8, 0.6, 0.0]))
    )
    assert pulled == pytest.approx((1.0 + share) * np.array(line[1]), rel=1e-6)


@pytest.mark.parametrize("load", [1.0, 5.0, 10.0])
def test_elastica(load: float) -> None:
    expected = LENGTH * elastica(load, BEND / (YOUNG * AREA * LENGTH**2))
    found = tip(cantilever(rod(), shear_factor=1e3), (0.0, 0.0, -load * BEND / LENGTH**2))
    assert np.linalg.norm(found[[0, 2]] - expected) < 5e-4 * LENGTH


def test_it_converges_to_the_elastica_with_third_order_or_better() -> None:
    fine = tip(cantilever(rod(elements=48)), (0.0, 0.0, 5.0 * BEND / LENGTH**2))
    errors = [
        np.linalg.norm(tip(cantilever(rod(elements=n)), (0.0, 0.0, 5.0 * BEND / LENGTH**2)) - fine)
        for n in (2, 4, 8)
    ]
    rates = [math.log2(coarse / finer) for coarse, finer in pairwise(errors)]
    assert min(rates) > 2.8
    assert errors[-1] < 1e-4 * LENGTH


def bend_of_45_degrees(elements: int = 10) -> Simulation:
    angles = np.radians(np.linspace(0.0, 45.0, 9))
    arc = np.column_stack([100.0 * (1.0 - np.cos(angles)), 100.0 * np.sin(angles), np.zeros(9)])
    described = RodDescription(
        centreline=tuple(tuple(each) for each in arc.tolist()),
        start_direction=(0.0, 1.0, 0.0),
        end_direction=(math.sqrt(0.5), math.sqrt(0.5), 0.0),
        section=RodSectionDescription(shape="rectangle", size=(1.0, 1.0)),
        elements=elements,
    )
    theirs = {"shear_factor": 6.0 / 5.0, "twist_factor": (1.0 / 6.0) / 0.1406}  # whole area, polar moment
    return cantilever(described, young_modulus=1e7, poisson_ratio=0.0, **theirs)


def test_bent_out_of_its_plane_it_converges_with_third_order_or_better() -> None:
    places = [tip(bend_of_45_degrees(n), (0.0, 0.0, 600.0)) for n in (2, 4, 8, 32)]
    errors = [np.linalg.norm(place - places[-1]) for place in places[:-1]]
    assert min(math.log2(coarse / finer) for coarse, finer in pairwise(errors)) > 3.0
    assert errors[-1] < 1e-3


@pytest.mark.parametrize(
    ("force", "expected"),
    [(300.0, (22.33, 58.84, 40.08)), (450.0, (18.62, 52.32, 48.39)), (600.0, (15.79, 47.23, 53.37))],
)
def test_bend_of_45_degrees_leaves_its_plane(force: float, expected: Vector) -> None:
    """Bathe and Bolourchi 1979; numbers of Simo and Vu-Quoc 1986, with eight straight elements."""
    assert tip(bend_of_45_degrees(), (0.0, 0.0, force)) == pytest.approx(expected, abs=0.2)


def unloaded(curvature: Vector) -> Array:
    """Centres of the sections of a rod that is let go when straight, once it is at rest."""
    curled = cantilever(rod(natural="straight", curvature=curvature, elements=16), shear_factor=1e3)
    for _ in range(200):
        curled.step()
    return np.asarray(curled.equilibrium().state.positions.reshape(-1, 3, 3).mean(axis=1))


@pytest.mark.slow
def test_natural_curvature_makes_a_circle() -> None:
    places = unloaded((2.0 * math.pi / LENGTH, 0.0, 0.0))
    assert np.linalg.norm(places[-1] - places[0]) < 2e-3 * LENGTH
    assert np.ptp(places[:, 2]) == pytest.approx(LENGTH / math.pi, rel=2e-3)
    assert np.abs(places[:, 1]).max() < 1e-9


@pytest.mark.slow
def test_statics_straighten_what_is_drawn_as_a_quarter_of_a_circle() -> None:
    angles = np.linspace(0.0, 0.5 * math.pi, 6)
    arc = 0.6 * LENGTH * np.column_stack([np.sin(angles), 0.0 * angles, np.cos(angles) - 1.0])
    drawn = rod(
        centreline=tuple(tuple(each) for each in arc.tolist()),
        start_direction=(1.0, 0.0, 0.0),
        end_direction=(0.0, 0.0, -1.0),
        natural="straight",
        length=LENGTH,
    )
    assert tip(cantilever(drawn), (0.0, 0.0, 0.0)) == pytest.approx(STRAIGHT[1], abs=1e-9)


@pytest.mark.parametrize(("curve", "twist"), [(25.0, 18.0), (10.0, -30.0)])
@pytest.mark.slow
def test_natural_curvature_and_twist_make_a_helix(curve: float, twist: float) -> None:
    places = unloaded((curve, 0.0, twist))
    total = math.hypot(curve, twist)
    radius, rise, turn = curve / total**2, twist / total, total * LENGTH
    chord = math.hypot(rise * LENGTH, 2.0 * radius * math.sin(0.5 * turn))
    assert np.linalg.norm(places[-1] - places[0]) == pytest.approx(chord, rel=2e-3)
    # all points have one distance from the axis, which is along the rotation of the tangent
    tangents = np.gradient(places, LENGTH / 32.0, axis=0)[3:-3]
    axis = np.linalg.svd(tangents - tangents.mean(axis=0))[2][-1]
    assert np.abs(tangents @ axis) == pytest.approx(np.full(len(tangents), abs(rise)), rel=5e-3)


@pytest.mark.parametrize(
    ("direction", "stiffness"),
    [((1.0, 0.0, 0.0), None), ((0.0, 1.0, 0.0), WIDE**2), ((0.0, 0.0, 1.0), THICK**2)],
)
def test_small_loads_meet_timoshenko(direction: Vector, stiffness: float | None) -> None:
    force = 1e-4
    moved_by = tip(cantilever(rod()), tuple(force * each for each in direction)) - np.array(STRAIGHT[1])
    if stiffness is None:
        expected = force * LENGTH / (YOUNG * AREA)
    else:
        bending = force * LENGTH**3 / (3.0 * YOUNG * AREA * stiffness / 12.0)
        expected = bending + force * LENGTH / (5.0 / 6.0 * SHEAR * AREA)
    assert moved_by @ np.array(direction) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("section", "twist"),
    [
        (RodSectionDescription(shape="rectangle", size=(0.01, 0.005)), 0.2287 * 0.01 * 0.005**3),
        (RodSectionDescription(shape="rectangle", size=(0.005, 0.005)), 0.1406 * 0.005**4),
        (RodSectionDescription(shape="ellipse", size=(0.006, 0.006)), math.pi / 32 * 0.006**4),
        (
            RodSectionDescription(shape="ellipse", size=(0.006, 0.006), wall=0.001),
            math.pi / 32 * (0.006**4 - 0.004**4),
        ),
        (
            RodSectionDescription(
                shape="ellipse", size=(0.006, 0.006), stiffness=(900.0, 300.0, 300.0, 2e-3, 3e-3, 5e-3)
            ),
            5e-3 / SHEAR,
        ),
    ],
)
def test_twist(section: RodSectionDescription, twist: float) -> None:
    """A couple at the free end; constants of Timoshenko and Goodier, table of rectangles."""
    simulation = cantilever(rod(section=section))
    nodes = simulation.positions[-3:] - np.array(STRAIGHT[1])
    around = np.cross(np.array([1.0, 0.0, 0.0]), nodes)
    moment = 1e-5
    simulation.forces[-3:] = moment * around / (around**2).sum()
    turned = simulation.equilibrium().state.positions[-3:] - np.array(STRAIGHT[1])
    angle = (around * (turned - nodes)).sum() / (around**2).sum()
    assert angle == pytest.approx(moment * LENGTH / (SHEAR * twist), rel=2e-3)


def test_layers_bend_when_they_are_pulled() -> None:
    """Composite beam: the neutral line lies where the moduli balance."""
    layers = (
        LayerOfRodDescription(share=0.5, modulus_ratio=1.0),
        LayerOfRodDescription(share=0.5, modulus_ratio=3.0),
    )
    simulation = cantilever(rod(section=replace(RECTANGLE, layers=layers)))
    half, force = 0.5 * THICK, 1e-6
    stretch = YOUNG * WIDE * half * 4.0
    first = YOUNG * WIDE * half * half / 2.0 * (3.0 - 1.0)
    second = YOUNG * WIDE * half**3 / 3.0 * 4.0
    strain, curvature = np.linalg.solve([[stretch, first], [first, second]], [force, 0.0])
    shift = tip(simulation, (force, 0.0, 0.0)) - np.array(STRAIGHT[1])
    assert shift[0] == pytest.approx(strain * LENGTH, rel=1e-3)
    # a fibre at z is stretched by strain + z curvature, so a positive curvature bends it down
    assert shift[2] == pytest.approx(-0.5 * curvature * LENGTH**2, rel=1e-3)


def test_a_taper_bends_as_its_closed_form() -> None:
    """Round, its diameter from a to b: 64 F L^3 / (3 pi E a^3 b), and by shear 4 F L / (k G pi a b)."""
    root, end, force = 0.008, 0.004, 1e-5
    section = RodSectionDescription(shape="ellipse", size=(root, root), end_size=(end, end))
    moved_by = tip(cantilever(rod(section=section, elements=8)), (0.0, 0.0, force))[2]
    bending = 64.0 * force * LENGTH**3 / (3.0 * math.pi * YOUNG * root**3 * end)
    shearing = 4.0 * force * LENGTH / (SHEAR_SHARE["ellipse"] * SHEAR * math.pi * root * end)
    assert moved_by == pytest.approx(bending + shearing, rel=1e-4)


@pytest.mark.parametrize(("beside", "turn"), [(0.0015, 0.5), (0.004, 1.5), (0.01, 3.0)])
@pytest.mark.slow
def test_a_tendon_along_a_rod_bends_it_into_a_circle(beside: float, turn: float) -> None:
    """In it or beside it: the moment T d everywhere turns its end by T d L / EI, and T presses it."""
    routing = tuple((x, 0.0, beside) for x in np.linspace(0.0, LENGTH, 41).tolist())
    tendon = CableDescription(body="rod", points=routing)
    simulation = Simulation(
        SceneDescription(
            name="rod",
            gravity=(0.0, 0.0, 0.0),
            bodies=(body(rod(elements=20)),),
            attachments=(AttachmentDescription(name="clamp", body="rod", to="world", end="start"),),
            joints=(JointDescription(name="tendon", kind="cable", actuator=tendon),),
        ),
        backend="scipy",
    )
    tension = turn * BEND / (LENGTH * beside)
    pressed = tension / (YOUNG * AREA)
    found = simulation.equilibrium([turn * beside + pressed * LENGTH]).state
    radius = LENGTH * (1.0 - pressed) / turn
    circle = radius * np.array([math.sin(turn), 0.0, 1.0 - math.cos(turn)])
    # between its 41 guides the tendon is straight, and somewhat farther from the rod
    assert found.joint_efforts[0] == pytest.approx(tension, rel=0.01)
    assert np.linalg.norm(found.positions[-3:].mean(axis=0) - circle) < 3e-3 * LENGTH


def test_a_compliant_clamp_adds_its_turn() -> None:
    stiff, force = 0.05, 1e-3
    clamp = RodClampDescription(rotation=(stiff, math.inf, math.inf))
    described = rod(start_clamp=clamp)
    reach = 1e-3 * LENGTH
    simulation = Simulation(
        SceneDescription(
            name="rod",
            gravity=(0.0, 0.0, 0.0),
            bodies=(body(described),),
            attachments=(held_at((-reach, 0.0, 0.0)),),
        ),
        backend="scipy",
    )
    bending = force * LENGTH**3 / (3.0 * BEND) + force * LENGTH / (5.0 / 6.0 * SHEAR * AREA)
    turning = force * LENGTH * LENGTH / stiff
    assert tip(simulation, (0.0, 0.0, force))[2] == pytest.approx(bending + turning, rel=2e-3)
    # against bending along the second axis it is as stiff as the rod
    wide = tip(simulation, (0.0, force, 0.0))[1]
    wide_bending = bending_of(WIDE, force)
    assert wide == pytest.approx(wide_bending, rel=5e-3)


@pytest.mark.parametrize("end", ["start", "end"])
@pytest.mark.parametrize("angle", [0.05, 0.2, 0.4])
def test_a_clamp_turns_far_without_getting_shorter(angle: float, end: str) -> None:
    """A rod that is nearly rigid on a soft clamp, at either end: half the stiffness times sin(2 a)."""
    stiff, reach = 0.002, 1e-3 * LENGTH
    clamp = RodClampDescription(rotation=(stiff, math.inf, math.inf))
    described = rod(**{f"{end}_clamp": clamp})
    held = (-reach, 0.0, 0.0) if end == "start" else (LENGTH + reach, 0.0, 0.0)
    simulation = Simulation(
        SceneDescription(
            name="rod",
            gravity=(0.0, 0.0, 0.0),
            bodies=(body(described, young_modulus=1e10),),
            attachments=(held_at(held),),
        ),
        backend="scipy",
    )
    free = slice(-3, None) if end == "start" else slice(0, 3)
    force = 0.5 * stiff * math.sin(2.0 * angle) / (LENGTH * math.cos(angle))
    simulation.forces[free] = (0.0, 0.0, force / 3.0)
    place = simulation.equilibrium().state.positions[free].mean(axis=0)
    hinge = np.array([0.0 if end == "start" else LENGTH, 0.0, 0.0])
    arm = place - hinge
    assert math.atan2(arm[2], abs(arm[0])) == pytest.approx(angle, rel=3e-3)
    assert np.linalg.norm(arm) == pytest.approx(LENGTH, rel=1e-4)


def bending_of(thickness: float, force: float) -> float:
    """Timoshenko's deflection of the cantilever's tip."""
    second = YOUNG * AREA * thickness**2 / 12.0
    return force * LENGTH**3 / (3.0 * second) + force * LENGTH / (5.0 / 6.0 * SHEAR * AREA)


def test_euler_buckling_load() -> None:
    """Southwell 1932: with a small load across, the deflection grows as 1 / (1 - P / P_critical)."""
    critical = math.pi**2 * BEND / (4.0 * LENGTH**2)
    across = 1e-9
    grown = [tip(cantilever(rod(elements=8)), (-part * critical, 0.0, across))[2] for part in (0.5, 0.8)]
    # 1 / deflection falls in a straight line (but for 1 % of higher modes) to zero at the critical load
    inverse = 1.0 / np.array(grown)
    found = 0.5 + 0.3 * inverse[0] / (inverse[0] - inverse[1])
    assert found == pytest.approx(1.0, abs=5e-3)


@pytest.mark.slow
def test_frequencies_of_timoshenko() -> None:
    thick = 0.02
    stocky = rod(section=RodSectionDescription(shape="rectangle", size=(thick, thick)), elements=16)
    model = cantilever(stocky).model
    free = Unknowns(model).free
    k = node_stiffness(model, model.rest_state(), cantilever(stocky).parameters).toarray()
    places = (3 * free[:, None] + np.array([0, 2])).ravel()  # in the plane: bending and stretch
    mass = np.repeat(model.mass[free], 2)
    squares = eigh(k[np.ix_(places, places)], np.diag(mass), eigvals_only=True, subset_by_index=(0, 2))
    area, second, shear = thick**2, thick**4 / 12.0, 5.0 / 6.0 * SHEAR * thick**2

    def remainder(omega: float) -> float:
        """Of deflection, slope, moment, shear force carried along the rod: no load at its free end."""
        along = np.array(
            [
                [0.0, 1.0, 0.0, 1.0 / shear],
                [0.0, 0.0, 1.0 / (YOUNG * second), 0.0],
                [0.0, -DENSITY * second * omega**2, 0.0, -1.0],
                [-DENSITY * area * omega**2, 0.0, 0.0, 0.0],
            ]
        )
        return float(np.linalg.det(expm(LENGTH * along)[2:, 2:]))

    grid = np.linspace(10.0, 3000.0, 1500)
    values = [remainder(each) for each in grid]
    roots = [
        brentq(remainder, a, b)
        for (a, b), (u, v) in zip(pairwise(grid), pairwise(values), strict=True)
        if u * v < 0
    ]
    bending = [math.sqrt(each) for each in squares]
    assert bending[:2] == pytest.approx(roots[:2], rel=2e-3)


def test_it_agrees_with_a_strip_of_quadratic_tetrahedra() -> None:
    force = (0.0, 0.0, 2.0 * BEND / LENGTH**2)
    solid = quadratic(box_mesh((LENGTH, WIDE, THICK), (20, 1, 1)))
    points = solid.points - solid.points.min(axis=0) - np.array([0.0, 0.5 * WIDE, 0.5 * THICK])
    solid = replace(solid, points=points)
    strip = Simulation(
        SceneDescription(
            name="strip",
            gravity=(0.0, 0.0, 0.0),
            bodies=(
                BodyDescription(
                    name="strip",
                    mesh=solid,
                    material=MaterialDescription(
                        law="stable_neo_hookean", young_modulus=YOUNG, poisson_ratio=POISSON
                    ),
                    density=DENSITY,
                ),
            ),
            attachments=(
                AttachmentDescription(
                    name="clamp",
                    body="strip",
                    to="world",
                    sphere=Sphere(center=(0.0, 0.0, 0.0), radius=0.62 * WIDE),
                ),
            ),
        ),
        backend="scipy",
    )
    end = np.flatnonzero(points[:, 0] > LENGTH - 1e-9)
    strip.forces[end] = np.array(force) / len(end)
    held = np.flatnonzero(strip.model.region_of_node == -2)
    assert points[held, 0].max() < 1e-9
    solid_tip = strip.equilibrium().state.positions[end].mean(axis=0)
    rod_tip = tip(cantilever(rod(elements=12)), force)
    assert np.linalg.norm(solid_tip - rod_tip) < 0.01 * abs(rod_tip[2])


def test_masses_and_moments_of_inertia_are_exact() -> None:
    model = cantilever(rod()).model
    mass = DENSITY * AREA * LENGTH
    assert model.mass.sum() == pytest.approx(mass)
    arms = model.rest - np.array([0.5 * LENGTH, 0.0, 0.0])
    moments = (model.mass[:, None, None] * arms[:, :, None] * arms[:, None]).sum(axis=0)
    expected = mass / 12.0 * np.diag([LENGTH**2, WIDE**2, THICK**2])
    assert moments == pytest.approx(expected, rel=1e-9, abs=1e-12 * mass)
