"""A beam from nothing: mesh, body, fixing, simulation, load, steps, equilibrium.

    python examples/beam_from_scratch.py

It is clamped at x = 0 and carries a force at its tip. Linear tetrahedra are too stiff in bending, by a part
that falls with the square of their size; two meshes tell how stiff the beam is without that part.
"""

from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    MaterialDescription,
    SceneDescription,
    Simulation,
    SolverSettings,
    box_mesh,
)

LENGTH_M, WIDTH_M = 0.1, 0.01
YOUNG_MODULUS_PA = 1.0e5
FORCE_N = 1.0e-3


def beam(cells_across: int) -> Simulation:
    """The beam with a number of cells across its width, ready to run, its tip loaded downward."""
    mesh = box_mesh((LENGTH_M, WIDTH_M, WIDTH_M), (5 * cells_across, cells_across, cells_across))
    material = MaterialDescription(young_modulus=YOUNG_MODULUS_PA, poisson_ratio=0.0)
    body = BodyDescription(name="beam", mesh=mesh, material=material, total_mass=0.01)
    clamp = Box(center=(0.0, 0.0, 0.0), size=(1e-6, 1.0, 1.0))
    wall = AttachmentDescription(name="wall", body="beam", to="world", box=clamp)
    solver, weightless = SolverSettings(rayleigh_stiffness=0.05), (0.0, 0.0, 0.0)
    simulation = Simulation(
        SceneDescription(name="beam", gravity=weightless, bodies=(body,), attachments=(wall,), solver=solver)
    )
    tip = simulation.positions[:, 0] > LENGTH_M - 1e-9
    simulation.forces[tip, 2] = -FORCE_N / tip.sum()
    return simulation


def deflection(simulation: Simulation) -> float:
    """How far the tip has gone down, in [m]."""
    tip = simulation.model.rest[:, 0] > LENGTH_M - 1e-9
    return float((simulation.model.rest - simulation.positions)[tip, 2].mean())


def settled_deflection(cells_across: int) -> float:
    """Deflection in [m] at the equilibrium of the beam with that mesh."""
    simulation = beam(cells_across)
    simulation.settle([])
    return deflection(simulation)


def converged_deflection(coarse: float, fine: float) -> float:
    """Deflection in [m] without the mesh's stiffness, from those of a mesh and of one twice as fine."""
    return 3.0 / (4.0 / fine - 1.0 / coarse)


def theory() -> float:
    """Deflection in [m] of a cantilever that bends and shears (Timoshenko), shear modulus E / 2."""
    area, moment = WIDTH_M**2, WIDTH_M**4 / 12.0
    bending = FORCE_N * LENGTH_M**3 / (3.0 * YOUNG_MODULUS_PA * moment)
    return bending + FORCE_N * LENGTH_M / (5.0 / 6.0 * 0.5 * YOUNG_MODULUS_PA * area)


def main() -> None:
    """Let the beam swing down, then settle it on two meshes, and print how far its tip goes."""
    simulation = beam(2)
    while simulation.time < 2.0:
        simulation.step()
    coarse, fine = settled_deflection(2), settled_deflection(4)
    swung = deflection(simulation)
    print(f"after {simulation.time:.1f} s {1e3 * swung:.3f} mm, at rest {1e3 * coarse:.3f} mm")
    converged = converged_deflection(coarse, fine)
    print(f"twice as fine {1e3 * fine:.3f} mm, without the mesh's part {1e3 * converged:.3f} mm")
    print(f"beam theory {1e3 * theory():.3f} mm")


if __name__ == "__main__":
    main()
