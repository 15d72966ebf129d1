"""What a scene is: typed, immutable, SI. YAML files and Python scenes both end here; the builder starts here.

Angles of placements are in degrees in fields named `*_deg` (people write them); the rest is SI and radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from softsim_core.contact.settings import ContactSettings
from softsim_core.errors import SceneError
from softsim_core.fem.materials import Material
from softsim_core.scene.attachment import AttachmentDescription
from softsim_core.scene.deformable import BodyDescription
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.material_region import MaterialRegionDescription
from softsim_core.scene.objects import CollisionDescription, RigidBodyDescription
from softsim_core.scene.solver_settings import SolverSettings
from softsim_core.sensing.description import (
    ANY_BODY,
    PLACE,
    SOFT_BODY,
    SimulatedSensorDescription,
    need_sensors,
)
from softsim_core.values import FieldError, Vector, need_finite, need_positive
from softsim_core.wrong_names import known_names

SHORTEST_STEP, LONGEST_STEP = 1e-9, 1e9
"""Allowed time steps in [s]: a shorter one would never get anywhere, a longer one is no step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneDescription:
    """What is simulated: bodies, what holds and moves them, what they touch; see the fields' types.

    Attributes:
        name: What messages call it.
        dt: Time step in [s], from 1e-9 to 1e9.
        gravity: In [m/s^2].
        solver: Numerics.
        bodies: Deformable bodies.
        joints: Degrees of freedom that are driven, in command order.
        attachments: Regions of bodies that move rigidly.
        rigid_bodies: Rigid bodies, free and carried.
        collisions: Surfaces that touch others.
        contact: How contact is found and solved.
        effector: Name of the free attachment whose pose is the end effector's; None: there is none.
        sensors: What measures; each of one of the kinds in `softsim_core.sensing`, which `kind` names.
    """

    name: str
    dt: float = 0.01
    gravity: Vector = (0.0, 0.0, -9.81)
    solver: SolverSettings = SolverSettings()
    bodies: tuple[BodyDescription, ...] = ()
    joints: tuple[JointDescription, ...] = ()
    attachments: tuple[AttachmentDescription, ...] = ()
    rigid_bodies: tuple[RigidBodyDescription, ...] = ()
    collisions: tuple[CollisionDescription, ...] = ()
    contact: ContactSettings = ContactSettings()
    effector: str | None = None
    sensors: tuple[SimulatedSensorDescription, ...] = ()

    def __post_init__(self) -> None:
        need_positive(f"scene {self.name}", "dt", self.dt, "s")
        if not SHORTEST_STEP <= self.dt <= LONGEST_STEP:
            raise FieldError(f"scene {self.name}", "dt", self.dt, f"{SHORTEST_STEP:g} to {LONGEST_STEP:g} s")
        need_finite(f"scene {self.name}", "gravity", self.gravity)
        for kind, names in (
            ("body", self.body_names),
            ("joint", self.joint_names),
            ("attachment", [attachment.name for attachment in self.attachments]),
            ("collision", [collision.name for collision in self.collisions]),
            ("sensor", [sensor.name for sensor in self.sensors]),
        ):
            for name in names:
                if list(names).count(name) > 1:
                    raise SceneError(f"scene {self.name}: two of kind {kind} are called {name}")
        self._check_references()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the deformable bodies, then of the rigid ones."""
        return (*(body.name for body in self.bodies), *(body.name for body in self.rigid_bodies))

    @property
    def materials(self) -> tuple[tuple[str, Mapping[str, float]], ...]:
        """What has parameters of a law, and their values: bodies, then `BODY.PART` of each; see `parts`."""
        return (
            *((body.name, body.material.values) for body in self.bodies),
            *((f"{body.name}.{each.name}", each.values) for body in self.bodies for each in body.parts),
        )

    @property
    def laws(self) -> tuple[Material, ...]:
        """The laws of `materials`, in the same order."""
        return (
            *(body.material.law_for(self.solver.rotation) for body in self.bodies),
            *(
                each.material.law_for(self.solver.rotation)
                if isinstance(each, MaterialRegionDescription)
                else each.law
                for body in self.bodies
                for each in body.parts
            ),
        )

    def parameter_prefix(self, owner: str) -> str:
        """What stands before the names of parameters of an owner in `materials`, where all have names."""
        if len(self.bodies) > 1:
            return f"{owner}."
        only = self.bodies[0].name if self.bodies else ""
        return "" if owner == only else f"{owner.removeprefix(f'{only}.')}."

    def _check_references(self) -> None:
        bodies, joints = [body.name for body in self.bodies], self.joint_names
        frames = [joint.name for joint in self.joints if joint.moves_frame]
        free = [attachment.name for attachment in self.attachments if attachment.to == "free"]

        def known(what: str, name: str | None, names: list[str] | tuple[str, ...]) -> None:
            if name is not None and name not in names:
                raise SceneError(f"scene {self.name}: unknown {what} {name!r}; {known_names(name, names)}")

        for j, each in enumerate(self.joints):
            what = f"parent of joint {each.name} (a revolute or prismatic joint before it)"
            known(what, each.parent, [name for name in frames if name in joints[:j]])
        for attachment in self.attachments:
            known("body", attachment.body, bodies)
            known("attachment target", attachment.to, ("world", "free", *frames, *free))
            known("joint", attachment.relative_to, frames)
        for each in self.joints:
            if each.actuator is not None:
                for field_name, name in each.actuator.bodies().items():
                    known(f"{field_name} of {each.kind} {each.name}", name, bodies)
                for field_name, name in each.actuator.carriers().items():
                    known(f"{field_name} of {each.kind} {each.name}", name, frames)
        bases = [f"{name}_base" for name in frames]
        for rigid in self.rigid_bodies:
            known(f"carrier of rigid body {rigid.name}", rigid.on, ("world", *free, *frames, *bases))
        for collision in self.collisions:
            known(f"body of collision {collision.name}", collision.body, self.body_names)
        touching = [*self.body_names, *(collision.name for collision in self.collisions)]
        for entry in self.contact.friction_pairs:
            for name in entry.between:
                known("collision surface or body of contact.friction_pairs", name, touching)
        rods = [body.name for body in self.bodies if body.rod is not None]
        for attachment in self.attachments:
            if attachment.end is not None:
                known(f"body with an end (a rod) of attachment {attachment.name}", attachment.body, rods)
        known("effector (an attachment with to = free)", self.effector, free)
        places = (*(each.name for each in self.attachments), *(each.name for each in self.rigid_bodies))
        names = {ANY_BODY: self.body_names, SOFT_BODY: bodies, PLACE: ("world", *places, *frames, *bases)}
        names |= {
            joint.kind: [each.name for each in self.joints if each.kind == joint.kind]
            for joint in self.joints
        }
        need_sensors(self.name, self.dt, self.sensors, names)
