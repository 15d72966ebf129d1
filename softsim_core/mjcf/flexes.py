"""Soft bodies of a MuJoCo model: flexes of tetrahedra, their fixings, and tendons through them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.mjcf.carriers import Carrier, colour, placement, vector
from softsim_core.mjcf.reading import CompiledModel
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import TetMesh, tet_volumes
from softsim_core.scene import (
    AddedMassDescription,
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
)

_EVEN = 1e-6
_EXACT = 4
"""First version of MuJoCo whose solid flexes have the stiffness given in their file."""
_NUDGE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class SoftBody:
    """A flex as a soft body.

    Attributes:
        flex: MuJoCo's number of the flex.
        body: Its description; the mesh has one group per carrier of vertices.
        attachments: Attachments of its vertices.
        damping: Rayleigh damping in [s].
    """

    flex: int
    body: BodyDescription
    attachments: tuple[AttachmentDescription, ...]
    damping: float


def soft_bodies(loaded: CompiledModel, found: dict[int, Carrier], law: str | None) -> tuple[SoftBody, ...]:
    """Convert the supported flexes to soft bodies of a law; report why the others are left out.

    Raises:
        SceneError: there is no such law with a Young modulus and a Poisson ratio.
    """
    bodies: list[SoftBody] = []
    frames: set[str] = set()
    for f in range(loaded.model.nflex):
        if reason := loaded.refusal(f):
            loaded.notes.say(loaded.flex_name(f), reason)
        else:
            bodies.append(_soft_body(loaded, f, found, frames, law))
    return tuple(bodies)


def _soft_body(
    loaded: CompiledModel, f: int, found: dict[int, Carrier], frames: set[str], law: str | None
) -> SoftBody:
    m, spec = loaded.model, loaded.spec.flexes[f]
    name = loaded.names.new(spec.name, "soft")
    start, count = int(m.flex_elemdataadr[f]), int(m.flex_elemnum[f])
    tets = np.array(m.flex_elem[start : start + 4 * count], dtype=np.int64).reshape(-1, 4)
    mesh = TetMesh(loaded.flex_points(f), tets[:, [0, 1, 3, 2]], name)  # MuJoCo's corner order
    called, version = loaded.flex_name(f), str(loaded.mujoco.__version__)
    if law != "saint_venant_kirchhoff":
        loaded.notes.say(called, "MuJoCo's law, saint_venant_kirchhoff, is the same at small strain")
    if spec.poisson and int(version.partition(".")[0]) < _EXACT:
        loaded.notes.say(called, f"MuJoCo {version} takes twice the first Lame parameter, 4.0 does not")
    fixed = dict(_find_pinned_vertices(loaded, f, found))
    attachments = tuple(_attachments(loaded, name, fixed, found, frames))
    groups = {each.group or "": fixed[b] for b, each in zip(fixed, attachments, strict=True)}
    if m.flex_interp[f]:
        loaded.notes.say(called, "dof: its vertices move each by itself here, so it is softer than in MuJoCo")
    young, poisson = float(spec.young), float(spec.poisson)
    body = BodyDescription(
        name=name,
        mesh=replace(mesh, groups=groups),
        material=MaterialDescription(law=law, young_modulus=young, poisson_ratio=poisson),
        colour=colour(m.flex_rgba[f]),
        **_mass(loaded, f, mesh),
    )
    body = replace(body, added_masses=tuple(_build_added_masses(loaded, body, fixed, found)))
    return SoftBody(f, body, attachments, float(spec.damping))


def _find_pinned_vertices(
    loaded: CompiledModel, f: int, found: dict[int, Carrier]
) -> Iterator[tuple[int, IndexArray]]:
    """Yield the vertices that move with a body, with that body's number; 0 is the world."""
    m = loaded.model
    if m.flex_interp[f]:
        still = np.flatnonzero(_still(loaded, f))
        if len(still):
            yield 0, still
        return
    bodies = loaded.flex_bodies(f)
    free = np.array([loaded.is_vertex(int(b)) for b in bodies])
    carried = np.array([-1 if own else found[b].body for b, own in zip(bodies.tolist(), free, strict=True)])
    for b in np.unique(carried[carried >= 0]).tolist():
        yield int(b), np.flatnonzero(carried == b)


def _still(loaded: CompiledModel, f: int) -> Array:
    """Return whether the vertices of an interpolated flex stay when its nodes move, shape (n,)."""
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
    loaded: CompiledModel,
    name: str,
    fixed: dict[int, IndexArray],
    found: dict[int, Carrier],
    frames: set[str],
) -> Iterator[AttachmentDescription]:
    for b in fixed:
        carrier, frame = found[b], None
        if carrier.kind == "world":
            own, to = loaded.names.new(f"{name}_fixed", name), "world"
        elif carrier.kind == "joint" or carrier.name in frames:
            own, to = loaded.names.new(f"{name}_on_{carrier.name}", name), carrier.name
        else:
            frames.add(carrier.name)
            own, to, frame = carrier.name, "free", placement(carrier.origin, carrier.rotation)
        yield AttachmentDescription(name=own, body=name, to=to, group=f"on_{carrier.name}", frame=frame)


