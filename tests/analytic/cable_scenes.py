"""Bars bent by cables, for tests. SI units."""

from __future__ import annotations

from typing import Any

from small_scenes import body, scene, slab

from softsim_core.base import Placement
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import JointDescription, SceneDescription

POINTS = tuple((0.001 + 0.014 * k, 0.0, 0.004) for k in range(7))
"""Along a bar of 0.1 m, 4 mm above its middle."""


def cable_joint(name: str = "tendon", **fields: Any) -> JointDescription:
    """A joint that pulls a cable through POINTS of `bar`."""
    limits = fields.pop("limits", None) or JointLimits(lower=0.0, upper=0.03)
    cable = CableDescription(**{"body": "bar", "points": POINTS, **fields})
    return JointDescription(name=name, kind="cable", limits=limits, actuator=cable)


def bent_bar(
    *joints: JointDescription, tip: bool = False, held: str = "world", **fields: Any
) -> SceneDescription:
    """A bar held at x = 0 with cables; `tip` makes its end a free frame and the effector."""
    mesh = box_mesh((0.1, 0.012, 0.012), (10, 2, 2), (0.0, -0.006, -0.006))
    attachments = [slab("held", held, 0.0, "bar")]
    if tip:
        frame = Placement(translation=(0.1, 0.0, 0.0))
        attachments.append(slab("tip", "free", 0.1, "bar", frame=frame))
    return scene(
        body(mesh, "bar", young_modulus=3e5, total_mass=0.015),
        joints=joints or (cable_joint(),),
        attachments=tuple(attachments),
        effector="tip" if tip else None,
        rayleigh_stiffness=0.02,
        **fields,
    )
