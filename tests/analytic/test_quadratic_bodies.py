"""Quadratic tetrahedra: bending, torsion, nearly incompressible matter, and one linear solve per step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from contact_scenes import DISTANCE, FLOOR, touching
from scipy.integrate import simpson, solve_bvp
from scipy.sparse.linalg import spsolve
from small_scenes import body, comes_back_bit_for_bit, jittered, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, Placement
from softsim_core.physics.dynamics import solve_static
from softsim_core.physics.fem import elastic_forces, stiffness_matrix
from softsim_core.physics.fem.elements import TET10
from softsim_core.physics.mechanics import FIXED, Control, rotation_exp
from softsim_core.physics.mesh import TetMesh, box_mesh, quadratic
from softsim_core.scene import (
    BodyDescription,
    JointDescription,
    MaterialDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.scene.building import build

BEAM, CELLS, YOUNG = (0.1, 0.03, 0.03), (6, 2, 2), 263.8e3
LAWS = ("corotational", "stable_neo_hookean", "yeoh")


def made_of(law: str, poisson_ratio: float, young_modulus: float = YOUNG) -> MaterialDescription:
    if law == "yeoh":
        c1 = young_modulus / (4.0 * (1.0 + poisson_ratio))
        return MaterialDescription(law=law, c1=c1, poisson_ratio=poisson_ratio)
    return MaterialDescription(law=law, young_modulus=young_modulus, poisson_ratio=poisson_ratio)


def silicone(mesh: TetMesh, material: MaterialDescription, density: float = 1070.0) -> BodyDescription:
    return BodyDescription(name="body", mesh=mesh, order=2, material=material, density=density)


def cantilever(
    material: MaterialDescription, cells: tuple[int, int, int] = CELLS, **fields: object
) -> SceneDescription:
    beam = silicone(box_mesh(BEAM, cells), material)
    weight = (0.0, 0.0, -9.80709)
    return scene(beam, attachments=(slab("clamp", "world", 0.0),), gravity=weight, **fields)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("poisson_ratio", "sag"), [(0.45, 6.888e-3), (0.49, 6.821e-3), (0.499, 6.805e-3)])
def test_a_beam_of_325_nodes_sags_as_the_finest_mesh(law: str, poisson_ratio: float, sag: float) -> None:
    """Within 1 % of 15 895 nodes, in four iterations; linear cells of 1029 nodes miss by 10 to 19 %."""
    simulation = Simulation(cantilever(made_of(law, poisson_ratio)))
    rest = simulation.model.rest
    solved = simulation.equilibrium()
    tip = np.isclose(rest[:, 0], BEAM[0])
    assert len(rest) == 325
    assert -(solved.state.positions - rest)[tip, 2].mean() == pytest.approx(sag, rel=0.01)
    assert solved.iterations <= 5


@pytest.mark.parametrize(("young_modulus", "most"), [(2e4, 12), (1e4, 16)])
def test_nearly_incompressible_rubber_hangs_down_in_few_iterations(young_modulus: float, most: int) -> None:
    """9 and 12; 88 and 156 where the equilibrium of Hooke's law gave the cells a large pressure."""
    solved = Simulation(cantilever(made_of("yeoh", 0.499, young_modulus))).equilibrium()
    assert solved.load_steps == 1
    assert solved.iterations <= most


def test_the_shipped_beam_sags_so() -> None:
    simulation = Simulation(load_scene("cantilever_quadratic"))
    moved = simulation.equilibrium().state.positions - simulation.model.rest
    tip = np.isclose(simulation.model.rest[:, 0], BEAM[0])
    assert moved[tip, 2].mean() == pytest.approx(-6.805e-3, rel=0.01)