def _build_added_masses(
    loaded: CompiledModel, body: BodyDescription, fixed: dict[int, IndexArray], found: dict[int, Carrier]
) -> Iterator[AddedMassDescription]:
    """Yield the mass of free bodies with pinned vertices, on those vertices, minus their own mass."""
    m = loaded.model
    for b, nodes in fixed.items():
        carrier = found[b]
        own = _weight(body, nodes)
        if carrier.kind == "joint" and own > 0.0:
            pinned = f"its {len(nodes)} pinned vertices on {carrier.name}"
            loaded.notes.say(f"flex {body.name}", f"{pinned} have {own:.4g} kg here, in MuJoCo none")
        if carrier.kind != "frame":
            continue
        mass = sum(float(m.body_mass[k]) for k, each in found.items() if each.body == b)
        note = (
            f"its mass, {mass:.4g} kg, is spread over the vertices that are pinned to it, and so its inertia"
        )
        loaded.notes.say(f"body {m.body(b).name or b}", note)
        if mass > own:
            yield AddedMassDescription(mass=mass - own, group=f"on_{carrier.name}")


def _weight(body: BodyDescription, nodes: IndexArray) -> float:
    """Return the own mass in [kg] of nodes of a body."""
    assert isinstance(body.mesh, TetMesh)  # created here
    shares = _volumes(body.mesh)
    if body.density is not None:
        return body.density * float(shares[nodes].sum())
    assert body.total_mass is not None  # else a density is given
    if body.mass_distribution == "equal":
        return body.total_mass * len(nodes) / len(shares)
    return body.total_mass * float(shares[nodes].sum() / shares.sum())


def _volumes(mesh: TetMesh) -> Array:
    """Return the volume in [m^3] that belongs to each node, shape (n,)."""
    quarters = np.repeat(np.abs(tet_volumes(mesh.points, mesh.tets)) / 4.0, 4)
    return np.bincount(mesh.tets.ravel(), quarters, minlength=len(mesh.points))


def _mass(loaded: CompiledModel, f: int, mesh: TetMesh) -> dict[str, Any]:
    """Return total mass and distribution from the masses of the moving vertices."""
    m = loaded.model
    bodies = [int(b) for b in loaded.flex_bodies(f) if loaded.is_vertex(int(b))]
    masses = np.array([m.body_mass[b] for b in bodies])
    if not len(masses) or not masses.sum() > 0.0:
        loaded.notes.say(loaded.flex_name(f), "has no mass of its own: 1000 kg/m^3 is assumed")
        return {"density": 1000.0}
    if m.flex_interp[f]:  # its moving nodes share all of it
        return {"total_mass": float(f"{masses.sum():.9g}")}
    if np.ptp(masses) <= _EVEN * masses.max():  # each vertex has a share; that of pinned ones is lost
        total = float(masses.mean() * len(mesh.points))
        return {"total_mass": float(f"{total:.9g}"), "mass_distribution": "equal"}
    moving = np.array([loaded.is_vertex(int(b)) for b in loaded.flex_bodies(f)])
    shares = _volumes(mesh)
    density = float(masses.sum() / shares[moving].sum())
    if np.abs(density * shares[moving] - masses).max() > 1e-3 * masses.mean():
        loaded.notes.say(loaded.flex_name(f), "masses of its vertices are spread by volume here")
    return {"density": float(f"{density:.9g}")}


_NEAR = 0.02
"""Allowed distance of a point outside a soft body, in diagonals of the box around it."""


@dataclass(frozen=True, slots=True)
class _Site:
    """A point of a tendon: in a soft body, in the world or on a joint."""

    place: Array
    soft: str | None
    joint: str | None


def cables(
    loaded: CompiledModel, soft: tuple[SoftBody, ...], found: dict[int, Carrier]
) -> tuple[JointDescription, ...]:
    """Convert supported tendons to joints of kind cable; report why the others are left out."""
    m = loaded.model
    called = [f"tendon {m.tendon(t).name or t}" for t in range(m.ntendon)]
    joints = [_cable(loaded, t, name, soft, found) for t, name in enumerate(called)]
    return tuple(joint for joint in joints if joint is not None)


