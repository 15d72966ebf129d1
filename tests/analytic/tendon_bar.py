"""A hanging soft bar whose slowest mode is slow, pulled by two to twenty parallel tendons."""

from __future__ import annotations

import dataclasses

import numpy as np

from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    CableDescription,
    JointDescription,
    JointLimits,
    MaterialDescription,
    Placement,
    SceneDescription,
    SolverSettings,
    box_mesh,
)

LENGTH = 0.3
"""Of the bar in [m]."""


def tendon_bar(
    tendons: int, dt: float, *, young_modulus: float = 4e5, layers: int = 12, same: bool = False
) -> SceneDescription:
    """The bar along +z, which is down; its tip is the effector.

    Args:
        tendons: How many; the first four end at the tip, further ones half way.
        dt: In [s].
        young_modulus: In [Pa].
        layers: Of cells along it.
        same: All tendons have the route of the first.
    """
    mesh = box_mesh((0.04, 0.04, LENGTH), (2, 2, layers))
    points = np.asarray(mesh.points)
    middle = np.array([points[:, 0].mean(), points[:, 1].mean(), points[:, 2].min()])
    mesh = dataclasses.replace(mesh, points=points - middle)
    joints = []
    for k in range(tendons):
        place = 0 if same else k
        angle = np.pi / 2 * (place % 4) + 0.3 * (place // 4)
        end = 0.295 if place < 4 else 0.15
        x, y = float(0.015 * np.cos(angle)), float(0.015 * np.sin(angle))
        route = tuple((x, y, float(z)) for z in np.linspace(0.01, end, 8))
        cable = CableDescription(body="bar", points=route, pull_point=(x, y, -0.02))
        limits = JointLimits(lower=0.0, upper=0.05, speed=0.05)
        joints.append(JointDescription(name=f"tendon_{k}", kind="cable", limits=limits, actuator=cable))
    whole = (1.0, 1.0, 1e-4)
    silicone = MaterialDescription(young_modulus=young_modulus, poisson_ratio=0.45)
    base = Box(center=(0.0, 0.0, 0.0), size=whole)
    tip = Box(center=(0.0, 0.0, LENGTH), size=whole)
    frame = Placement(translation=(0.0, 0.0, LENGTH))
    return SceneDescription(
        name="bar", dt=dt, gravity=(0.0, 0.0, 9.81), joints=tuple(joints), effector="tip",
        bodies=(BodyDescription(name="bar", mesh=mesh, material=silicone, density=1100.0),),
        attachments=(
            AttachmentDescription(name="base", body="bar", to="world", box=base),
            AttachmentDescription(name="tip", body="bar", to="free", box=tip, frame=frame),
        ),
        solver=SolverSettings(rayleigh_stiffness=0.01),
    )  # fmt: skip
