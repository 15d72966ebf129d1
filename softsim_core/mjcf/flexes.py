"""Soft bodies of a MuJoCo model: its flexes of tetrahedra, and what holds their vertices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.mesh import TetMesh
from softsim_core.mesh.checks import tet_volumes
from softsim_core.mjcf.carriers import Carrier, colour, placement
from softsim_core.mjcf.reading import Loaded
from softsim_core.scene.attachment import AttachmentDescription
from softsim_core.scene.deformable import AddedMassDescription, BodyDescription
from softsim_core.scene.material import MaterialDescription

_EVEN = 1e-6
_EXACT = 4
"""The first version of MuJoCo whose solid flexes have the stiffness that their file says."""
_NUDGE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class SoftBody:
    """A flex as a body of ours.

    Attributes:
        flex: MuJoCo's number of the flex.
        body: Its description; the mesh has a group for each thing that holds vertices.
        attachments: What holds its vertices.
        damping: Rayleigh damping in [s].
    """

    flex: int
    body: BodyDescription
    attachments: tuple[AttachmentDescription, ...]
    damping: float


def soft_bodies(loaded: Loaded, found: dict[int, Carrier], law: str | None) -> tuple[SoftBody, ...]:
    """The flexes that become soft bodies, of that law; of the others it is told why not.

    Raises:
        SceneError: there is no such law of a Young modulus and a Poisson ratio.
    """
    bodies: list[SoftBody] = []
    frames: set[str] = set()
    for f in range(loaded.model.nflex):
        if reason := loaded.refusal(f):
            loaded.told.say(loaded.flex_name(f), reason)
        else:
            bodies.append(_soft_body(loaded, f, found, frames, law))
    return tuple(bodies)


def _soft_body(
    loaded: Loaded, f: int, found: dict[int, Carrier], frames: set[str], law: str | None
) -> SoftBody:
    m, spec = loaded.model, loaded.spec.flexes[f]
    name = loaded.names.new(loaded.spec.flexes[f].name, "soft")
    start, count = int(m.flex_elemdataadr[f]), int(m.flex_elemnum[f])
    tets = np.array(m.flex_elem[start : start + 4 * count], dtype=np.int64).reshape(-1, 4)
    mesh = TetMesh(loaded.flex_points(f), tets[:, [0, 1, 3, 2]], name)  # MuJoCo winds them the other way
    if law != "saint_venant_kirchhoff":
        loaded.told.say(
            loaded.flex_name(f), "MuJoCo's law, saint_venant_kirchhoff, is the same at small strain"
        )
    if spec.poisson and int(str(loaded.mujoco.__version__).partition(".")[0]) < _EXACT:
        loaded.told.say(
            loaded.flex_name(f),
            f"MuJoCo {loaded.mujoco.__version__} takes twice the first Lame parameter, 4.0 does not",
        )
    held = dict(_held(loaded, f, found))
    attachments = tuple(_attachments(loaded, name, held, found, frames))
    groups = {each.group or "": held[b] for b, each in zip(held, attachments, strict=True)}
    if m.flex_interp[f]:
        loaded.told.say(
            loaded.flex_name(f), "dof: its vertices move each by itself here, so it is softer than in MuJoCo"
        )
    body = BodyDescription(
        name=name,
        mesh=replace(mesh, groups=groups),
        material=_material(loaded, f, law),
        colour=colour(m.flex_rgba[f]),
        **_mass(loaded, f, mesh),
    )
    body = replace(body, added_masses=tuple(_carried(loaded, body, held, found)))
    return SoftBody(f, body, attachments, float(spec.damping))


def _material(loaded: Loaded, f: int, law: str | None) -> MaterialDescription:
    spec = loaded.spec.flexes[f]
    return MaterialDescription(law=law, young_modulus=float(spec.young), poisson_ratio=float(spec.poisson))


def _held(loaded: Loaded, f: int, found: dict[int, Carrier]) -> Iterator[tuple[int, IndexArray]]:
    """Vertices that move with a body, by that body's number; 0 is the world."""
    m = loaded.model
    if m.flex_interp[f]:
        still = np.flatnonzero(_still(loaded, f))
        if len(still):
            yield 0, still
        return
    bodies = loaded.flex_bodies(f)
    free = np.array([loaded.is_vertex(int(b)) for b in bodies])
    carried = np.array(
        [-1 if is_free else found[int(b)].body for b, is_free in zip(bodies, free, strict=True)]
    )
    for b in np.unique(carried[carried >= 0]).tolist():
        yield int(b), np.flatnonzero(carried == b)