def _cable(
    loaded: CompiledModel, t: int, called: str, soft: tuple[SoftBody, ...], found: dict[int, Carrier]
) -> JointDescription | None:
    m, kinds = loaded.model, loaded.mujoco.mjtWrap
    wraps = range(int(m.tendon_adr[t]), int(m.tendon_adr[t] + m.tendon_num[t]))
    if any(m.wrap_type[w] != kinds.mjWRAP_SITE for w in wraps):
        loaded.notes.say(called, "runs over joints, geoms or pulleys: it is not taken over")
        return None
    sites = [_site(loaded, int(m.wrap_objid[w]), soft, found) for w in wraps]
    inside = [k for k, site in enumerate(sites) if site.soft]
    bodies = {sites[k].soft for k in inside}
    if len(bodies) != 1 or inside != list(range(inside[0], inside[-1] + 1)):
        loaded.notes.say(called, "does not run through one soft body: it is not taken over")
        return None
    if inside[0] == 0 and inside[-1] < len(sites) - 1:
        sites, inside = sites[::-1], [len(sites) - 1 - k for k in reversed(inside)]
    if inside[-1] != len(sites) - 1:
        loaded.notes.say(called, "is pulled at both ends: it is not taken over")
        return None
    pulled = sites[inside[0] - 1] if inside[0] else None
    points = tuple(vector(sites[k].place) for k in inside)
    if len(points) + (pulled is not None) < 2:
        loaded.notes.say(called, "has a single point: it is not taken over")
        return None
    (body,) = bodies
    limits, how = _command(loaded, t, called)
    if pulled is not None:
        how |= {"pull_point": vector(pulled.place), "pull_on": pulled.joint}
    for name in ("stiffness", "damping"):
        if np.any(getattr(m, f"tendon_{name}")[t]):
            loaded.notes.say(called, f"{name} is not taken over: a cable does not stretch here")
    name = loaded.names.new(m.tendon(t).name, "cable")
    cable = CableDescription(body=str(body), points=points, **how)
    return JointDescription(name=name, kind="cable", limits=limits, actuator=cable)


def _site(loaded: CompiledModel, s: int, soft: tuple[SoftBody, ...], found: dict[int, Carrier]) -> _Site:
    m, b = loaded.model, int(loaded.model.site_bodyid[s])
    place = np.array(loaded.data.site_xpos[s])
    if loaded.is_vertex(b):
        owner = next((each.body.name for each in soft if (loaded.flex_bodies(each.flex) == b).any()), None)
        return _Site(place, owner, None)
    carrier = found[b]
    if carrier.kind == "joint":
        return _Site(place, None, carrier.name)
    if carrier.kind == "frame":  # a point of the soft body that contains the frame
        weld = carrier.body
        for each in soft:
            points = loaded.flex_points(each.flex)
            pinned = m.body_weldid[loaded.flex_bodies(each.flex)] == weld
            size = float(np.linalg.norm(np.ptp(points, axis=0)))
            if pinned.any() and np.linalg.norm(points - place, axis=1).min() < 10.0 * _NEAR * size:
                return _Site(place, each.body.name, None)
    return _Site(place, None, None)


def _command(loaded: CompiledModel, t: int, called: str) -> tuple[JointLimits, dict[str, Any]]:
    """Return limits and control of the cable: by force for a motor, by displacement otherwise."""
    m, d = loaded.model, loaded.data
    of_tendon = loaded.mujoco.mjtTrn.mjTRN_TENDON
    acting = [k for k in range(m.nu) if m.actuator_trntype[k] == of_tendon and m.actuator_trnid[k, 0] == t]
    length = float(d.ten_length[t])
    if acting and not np.any(m.actuator_biasprm[acting[0]]):
        k = acting[0]
        scale = float(m.actuator_gear[k, 0] * m.actuator_gainprm[k, 0])
        controls = m.actuator_ctrlrange[k].tolist() if m.actuator_ctrllimited[k] else []
        pulls = [-scale * each for each in controls]
        note = f"is commanded by its tension in N here, which is {-scale:g} times MuJoCo's control"
        loaded.notes.say(called, note)
        return JointLimits(lower=0.0, upper=max([*pulls, 0.0]) or math.inf), {"control": "force"}
    if acting:
        loaded.notes.say(
            called, "is commanded by how much it is shortened, in m, and holds that exactly here"
        )
    how: dict[str, Any] = {}
    if m.tendon_limited[t] and m.tendon_range[t, 1] > 0.0:
        rest = float(m.tendon_range[t, 1])
        if not math.isclose(rest, length, rel_tol=1e-6):
            how["rest_length"] = rest
    elif not acting:
        loaded.notes.say(called, "is not limited in MuJoCo; here it does not get longer than it starts")
    return JointLimits(lower=0.0, upper=0.5 * length), how
