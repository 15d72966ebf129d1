"""The description of a scene: typed, immutable, SI. YAML files and Python scenes are both converted to it.

Angles of placements are in degrees, in fields named `*_deg`, for readability. Everything else is in SI and
radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias, get_args

from softsim_core.base import (
    DIRECTION,
    Backend,
    Box,
    FieldError,
    MeshFile,
    Placement,
    SceneError,
    Vector,
    known_names,
    listing,
    need_finite,
    need_not_negative,
    need_positive,
    one_of,
)
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.fem.materials import Material
from softsim_core.physics.linalg import AUTO, linear_solver_names
from softsim_core.physics.mesh import Shape
from softsim_core.physics.sensing import (
    ANY_BODY,
    PLACE,
    SOFT_BODY,
    SimulatedSensorDescription,
    need_sensors,
)
from softsim_core.scene.deformable import AttachmentDescription, BodyDescription, MaterialRegionDescription
from softsim_core.scene.joint import JointDescription

Colour = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigidBodyDescription:
    """A rigid body: free (with a mass), or carried by the world, a free frame or a joint (without).

    Attributes:
        name: Unique among all bodies.
        shape: Its surface.
        mass: Mass in [kg], > 0, of a free body; None: it is carried by `on`.
        inertia: Principal moments in [kg m^2] about the axes of its frame; None: those of a solid of uniform
            density.
        pose: Start pose in the world, or in the frame of `on` (its scale is not used).
        velocity, angular_velocity: Start velocity of a free body's centre of mass in [m/s] and its angular
            velocity in [rad/s], world axes.
        on: Carrier of a body without mass: "world", the name of a free frame (an attachment with to = free),
            or of a joint (the frame that the joint moves), or JOINT_base (the joint's base).
        colour: Red, green, blue, alpha in 0..1, for pictures only.
    """

    name: str
    shape: Shape
    mass: float | None = None
    inertia: Vector | None = None
    pose: Placement = Placement()
    velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata=DIRECTION)
    angular_velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata=DIRECTION)
    on: str = "world"
    colour: Colour = (0.9, 0.7, 0.2, 1.0)

    def __post_init__(self) -> None:
        owner = f"rigid body {self.name}"
        if self.mass is not None:
            need_positive(owner, "mass", self.mass, "kg")
            if self.on != "world":
                raise SceneError(f"{owner}: a body with mass moves by itself; remove `on` or `mass`")
            if self.shape.plane is not None:
                raise SceneError(f"{owner}: a plane has no volume, so it takes no mass; remove `mass`")
        need_finite(owner, "velocity", self.velocity)
        need_finite(owner, "angular_velocity", self.angular_velocity)
        if self.mass is None and any((*self.velocity, *self.angular_velocity)):
            raise SceneError(
                f"{owner}: what carries a body without mass moves it; remove `velocity` and "
                "`angular_velocity`, or give a `mass`"
            )
        if self.inertia is not None:
            for moment in self.inertia:
                need_positive(owner, "inertia", moment, "kg m^2")


@dataclass(frozen=True, slots=True, kw_only=True)
class CollisionDescription:
    """A surface that touches others.

    Two surfaces that share a group never touch; a surface without group touches all others. Surfaces of one
    body touch only if each has groups and none in common (self-contact).

    Attributes:
        name: Unique name.
        body: Name of a deformable or rigid body.
        surface: A surface that follows the body; None: the boundary of the tetrahedra, or the rigid shape.
        boxes: Only the triangles with all corners in one of these boxes (rest shape); none: all.
        faces: Only those of a physical group of faces of the body's Gmsh file; None: all.
        groups: Names of the groups it belongs to.
    """

    name: str
    body: str
    surface: MeshFile | None = None
    boxes: tuple[Box, ...] = ()
    faces: str | None = None
    groups: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.faces is not None and (self.boxes or self.surface is not None):
            raise SceneError(
                f"collision {self.name}: `faces` names all of its triangles; remove `boxes` and `surface`, "
                "or `faces`"
            )


RotationLaw: TypeAlias = Literal["polar", "qr"]
TimeIntegration: TypeAlias = Literal["implicit_euler", "bossak"]
Threads: TypeAlias = Literal["auto"] | int
SUBSTEPS: Final = (1, 2, 4, 8, 16, 32, 64)
MOST_THREADS: Final = 64
MOST_ITERATIONS: Final = 1000
_TOLERANCE, _LARGE = 1.0e-7, 0.1
"""Default of `iteration_tolerance` in [m], and extent in [m] of the bodies below which it is scaled down."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """Numerics: default law of bodies, implementation of the step, Rayleigh damping.

    Attributes:
        rotation: Law of bodies whose material names none: "polar" is corotational (survives inversion), "qr"
            is corotational_qr (parity with the reference simulator).
        backend: "numba" (fast), "scipy" (readable reference) or "auto" (numba where it imports).
        linear_solver: Name of the solver for the linear systems of step and statics, see linalg.solvers;
            "auto" leaves the choice to the suite. A solver that the compiled step does not include runs with
            plain assembly.
        threads: Threads of the compiled step of a large mesh, some 3000 nodes and more: 1 to 64, or "auto":
            the value of OMP_NUM_THREADS, else the number of cores of the process. The states are bit by bit
            the same.
        rayleigh_stiffness: Damping per stiffness in [s], >= 0.
        rayleigh_mass: Damping per mass in [1/s], >= 0.
        time_integration: "implicit_euler", or "bossak", of second order, for realistic oscillations; see
            dynamics.schemes.
        spectral_radius: For "bossak": factor by which each step multiplies the highest frequencies, 0 to 1.
        substeps: Largest number of parts of a step where rubber or a quadratic cell strains too much for one,
            or surfaces come too close in one: 1 (always whole), 2, 4 and so on up to 64.
        iterations: Largest number of Newton iterations of a step, 1 to 1000; with 1 it is linearised once.
            "bossak" uses at least 2 for an unsupported body: linearised once, its rotation would gain energy.
        iteration_tolerance: The iterations end once one has moved no node farther than this, in [m], >= 0.
            None: 1e-7, scaled down in proportion if the deformable bodies are smaller than 0.1 m.
    """

    rotation: RotationLaw = "polar"
    backend: Backend = "auto"
    linear_solver: str = AUTO
    threads: Threads = "auto"
    rayleigh_stiffness: float = 0.0
    rayleigh_mass: float = 0.0
    time_integration: TimeIntegration = "implicit_euler"
    spectral_radius: float = 0.8
    substeps: int = 8
    iterations: int = 1
    iteration_tolerance: float | None = None

    def __post_init__(self) -> None:
        need_not_negative("solver", "rayleigh_stiffness", self.rayleigh_stiffness, "s")
        need_not_negative("solver", "rayleigh_mass", self.rayleigh_mass, "1/s")
        if self.time_integration not in get_args(TimeIntegration):
            allowed = one_of(self.time_integration, get_args(TimeIntegration))
            raise FieldError("solver", "time_integration", self.time_integration, allowed)
        if not 0.0 <= self.spectral_radius <= 1.0:
            raise FieldError("solver", "spectral_radius", self.spectral_radius, "between 0 and 1")
        if self.substeps not in SUBSTEPS:
            raise FieldError("solver", "substeps", self.substeps, f"one of {listing(SUBSTEPS)}")
        if not 1 <= self.iterations <= MOST_ITERATIONS:
            raise FieldError("solver", "iterations", self.iterations, f"1 to {MOST_ITERATIONS}")
        if self.iteration_tolerance is not None:
            need_not_negative("solver", "iteration_tolerance", self.iteration_tolerance, "m")
        solvers = (AUTO, *linear_solver_names())
        if self.linear_solver not in solvers:
            allowed = one_of(self.linear_solver, solvers)
            raise FieldError("solver", "linear_solver", self.linear_solver, allowed)
        if self.threads != "auto" and not 1 <= self.threads <= MOST_THREADS:
            raise FieldError("solver", "threads", self.threads, f"auto, or 1 to {MOST_THREADS}")

    def last_move(self, size: float) -> float:
        """Return how far in [m] the last iteration may move a node; the bodies' extent is `size` in [m]."""
        if self.iteration_tolerance is not None:
            return self.iteration_tolerance
        return _TOLERANCE * min(1.0, size / _LARGE)


SHORTEST_STEP, LONGEST_STEP = 1e-9, 1e9
"""Allowed time steps in [s]: a shorter one would never finish, a longer one is not meaningful."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneDescription:
    """The simulated scene: bodies, their supports and drives, and contact; see the fields' types.

    Attributes:
        name: Name in messages.
        dt: Time step in [s], from 1e-9 to 1e9.
        gravity: In [m/s^2].
        solver: Numerics.
        bodies: Deformable bodies.
        joints: Driven degrees of freedom, in command order.
        attachments: Regions of bodies that move rigidly.
        rigid_bodies: Rigid bodies, free and carried.
        collisions: Surfaces that touch others.
        contact: Detection and solution of contact.
        effector: Name of the free attachment whose pose is the end effector's; None: there is none.
        sensors: Sensors, each of one of the kinds in `softsim_core.physics.sensing`, selected by `kind`.
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
        parts: Any
        for kind, parts in (
            ("body", (*self.bodies, *self.rigid_bodies)),
            ("joint", self.joints),
            ("attachment", self.attachments),
            ("collision", self.collisions),
            ("sensor", self.sensors),
        ):
            names = [part.name for part in parts]
            for name in names:
                if names.count(name) > 1:
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
        """Owners of law parameters with their values: bodies, then `BODY.PART` of each; see `parts`."""
        return (
            *((body.name, body.material.values) for body in self.bodies),
            *((f"{body.name}.{each.name}", each.values) for body in self.bodies for each in body.parts),
        )

    @property
    def laws(self) -> tuple[Material, ...]:
        """The laws of `materials`, in the same order."""
        laws = [body.material.law_for(self.solver.rotation) for body in self.bodies]
        for part in (part for body in self.bodies for part in body.parts):
            if isinstance(part, MaterialRegionDescription):
                laws.append(part.material.law_for(self.solver.rotation))
            else:
                laws.append(part.law)
        return tuple(laws)

    def parameter_prefix(self, owner: str) -> str:
        """Return the prefix of an owner's parameter names, where all parameters have names."""
        if len(self.bodies) > 1:
            return f"{owner}."
        only = self.bodies[0].name if self.bodies else ""
        return "" if owner == only else f"{owner.removeprefix(f'{only}.')}."

    def _check_references(self) -> None:
        bodies, joints = [body.name for body in self.bodies], self.joint_names
        frames = [joint.name for joint in self.joints if joint.moves_frame]
        free = [attachment.name for attachment in self.attachments if attachment.to == "free"]

        def check_known(what: str, name: str | None, names: list[str] | tuple[str, ...]) -> None:
            if name is not None and name not in names:
                raise SceneError(f"scene {self.name}: unknown {what} {name!r}; {known_names(name, names)}")

        for j, each in enumerate(self.joints):
            what = f"parent of joint {each.name} (a revolute or prismatic joint before it)"
            check_known(what, each.parent, [name for name in frames if name in joints[:j]])
        for attachment in self.attachments:
            check_known("body", attachment.body, bodies)
            check_known("attachment target", attachment.to, ("world", "free", *frames, *free))
            check_known("joint", attachment.relative_to, frames)
        for each in self.joints:
            if each.actuator is not None:
                for owners, named in ((bodies, each.actuator.bodies()), (frames, each.actuator.carriers())):
                    for field_name, name in named.items():
                        check_known(f"{field_name} of {each.kind} {each.name}", name, owners)
        bases = [f"{name}_base" for name in frames]
        for rigid in self.rigid_bodies:
            check_known(f"carrier of rigid body {rigid.name}", rigid.on, ("world", *free, *frames, *bases))
        for collision in self.collisions:
            check_known(f"body of collision {collision.name}", collision.body, self.body_names)
        touching = [*self.body_names, *(collision.name for collision in self.collisions)]
        for entry in self.contact.friction_pairs:
            for name in entry.between:
                check_known("collision surface or body of contact.friction_pairs", name, touching)
        rods = [body.name for body in self.bodies if body.rod is not None]
        for attachment in self.attachments:
            if attachment.end is not None:
                what = f"body with an end (a rod) of attachment {attachment.name}"
                check_known(what, attachment.body, rods)
        check_known("effector (an attachment with to = free)", self.effector, free)
        places = (*(each.name for each in self.attachments), *(each.name for each in self.rigid_bodies))
        names = {ANY_BODY: self.body_names, SOFT_BODY: bodies, PLACE: ("world", *places, *frames, *bases)}
        for kind in {joint.kind for joint in self.joints}:
            names[kind] = [each.name for each in self.joints if each.kind == kind]
        need_sensors(self.name, self.dt, self.sensors, names)