@pytest.mark.slow
def test_torsion_does_not_lock() -> None:
    """The tip turned by 60 degrees; the moment of the finest mesh is 106.8 N mm, linear cells say 200."""
    turned = JointDescription(
        name="turn", base=Placement(translation=(0.0, BEAM[1] / 2.0, BEAM[2] / 2.0)), axis=(1.0, 0.0, 0.0)
    )
    clamps = slab("clamp", "world", 0.0), slab("tip", "turn", BEAM[0])
    beam = silicone(box_mesh(BEAM, CELLS), made_of("stable_neo_hookean", 0.499))
    simulation = Simulation(scene(beam, joints=(turned,), attachments=clamps, gravity=(0.0, 0.0, 0.0)))
    moment = simulation.equilibrium([np.pi / 3.0]).state.joint_efforts[0]
    assert moment == pytest.approx(0.1068, rel=0.05)


def test_a_bonded_block_that_is_pressed_does_not_lock() -> None:
    """30 x 30 x 10 mm pressed by 5 % between plates that it sticks to: 30.2 N; linear cells say 63."""
    size, pressed = (0.01, 0.03, 0.03), JointDescription(name="press", kind="prismatic", axis=(1.0, 0.0, 0.0))
    clamps = slab("clamp", "world", 0.0), slab("plate", "press", size[0])
    block = silicone(box_mesh(size, (2, 4, 4)), made_of("stable_neo_hookean", 0.499))
    simulation = Simulation(scene(block, joints=(pressed,), attachments=clamps, gravity=(0.0, 0.0, 0.0)))
    assert len(simulation.positions) == 405
    force = simulation.equilibrium([-0.0005]).state.joint_efforts[0]
    assert -force == pytest.approx(30.2, rel=0.05)


@pytest.mark.slow
def test_a_slender_strip_bends_as_the_elastica() -> None:
    """A load at the tip that turns it by 53 degrees: tip within 0.5 %, Poisson ratio 0."""
    length, side, young, pull = 0.1, 0.002, 1e6, 2.0
    force = pull * young * side**4 / 12.0 / length**2
    strip = silicone(box_mesh((length, side, side), (30, 1, 1)), made_of("corotational", 0.0, young))
    simulation = Simulation(scene(strip, attachments=(slab("clamp", "world", 0.0),), gravity=(0.0, 0.0, 0.0)))
    rest = simulation.model.rest
    tip = np.isclose(rest[:, 0], length)
    shares = simulation.model.mass * tip
    simulation.forces[:, 2] = -force * shares / shares.sum()
    moved = (simulation.equilibrium().state.positions - rest)[tip].mean(axis=0)

    def slope(s: Array, y: Array) -> Array:  # angle and curvature over the length
        return np.stack([y[1], -pull * np.cos(y[0])])

    def ends(at_clamp: Array, at_tip: Array) -> Array:
        return np.array([at_clamp[0], at_tip[1]])

    s = np.linspace(0.0, 1.0, 201)
    angle = solve_bvp(slope, ends, s, np.stack([-s, 0.0 * s]), tol=1e-9).sol(s)[0]
    across, along = (length * simpson(each, x=s) for each in (np.sin(angle), np.cos(angle) - 1.0))
    assert -moved[2] == pytest.approx(across, rel=5e-3)
    assert moved[0] == pytest.approx(along, rel=1e-2)


