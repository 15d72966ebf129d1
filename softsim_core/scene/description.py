"""What a scene is: typed, immutable, SI. YAML files and Python scenes both end here; the builder starts here.

Angles of placements are in degrees in fields named `*_deg` (people write them); the rest is SI and radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias, get_args

from softsim_core.actuation.building import ActuatorDescription
from softsim_core.actuation.registry import FRAME_KINDS, described_kinds
from softsim_core.contact.settings import ContactSettings
from softsim_core.dynamics import Backend
from softsim_core.errors import SceneError, listing
from softsim_core.fem.elements import element
from softsim_core.fem.materials import Material
from softsim_core.fem.materials.section import SECTION
from softsim_core.linalg.solvers import AUTO, linear_solver_names
from softsim_core.mechanics.limits import JointLimits
from softsim_core.mesh.types import TetMesh
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.material_region import MaterialRegionDescription
from softsim_core.scene.objects import CollisionDescription, RigidBodyDescription
from softsim_core.scene.reinforcement import FibresDescription, LayerDescription
from softsim_core.scene.rod import RodDescription, RodEnd
from softsim_core.sensing.description import (
    ANY_BODY,
    PLACE,
    SOFT_BODY,
    SimulatedSensorDescription,
    need_sensors,
)
from softsim_core.units import ANGLE, LENGTH, JointUnits
from softsim_core.values import (
    DIRECTION,
    Box,
    FieldError,
    MeshFile,
    Placement,
    Sphere,
    Vector,
    need_finite,
    need_positive,
    need_unit,
)
from softsim_core.wrong_names import known_names, one_of

RotationLaw: TypeAlias = Literal["polar", "qr"]
MassDistribution: TypeAlias = Literal["volume", "consistent", "equal"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AddedMassDescription:
    """Mass that the nodes of a region carry beside their body's, spread evenly: a load, a sensor, a nut.

    Attributes:
        mass: In [kg], > 0.
        box, sphere: The region; nodes are chosen once, on the rest shape.
        end: Or that end of a rod.
        group: Or the name of a group of the mesh's file (a physical group of Gmsh). Exactly one of the four.
    """

    mass: float
    box: Box | None = None
    sphere: Sphere | None = None
    end: RodEnd | None = None
    group: str | None = None

    def __post_init__(self) -> None:
        need_positive("added mass", "mass", self.mass, "kg")
        _need_one_region("added mass", self.box, self.sphere, self.end, self.group)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyDescription:
    """A deformable body.

    Attributes:
        name: Unique name.
        mesh: Tetrahedra: a file, or arrays in [m]; or give `rod`.
        rod: A slender body; or give `mesh`. It has no layers, fibres, surface of its own or order, and the
            law `rod`, or with an `element` of tetrahedra another one.
        material: Law and parameters.
        density: Mass per volume in [kg/m^3], > 0; or give `total_mass`. Where neither is given, that of the
            material's preset, if it is known.
        total_mass: Mass in [kg], > 0; or give `density`.
        mass_distribution: How the mass is spread over the nodes. "volume": each element's mass goes to its
            nodes. "consistent": it moves as the shape functions say, so the inertia of a body with straight
            edges is exact. "equal": every node has the same, as in the reference simulator, which makes the
            inertia of coarse meshes much too large.
        added_masses: What parts of it carry.
        layers: Thin sheets on its faces.
        fibres: What runs through it and carries tension only.
        regions: Parts of it that are made of something else.
        velocity: Of all its nodes at the start in [m/s], but of those that are fixed or follow a joint.
        surface: Finer visual surface that follows the body; None shows the boundary of the tetrahedra.
        colour: Red, green, blue, alpha in 0..1, for pictures only.
        order: 2 puts a node on each edge of a linear mesh, 1 leaves those of a quadratic one out; None: as
            the mesh is.
        element: Name of the element that its cells are, see fem.elements, with as many nodes as they have;
            None: tet4 or tet10, or of a rod sections along it. With tet4 or tet10 the rod is a strip of
            tetrahedra of the same shape.
    """

    name: str
    mesh: MeshFile | TetMesh | None = None
    rod: RodDescription | None = None
    material: MaterialDescription
    density: float | None = None
    total_mass: float | None = None
    mass_distribution: MassDistribution = "volume"
    added_masses: tuple[AddedMassDescription, ...] = ()
    layers: tuple[LayerDescription, ...] = ()
    fibres: tuple[FibresDescription, ...] = ()
    regions: tuple[MaterialRegionDescription, ...] = ()
    velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata=DIRECTION)
    surface: MeshFile | None = None
    colour: tuple[float, float, float, float] = (0.9, 0.9, 0.9, 1.0)
    order: Literal[1, 2] | None = None
    element: str | None = None

    def __post_init__(self) -> None:
        need_finite(f"body {self.name}", "velocity", self.velocity)
        self._check_rod()
        if self.density is None and self.total_mass is None:
            object.__setattr__(self, "density", self.material.known_density)
        if (self.density is None) == (self.total_mass is None):
            given = "neither" if self.density is None else "both"
            raise SceneError(
                f"body {self.name}: give exactly one of `density` in kg/m^3 and `total_mass` in kg, "
                f"not {given}"
            )
        if self.density is not None:
            need_positive(f"body {self.name}", "density", self.density, "kg/m^3")
        if self.total_mass is not None:
            need_positive(f"body {self.name}", "total_mass", self.total_mass, "kg")
        if not all(0.0 <= channel <= 1.0 for channel in self.colour):
            raise FieldError(f"body {self.name}", "colour", list(self.colour), "four numbers in 0..1")
        names = [each.name for each in self.parts]
        if twice := {name for name in names if names.count(name) > 1}:
            raise SceneError(
                f"body {self.name}: layers, fibres and regions share the name {min(twice)}; rename one"
            )

    def _check_rod(self) -> None:
        owner = f"body {self.name}"
        if (self.mesh is None) == (self.rod is None):
            raise SceneError(f"{owner}: give exactly one of mesh and rod")
        if self.rod is None:
            if any(added.end is not None for added in self.added_masses):
                raise SceneError(f"{owner}: only a rod has an end; give the added mass a box or a sphere")
            if self.material.law == SECTION.name:
                raise SceneError(
                    f"{owner}: the law {SECTION.name} is for rods; choose another one, or give a rod"
                )
            return
        if self.element is None:
            self._check_sections(owner)
        else:
            self._check_tetrahedra_of_rod(owner, self.rod, self.element)
        for name in ("layers", "fibres", "regions", "surface", "order"):
            if getattr(self, name):
                raise SceneError(f"{owner}: a rod takes no {name}; remove it, or give a mesh instead")

    def _check_sections(self, owner: str) -> None:
        if self.material.law is None and not self.material.terms:
            object.__setattr__(self, "material", self.material.of_law(SECTION.name))
        if self.material.law != SECTION.name or self.material.terms:
            law = f"{self.material.law} with Prony terms" if self.material.terms else self.material.law
            raise SceneError(
                f"{owner}: a rod has the law {SECTION.name}, not {law}; remove `law` and `prony`, or make it "
                "of tetrahedra by `element: tet10`"
            )

    def _check_tetrahedra_of_rod(self, owner: str, rod: RodDescription, cell: str) -> None:
        if len(element(cell).reference) not in (4, 10):
            raise SceneError(f"{owner}: a rod is not made of the element {cell}; take tet4 or tet10, or none")
        if self.material.law == SECTION.name:
            raise SceneError(
                f"{owner}: the law {SECTION.name} is for sections, and `element` makes tetrahedra of it; "
                "choose another law, or remove `element`"
            )
        if beyond := rod.beyond_tetrahedra:
            raise SceneError(
                f"{owner}: a rod of tetrahedra is a solid rectangle, straight or as drawn, without clamps "
                f"that give way; remove {listing(beyond)} or `element`"
            )

    @property
    def is_rod(self) -> bool:
        """Whether it is made of cross-sections, not of tetrahedra."""
        return self.rod is not None and self.element is None

    @property
    def reinforcements(self) -> tuple[LayerDescription | FibresDescription, ...]:
        """Its layers, then its fibres."""
        return (*self.layers, *self.fibres)

    @property
    def parts(self) -> tuple[LayerDescription | FibresDescription | MaterialRegionDescription, ...]:
        """What of it has parameters of its own: layers, fibres, regions."""
        return (*self.reinforcements, *self.regions)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointDescription:
    """One scalar degree of freedom between a base frame and the frame it moves.

    Attributes:
        name: Unique name; the order of joints in the scene is the order of commands.
        kind: revolute ([rad] about `axis`), prismatic ([m] along `axis`), or the name of a kind of actuator,
            such as cable ([m] by which it is shortened).
        actuator: The description of that actuator, in files under the key named after its kind; its joint has
            no frame and no axis.
        parent: Name of a joint before it in the list that carries this joint's base; chains of any length.
        base: Base frame in the world, the parent at rest (its scale is not used).
        axis: Unit axis in the base frame, through its origin.
        limits: Position interval and top speed.
        rest: Position at which the scene is built, in [rad] or [m].
        stiffness: None: the joint is exactly where it is commanded (a prescribed unknown; its reaction is the
            holding torque). A number: a spring of that stiffness in [N m/rad] or [N/m] pulls it there.
        inertia: Generalised inertia in [kg m^2] or [kg] of a joint with stiffness.
        slide_axis: Direction in the base frame in which the start move shifts the base, in simulation only.
        horn_length: Length in [m] of the servo arm, for pictures only.
    """

    name: str
    kind: str = "revolute"
    actuator: ActuatorDescription | None = None
    parent: str | None = None
    base: Placement = Placement()
    axis: Vector = (0.0, 1.0, 0.0)
    limits: JointLimits = JointLimits()
    rest: float = 0.0
    stiffness: float | None = None
    inertia: float = 0.0
    slide_axis: Vector = (1.0, 0.0, 0.0)
    horn_length: float = 0.0

    def __post_init__(self) -> None:
        owner = f"joint {self.name}"
        need_unit(owner, "axis", self.axis)
        need_unit(owner, "slide_axis", self.slide_axis)
        need_finite(owner, "rest", (self.rest,))
        if self.stiffness is not None:
            need_positive(owner, "stiffness", self.stiffness, "(or absent)")
        for field_name, value in (("inertia", self.inertia), ("horn_length", self.horn_length)):
            if not 0.0 <= value < math.inf:
                raise FieldError(owner, field_name, value, ">= 0")
        if self.moves_frame and self.actuator is not None:
            kind = self.actuator.kind
            raise SceneError(f"{owner}: `{kind}` and kind = {kind} belong together; give both or neither")
        if not self.moves_frame:
            self._check_actuator(owner)

    def _check_actuator(self, owner: str) -> None:
        described = described_kinds()
        if self.kind not in described:
            raise FieldError(owner, "kind", repr(self.kind), one_of(self.kind, (*FRAME_KINDS, *described)))
        if not isinstance(self.actuator, described[self.kind]):
            raise SceneError(
                f"{owner}: `{self.kind}` and kind = {self.kind} belong together; give both or neither"
            )
        if self.stiffness is not None or self.parent is not None:
            raise SceneError(
                f"{owner}: a joint of kind {self.kind} takes no stiffness and no parent; remove them"
            )

    @property
    def by_effort(self) -> bool:
        """Whether commands are its effort, such as the pressure of a chamber, not where it shall be."""
        return self.actuator is not None and self.actuator.by_effort

    @property
    def units(self) -> JointUnits:
        """What its command, position and effort are told in."""
        if self.actuator is not None:
            return self.actuator.units
        return JointUnits(ANGLE, ANGLE, "N·m") if self.kind == "revolute" else JointUnits(LENGTH, LENGTH, "N")

    @property
    def moves_frame(self) -> bool:
        """Whether it is a revolute or a prismatic joint, not an actuator's."""
        return self.kind in FRAME_KINDS


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentDescription:
    """A region of a body that moves rigidly: with the world, with a joint, or as a free rigid frame.

    Attributes:
        name: Unique name; a free frame carries this name.
        body: Name of the body.
        to: "world" (held still), "free" (a rigid frame with six unknowns), the name of a joint, or that of an
            attachment with to = free, whose frame then carries both.
        box, sphere: The region; nodes are chosen once, on the rest shape, of a rod whole sections.
        end: Or that end of a rod, beyond its clamp where it has one.
        group: Or the name of a group of the mesh's file: a physical group of Gmsh, of points, lines, faces or
            cells. Exactly one of the four.
        relative_to: None: the region is given in world coordinates. A joint name: in that joint's base frame.
        frame: Origin in [m] and orientation of a free frame, in world coordinates.
        stiffness: Only with to = "world": spring in [N/m] a node instead of an exact hold.
    """

    name: str
    body: str
    to: str
    box: Box | None = None
    sphere: Sphere | None = None
    end: RodEnd | None = None
    group: str | None = None
    relative_to: str | None = None
    frame: Placement = Placement()
    stiffness: float | None = None

    def __post_init__(self) -> None:
        _need_one_region(f"attachment {self.name}", self.box, self.sphere, self.end, self.group)
        if self.stiffness is not None and (self.to != "world" or not 0.0 < self.stiffness < math.inf):
            raise SceneError(f"attachment {self.name}: stiffness needs to = world and a value > 0 N/m")