def _still(loaded: Loaded, f: int) -> Array:
    """Whether vertices of an interpolated flex stay when its nodes move, shape (n,)."""
    data = loaded.mujoco.MjData(loaded.model)
    bodies = [int(b) for b in loaded.flex_bodies(f) if loaded.is_vertex(int(b))]
    random = np.random.default_rng(0)
    for b in bodies:
        at = loaded.model.jnt_qposadr[loaded.model.body_jntadr[b]]
        data.qpos[at : at + 3] += _NUDGE * random.standard_normal(3)
    loaded.mujoco.mj_forward(loaded.model, data)
    start = loaded.model.flex_vertadr[f]
    now = np.array(data.flexvert_xpos[start : start + loaded.model.flex_vertnum[f]])
    return np.asarray(np.linalg.norm(now - loaded.flex_points(f), axis=1) < 1e-6 * _NUDGE)


def _attachments(
    loaded: Loaded, name: str, held: dict[int, IndexArray], found: dict[int, Carrier], frames: set[str]
) -> Iterator[AttachmentDescription]:
    for b in held:
        carrier = found[b]
        if carrier.kind == "world":
            yield AttachmentDescription(
                name=loaded.names.new(f"{name}_fixed", name),
                body=name,
                to="world",
                group=f"on_{carrier.name}",
            )
        elif carrier.kind == "joint" or carrier.name in frames:
            yield AttachmentDescription(
                name=loaded.names.new(f"{name}_on_{carrier.name}", name),
                body=name,
                to=carrier.name,
                group=f"on_{carrier.name}",
            )
        else:
            frames.add(carrier.name)
            yield AttachmentDescription(
                name=carrier.name,
                body=name,
                to="free",
                group=f"on_{carrier.name}",
                frame=placement(carrier.origin, carrier.rotation),
            )


def _carried(
    loaded: Loaded, body: BodyDescription, held: dict[int, IndexArray], found: dict[int, Carrier]
) -> Iterator[AddedMassDescription]:
    """The mass of free bodies that vertices are pinned to, on those vertices, but for what these have."""
    m = loaded.model
    for b, nodes in held.items():
        carrier = found[b]
        own = _weight(body, nodes)
        if carrier.kind == "joint" and own > 0.0:
            loaded.told.say(
                f"flex {body.name}",
                f"its {len(nodes)} pinned vertices on {carrier.name} have {own:.4g} kg here, in MuJoCo none",
            )
        if carrier.kind != "frame":
            continue
        mass = sum(float(m.body_mass[k]) for k, each in found.items() if each.body == b)
        loaded.told.say(
            f"body {m.body(b).name or b}",
            f"its mass, {mass:.4g} kg, is spread over the vertices that are pinned to it, and so its inertia",
        )
        if mass > own:
            yield AddedMassDescription(mass=mass - own, group=f"on_{carrier.name}")


def _weight(body: BodyDescription, nodes: IndexArray) -> float:
    """Mass in [kg] that nodes of a body have by themselves."""
    assert isinstance(body.mesh, TetMesh)  # as it was made here
    shares = _volumes(body.mesh)
    if body.density is not None:
        return body.density * float(shares[nodes].sum())
    assert body.total_mass is not None  # or a density
    if body.mass_distribution == "equal":
        return body.total_mass * len(nodes) / len(shares)
    return body.total_mass * float(shares[nodes].sum() / shares.sum())


def _volumes(mesh: TetMesh) -> Array:
    """Volume in [m^3] that belongs to each node, shape (n,)."""
    quarters = np.repeat(np.abs(tet_volumes(mesh.points, mesh.tets)) / 4.0, 4)
    return np.bincount(mesh.tets.ravel(), quarters, minlength=len(mesh.points))


def _mass(loaded: Loaded, f: int, mesh: TetMesh) -> dict[str, Any]:
    """Total mass and how it is spread, from the masses of the vertices that move."""
    m = loaded.model
    bodies = [int(b) for b in loaded.flex_bodies(f) if loaded.is_vertex(int(b))]
    masses = np.array([m.body_mass[b] for b in bodies])
    if not len(masses) or not masses.sum() > 0.0:
        loaded.told.say(loaded.flex_name(f), "has no mass of its own: 1000 kg/m^3 is assumed")
        return {"density": 1000.0}
    if m.flex_interp[f]:  # its nodes that move share all of it
        return {"total_mass": float(f"{masses.sum():.9g}")}
    if np.ptp(masses) <= _EVEN * masses.max():  # each vertex has a share, and that of pinned ones is gone
        total = float(masses.mean() * len(mesh.points))
        return {"total_mass": float(f"{total:.9g}"), "mass_distribution": "equal"}
    moving = np.array([loaded.is_vertex(int(b)) for b in loaded.flex_bodies(f)])
    shares = _volumes(mesh)
    density = float(masses.sum() / shares[moving].sum())
    if np.abs(density * shares[moving] - masses).max() > 1e-3 * masses.mean():
        loaded.told.say(loaded.flex_name(f), "masses of its vertices are spread by volume here")
    return {"density": float(f"{density:.9g}")}