def error_of(order: int, cells: int) -> float:
    """Root mean square error of the nodes inside; on the boundary a field in equilibrium is prescribed."""
    block = jittered(box_mesh((1.0, 1.0, 1.0), (cells,) * 3), 0.1 / cells, seed=3)
    described = replace(body(block, poisson_ratio=0.3), order=order)
    built = build(scene(described, gravity=(0.0, 0.0, 0.0)))
    rest = built.model.rest
    x, y, z = rest.T
    field = np.stack([x**3 - 3.0 * x * y**2, y**3 - 3.0 * y * x**2, 0.0 * z], axis=1)  # of Re (x + i y)^4 / 4
    field += np.stack(
        [y**3 * z - y * z**3, 3.0 * x * y**2 * z - x * z**3, x * y**3 - 3.0 * x * y * z**2], axis=1
    )
    exact = rest + 1e-7 * field
    outside = (np.isclose(rest, 0.0) | np.isclose(rest, 1.0)).any(axis=1)
    region = np.where(outside, FIXED, built.model.region_of_node)
    model = replace(built.model, region_of_node=region)
    state = model.rest_state()
    state.positions[:] = np.where(outside[:, None], exact, rest)
    still = Control(np.zeros(0), np.zeros_like(rest))
    solved = solve_static(model, state, still, built.parameters, tolerance=1e-15).state.positions
    return float(np.sqrt(((solved - exact) ** 2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize(("order", "rate", "sizes"), [(1, 1.6, (6, 12)), (2, 2.6, (3, 6))])
def test_the_error_falls_with_the_power_of_the_cell_size(
    order: int, rate: float, sizes: tuple[int, int]
) -> None:
    coarse, fine = (error_of(order, cells) for cells in sizes)
    assert np.log(coarse / fine) / np.log(sizes[1] / sizes[0]) > rate


@pytest.mark.slow
def test_cooks_membrane() -> None:
    """A tapered panel clamped left, sheared right, in plane stress: its tip rises by 23.96 F / (E t)."""
    young, scale, pull = 1e6, 1e-3, 1e-6
    flat = box_mesh((48.0, 1.0, 1.0), (8, 1, 8))
    x, y, z = flat.points.T
    points = scale * np.stack([x, y, 44.0 / 48.0 * x * (1.0 - z) + (44.0 + x / 3.0) * z], axis=1)
    panel = silicone(TetMesh(points, flat.tets), made_of("corotational", 1.0 / 3.0, young))
    simulation = Simulation(scene(panel, attachments=(slab("clamp", "world", 0.0),), gravity=(0.0, 0.0, 0.0)))
    rest, mesh = simulation.model.rest, simulation.bodies[0].mesh
    load = np.zeros(len(rest))
    for face in TET10.faces:  # a uniform load is carried by the middles of the edges, a third each
        nodes = mesh.tets[:, face]
        on_edge = np.isclose(rest[nodes[:, :3], 0], 48.0 * scale).all(axis=1)
        corners = rest[nodes[on_edge, :3]]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        np.add.at(load, nodes[on_edge, 3:], np.linalg.norm(sides, axis=1)[:, None] / 6.0)
    assert load.sum() == pytest.approx(16.0 * scale**2)
    simulation.forces[:, 2] = young * scale * pull * load / load.sum()
    moved = (simulation.equilibrium().state.positions - rest)[:, 2]
    middle = np.argmin(((rest - scale * np.array([48.0, 0.5, 52.0])) ** 2).sum(axis=1))
    assert moved[middle] == pytest.approx(23.96 * pull, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["stable_neo_hookean", "corotational"])
def test_one_linear_solve_per_step_is_the_converged_step(law: str) -> None:
    """The beam let go at nu = 0.499, swing of 9 mm: within 0.15 mm of implicit Euler solved to the end."""
    simulation = Simulation(cantilever(made_of(law, 0.499), (3, 1, 1)), backend="scipy")
    model, parameters = simulation.model, simulation.parameters
    free = np.repeat(model.region_of_node != FIXED, 3)
    mass = np.repeat(model.mass, 3)[free]
    x, v, h = model.rest.copy(), np.zeros_like(model.rest), model.dt
    worst, swing = 0.0, 0.0
    for _ in range(40):
        start, momentum = x.copy(), mass * v.ravel()[free]
        x = start + h * v
        for _ in range(20):
            force = (
                elastic_forces(model.groups, x, parameters.materials) + model.mass[:, None] * model.gravity
            )
            rest = momentum + h * force.ravel()[free] - mass * (x - start).ravel()[free] / h
            matrix = (
                sp.diags(mass / h)
                + h * stiffness_matrix(model.groups, x, parameters.materials)[free][:, free]
            )
            step = spsolve(matrix.tocsc(), rest)
            x.ravel()[free] += step
            if np.abs(step).max() < 1e-10:
                break
        v = (x - start) / h
        simulation.step()
        assert simulation.report.positive
        worst = max(worst, float(np.linalg.norm(simulation.positions - x, axis=1).max()))
        swing = max(swing, float(np.abs(x - model.rest).max()))
    assert swing > 8e-3
    assert worst < 1.5e-4


@pytest.mark.numba
def test_both_back_ends_move_alike_and_a_snapshot_brings_all_back() -> None:
    pytest.importorskip("numba")
    description = cantilever(made_of("yeoh", 0.499), (3, 1, 1))
    ours, theirs = Simulation(description, backend="numba"), Simulation(description, backend="scipy")
    for _ in range(30):
        ours.step()
        theirs.step()
    np.testing.assert_allclose(ours.positions, theirs.positions, atol=1e-9)
    assert comes_back_bit_for_bit(ours)


def test_a_beam_struck_hard_stays_finite(backend: str) -> None:
    """Ecoflex at 5 m/s along its axis, half its length per step: what is not positive is made so."""
    beam = replace(
        silicone(box_mesh(BEAM, (3, 1, 1)), made_of("stable_neo_hookean", 0.499, 6e4)),
        velocity=(-5.0, 0.0, 0.0),
    )
    settings = SolverSettings(backend=backend)  # type: ignore[arg-type]
    simulation = Simulation(replace(scene(beam, attachments=(slab("clamp", "world", 0.0),)), solver=settings))
    for _ in range(60):
        simulation.step()
    assert np.abs(simulation.positions - simulation.model.rest).max() < 0.1
    settled = simulation.equilibrium().state.positions
    for _ in range(300):
        simulation.step()
    np.testing.assert_allclose(simulation.positions, settled, atol=1e-3)


def tilted_cube(seed: int, law: str) -> BodyDescription:
    """A soft one of 30 mm, 0.1 m above the floor: in the step that touches first it falls by 13 mm."""
    rng, side = np.random.default_rng(seed), 0.03
    block = box_mesh((side,) * 3, (2, 2, 2))
    turned = (block.points - side / 2.0) @ rotation_exp(rng.uniform(-1.5, 1.5, 3)).T
    turned[:, 2] += 0.1 - turned[:, 2].min()
    poisson_ratio = 0.45 if law == "corotational" else 0.499
    return silicone(TetMesh(turned, block.tets), made_of(law, poisson_ratio, 3e4), density=1000.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 11])
@pytest.mark.parametrize("law", LAWS)
def test_tilted_cubes_land_and_lie_still(law: str, seed: int) -> None:
    described = touching(FLOOR, soft=(tilted_cube(seed, law),), rayleigh_stiffness=0.002)
    simulation, least, parts = Simulation(described), np.inf, []
    for _ in range(200):
        simulation.step()
        least = min(least, float(simulation.contacts.gaps.min(initial=np.inf)))
        parts.append(simulation.report.parts)
    assert parts[-1] == 1
    assert least > -1e-5
    assert np.abs(simulation.velocities).max() < 1e-3
    assert DISTANCE - 1e-5 < simulation.positions[:, 2].min() < DISTANCE + 1e-5


def test_steps_stay_whole_where_the_scene_says_so() -> None:
    described = touching(FLOOR, soft=(tilted_cube(0, "stable_neo_hookean"),), rayleigh_stiffness=0.002)
    whole = Simulation(replace(described, solver=replace(described.solver, substeps=1)))
    for _ in range(20):
        whole.step()
        assert whole.report.parts == 1


def test_mass_is_that_of_the_volume_and_its_middle_is_right() -> None:
    beam = silicone(jittered(box_mesh(BEAM, CELLS), 0.002, seed=1), made_of("corotational", 0.3))
    model = build(scene(beam)).model
    assert (model.mass > 0.0).all()
    assert model.mass.sum() == pytest.approx(1070.0 * np.prod(BEAM))
    np.testing.assert_allclose(model.mass @ model.rest / model.mass.sum(), np.array(BEAM) / 2.0, atol=1e-9)


def test_a_mesh_of_order_2_is_taken_as_it_is_and_order_1_leaves_its_edges_out() -> None:
    mesh = quadratic(box_mesh(BEAM, (3, 1, 1)))
    counts = {}
    for order in (None, 1, 2):
        described = replace(silicone(mesh, made_of("corotational", 0.3)), order=order)
        counts[order] = build(scene(described)).model.groups[0].cells.shape[1]
    assert counts == {None: 10, 1: 4, 2: 10}
