"""Small scenes for tests: blocks of tetrahedra with whatever is attached to them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from softsim_core import Simulation
from softsim_core.base import Box, Placement
from softsim_core.physics.mechanics import JointLimits, State
from softsim_core.physics.mesh import TetMesh, boundary, box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CommandSettings,
    JointDescription,
    MaterialDescription,
    RobotDescription,
    SceneDescription,
    SolverSettings,
    StartAnimation,
)

GRAVITY = 9.81
"""In [m/s^2]."""


def jittered(mesh: TetMesh, amount: float, seed: int) -> TetMesh:
    """The same mesh with its inner nodes moved at random by up to `amount` [m] along each axis."""
    rng = np.random.default_rng(seed)
    points = mesh.points.copy()
    inner = np.setdiff1d(np.arange(len(points)), boundary(mesh))
    points[inner] += rng.uniform(-amount, amount, (len(inner), 3))
    return replace(mesh, points=points)


def body(
    mesh: TetMesh,
    name: str = "body",
    young_modulus: float = 1e5,
    poisson_ratio: float = 0.3,
    total_mass: float = 0.01,
) -> BodyDescription:
    """A body of a mesh; Young modulus in [Pa], mass in [kg]."""
    material = MaterialDescription(young_modulus=young_modulus, poisson_ratio=poisson_ratio)
    return BodyDescription(name=name, mesh=mesh, material=material, total_mass=total_mass)


def slab(name: str, to: str, x: float, owner: str = "body", **fields: Any) -> AttachmentDescription:
    """Attach the nodes with that x in [m] (a thin box across the body) to "world", "free" or a joint."""
    box = Box(center=(x, 0.0, 0.0), size=(1e-4, 10.0, 10.0))
    return AttachmentDescription(name=name, body=owner, to=to, box=box, **fields)


def scene(*bodies: BodyDescription, law: str = "polar", **fields: Any) -> SceneDescription:
    """A scene of bodies; damping by the keywords of SolverSettings, the rest of SceneDescription."""
    settings = {key: fields.pop(key) for key in ("rayleigh_stiffness", "rayleigh_mass") if key in fields}
    solver = SolverSettings(rotation=law, **settings)  # type: ignore[arg-type]
    return SceneDescription(name="test", solver=solver, bodies=bodies, **fields)


def machine(law: str = "polar", hexahedra: bool = False, **fields: Any) -> SceneDescription:
    """Two bodies with everything that exists.

    A bridge held at one end, with a prescribed hinge, a compliant hinge and a free frame; a rod with a soft
    fixing, a prescribed slide and a compliant one.
    """
    bridge = box_mesh((0.08, 0.02, 0.01), (8, 2, 1), (0.0, -0.01, 0.0), "bridge", hexahedra=hexahedra)
    rod = box_mesh((0.04, 0.01, 0.01), (4, 1, 1), (0.0, 0.03, 0.0), "rod", hexahedra=hexahedra)
    joints = (
        JointDescription(
            name="hinge",
            base=Placement(translation=(0.08, 0.0, -0.01), rotation_deg=(10.0, 20.0, 30.0)),
            axis=(0.0, 0.6, 0.8),
            slide_axis=(0.8, 0.6, 0.0),
            rest=0.1,
        ),
        JointDescription(
            name="spring_hinge",
            base=Placement(translation=(0.06, 0.01, 0.02)),
            axis=(0.0, 1.0, 0.0),
            stiffness=2.0,
            inertia=1e-5,
        ),
        JointDescription(
            name="slide",
            kind="prismatic",
            base=Placement(translation=(0.04, 0.035, 0.0), rotation_deg=(0.0, 0.0, 15.0)),
            axis=(1.0, 0.0, 0.0),
            stiffness=300.0,
            inertia=0.002,
            rest=-0.002,
        ),
        JointDescription(name="rigid_slide", kind="prismatic", axis=(0.0, 0.0, 1.0)),
    )
    attachments = (
        slab("held", "world", 0.0, "bridge"),
        slab("driven", "hinge", 0.08, "bridge"),
        slab("sprung", "spring_hinge", 0.06, "bridge"),
        slab("middle", "free", 0.03, "bridge", frame=Placement(translation=(0.03, 0.0, 0.0))),
        slab("soft", "world", 0.0, "rod", stiffness=40.0),
        slab("slid", "slide", 0.04, "rod"),
        slab("lifted", "rigid_slide", 0.02, "rod"),
    )
    defaults: dict[str, Any] = {"rayleigh_stiffness": 0.004, "rayleigh_mass": 0.3, "effector": "middle"}
    return scene(
        body(bridge, "bridge", 2e5, 0.4, 0.03),
        body(rod, "rod", 8e4, 0.2, 0.01),
        law=law,
        joints=joints,
        attachments=attachments,
        **(defaults | fields),
    )


def limited(out_of_range: str = "clamp", speed: float = np.inf) -> RobotDescription:
    """A beam on a hinge within -1 .. 0.5 rad."""
    hinge = JointDescription(name="hinge", limits=JointLimits(-1.0, 0.5, speed), axis=(0.0, 1.0, 0.0))
    beam = body(box_mesh((0.03, 0.01, 0.01), (3, 1, 1)))
    return RobotDescription(
        scene=scene(beam, joints=(hinge,), attachments=(slab("root", "hinge", 0.0),)),
        poses={"up": (0.4,)},
        start=StartAnimation(pose="up", duration=0.05, base_shift=0.02),
        commands=CommandSettings(out_of_range=out_of_range),  # type: ignore[arg-type]
    )


def shaken(sim: Simulation, steps: int, seed: int) -> None:
    """Random commands, pulls and base shifts."""
    rng = np.random.default_rng(seed)
    for step in range(steps):
        if step % 7 == 0:
            sim.command(rng.uniform(-0.02, 0.02, len(sim.joint_names)))
            sim.forces[:] = rng.normal(scale=0.01, size=sim.forces.shape)
            sim.base_shift = rng.uniform(-0.002, 0.002)
        sim.step()


def comes_back_bit_for_bit(simulation: Simulation, steps: int = 5) -> bool:
    """Whether what follows a snapshot is the same bytes each time it is gone back to, and not what it was."""
    saved, runs = simulation.snapshot(), []
    for _ in range(2):
        simulation.restore(saved)
        for _ in range(steps):
            simulation.step()
        runs.append(simulation.snapshot())
    return runs[0] == runs[1] != saved


QUANTITIES = (
    "positions",
    "velocities",
    "frame_positions",
    "frame_rotations",
    "reduced_velocities",
    "joint_positions",
    "joint_efforts",
    "base_positions",
    "base_shift",
)


def assert_same(fast: State, readable: State, tolerance: float) -> None:
    """Equal, relative to the largest entry of each quantity or 1e-3 of its unit."""
    for quantity in QUANTITIES:
        expected = getattr(readable, quantity)
        scale = np.abs(expected).max(initial=1e-3)
        np.testing.assert_allclose(
            getattr(fast, quantity), expected, rtol=0, atol=tolerance * scale, err_msg=quantity
        )