def _need_one_region(owner: str, *given: Box | Sphere | RodEnd | str | None) -> None:
    if sum(each is not None for each in given) != 1:
        raise SceneError(f"{owner}: give exactly one of box, sphere, end and group")


TimeIntegration: TypeAlias = Literal["implicit_euler", "bossak"]
Threads: TypeAlias = Literal["auto"] | int
SUBSTEPS: Final = (1, 2, 4, 8, 16, 32, 64)
MOST_THREADS: Final = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """Numerics: law of bodies that name none, implementation of the step, Rayleigh damping.

    Attributes:
        rotation: Law of bodies whose material names none: "polar" is corotational (survives inversion), "qr"
            is corotational_qr (parity with the reference simulator).
        backend: "numba" (fast), "scipy" (readable reference) or "auto" (numba where it imports).
        linear_solver: Name of what solves the linear systems of step and statics, see linalg.solvers; "auto"
            leaves it to the suite. One that the compiled step is not one with runs with plain assembly.
        threads: Of the compiled step of a large mesh, some 3000 nodes and more: 1 to 64, or "auto": as many
            as OMP_NUM_THREADS says, else as the process has cores. States are the same bit by bit.
        rayleigh_stiffness: Damping per stiffness in [s], >= 0.
        rayleigh_mass: Damping per mass in [1/s], >= 0.
        time_integration: "implicit_euler", or "bossak", of second order, for what shall ring as
            the real thing does; see dynamics.bossak.
        spectral_radius: Of "bossak": what each step leaves of the highest frequencies, 0 to 1.
        substeps: Parts in which a step is done at most where rubber or a quadratic cell strains too much for
            one: 1 (always whole), 2, 4 and so on up to 64.
        iterations: Newton iterations of a step at most, >= 1; with 1 it is linearised once. "bossak" takes 2
            at least where a body hangs on nothing: linearised once, it would gain energy as it turns.
        iteration_tolerance: A step has enough of them once one has moved no node farther than this, in [m],
            >= 0.
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
    iteration_tolerance: float = 1e-7

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("rayleigh_stiffness", self.rayleigh_stiffness, "s"),
            ("rayleigh_mass", self.rayleigh_mass, "1/s"),
        ):
            if not 0.0 <= value < math.inf:
                raise FieldError("solver", name, value, f">= 0 {unit}")
        if self.time_integration not in get_args(TimeIntegration):
            allowed = one_of(self.time_integration, get_args(TimeIntegration))
            raise FieldError("solver", "time_integration", self.time_integration, allowed)
        if not 0.0 <= self.spectral_radius <= 1.0:
            raise FieldError("solver", "spectral_radius", self.spectral_radius, "between 0 and 1")
        if self.substeps not in SUBSTEPS:
            raise FieldError("solver", "substeps", self.substeps, f"one of {listing(SUBSTEPS)}")
        if self.iterations < 1:
            raise FieldError("solver", "iterations", self.iterations, ">= 1")
        if not 0.0 <= self.iteration_tolerance < math.inf:
            raise FieldError("solver", "iteration_tolerance", self.iteration_tolerance, ">= 0 m")
        known = (AUTO, *linear_solver_names())
        if self.linear_solver not in known:
            raise FieldError("solver", "linear_solver", self.linear_solver, one_of(self.linear_solver, known))
        if self.threads != "auto" and not 1 <= self.threads <= MOST_THREADS:
            raise FieldError("solver", "threads", self.threads, f"auto, or 1 to {MOST_THREADS}")


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneDescription:
    """What is simulated: bodies, what holds and moves them, what they touch; see the fields' types.

    Attributes:
        name: What messages call it.
        dt: Time step in [s], > 0.
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
