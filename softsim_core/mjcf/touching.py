"""Contact pairs of a MuJoCo model, as collision surfaces and groups of a scene."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softsim_core.mjcf.flexes import SoftBody
from softsim_core.mjcf.geoms import RigidGeom
from softsim_core.mjcf.reading import CompiledModel
from softsim_core.physics.contact import ContactSettings, PairFriction
from softsim_core.scene import CollisionDescription, JointDescription

_GAP_M = 1e-4
"""Gap in [m] at which bodies rest if no flex has a radius."""


@dataclass(frozen=True, slots=True)
class _Surface:
    """A surface with MuJoCo's masks.

    Attributes:
        name: Name of its body.
        contype, conaffinity, friction, radius: As in MuJoCo.
        carrier: Its carrier.
        bodies: MuJoCo's numbers.
        hangs_on: Joints and frames that carry vertices of it.
        driven: MuJoCo's geoms of a body that the world or a joint carries; empty for others.
    """

    name: str
    contype: int
    conaffinity: int
    friction: float
    carrier: str
    bodies: frozenset[int]
    radius: float = 0.0
    hangs_on: frozenset[str] = frozenset()
    driven: frozenset[int] = frozenset()

    def meets(self, other: _Surface) -> bool:
        """Return whether MuJoCo's masks let the two touch, and neither is attached to the other's carrier."""
        if self.carrier in other.hangs_on or other.carrier in self.hangs_on:
            return False
        return bool(self.contype & other.conaffinity or other.contype & self.conaffinity)


def collisions(
    loaded: CompiledModel,
    soft: tuple[SoftBody, ...],
    rigid: tuple[RigidGeom, ...],
    joints: tuple[JointDescription, ...],
) -> tuple[tuple[CollisionDescription, ...], ContactSettings]:
    """Return the surfaces that touch others, with groups for pairs that never touch, and contact settings."""
    m = loaded.model
    if m.opt.disableflags & loaded.mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return (), ContactSettings()
    surfaces = [
        each for each in (*_soft(loaded, soft), *_rigid(loaded, rigid)) if each.contype or each.conaffinity
    ]
    if not any(each.carrier != "world" for each in surfaces):
        return (), ContactSettings()
    groups: dict[str, list[str]] = {each.name: [] for each in surfaces}
    for carrier in dict.fromkeys(each.carrier for each in surfaces):
        members = [each.name for each in surfaces if each.carrier == carrier]
        if len(members) > 1:
            for name in members:
                groups[name].append(f"on_{carrier}")
    apart = [{int(each) >> 16, int(each) & 0xFFFF} for each in m.exclude_signature]
    touches_parent = m.opt.disableflags & loaded.mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    neighbours = [] if touches_parent else [{each.name, each.parent} for each in joints]
    contacts = loaded.data.contact
    crossing = [set(map(int, each.geom)) for each in contacts if each.dist < 0.0 and min(each.geom) >= 0]
    meeting: list[tuple[_Surface, _Surface]] = []
    for a, b in itertools.combinations(surfaces, 2):
        if a.carrier == b.carrier:
            continue
        named = any({i, j} in apart for i in a.bodies for j in b.bodies)
        if any({i, j} in crossing for i in a.driven for j in b.driven):
            loaded.notes.say(a.name, f"crosses {b.name} at the start: the two do not touch here")
            named = True
        if a.meets(b) and not named and {a.carrier, b.carrier} not in neighbours:
            meeting.append((a, b))
        else:
            for name in (a.name, b.name):
                groups[name].append(f"{a.name}_not_{b.name}")
    if not meeting:
        return (), ContactSettings()
    found = tuple(
        CollisionDescription(name=each.name, body=each.name, groups=tuple(groups[each.name]))
        for each in surfaces
    )
    return found, _settings(loaded, surfaces, meeting)


def _soft(loaded: CompiledModel, soft: tuple[SoftBody, ...]) -> Iterator[_Surface]:
    m = loaded.model
    for each in soft:
        f = each.flex
        attached = {attached.name if attached.to == "free" else attached.to for attached in each.attachments}
        contype, conaffinity = int(m.flex_contype[f]), int(m.flex_conaffinity[f])
        friction, radius = float(m.flex_friction[f, 0]), float(m.flex_radius[f])
        name, hangs_on = each.body.name, frozenset(attached - {"world"})
        yield _Surface(name, contype, conaffinity, friction, name, frozenset(), radius, hangs_on)


def _rigid(loaded: CompiledModel, rigid: tuple[RigidGeom, ...]) -> Iterator[_Surface]:
    m = loaded.model
    for each in rigid:
        geoms, description = list(each.geoms), each.description
        contype = int(np.bitwise_or.reduce(m.geom_contype[geoms]))
        conaffinity = int(np.bitwise_or.reduce(m.geom_conaffinity[geoms]))
        friction, bodies = float(m.geom_friction[geoms, 0].max()), frozenset(m.geom_bodyid[geoms].tolist())
        driven = frozenset(geoms if description.mass is None else ())
        yield _Surface(description.name, contype, conaffinity, friction, each.carrier, bodies, driven=driven)


def _settings(
    loaded: CompiledModel, surfaces: list[_Surface], meeting: list[tuple[_Surface, _Surface]]
) -> ContactSettings:
    """Return gap and friction: for a pair, MuJoCo uses the larger friction of the two."""
    radii = [each.radius for each in surfaces if each.radius > 0.0]
    gap = float(f"{max(radii, default=_GAP_M):.6g}")
    if len({f"{each:.6g}" for each in radii}) > 1:
        note = f"radius differs: all bodies keep the largest, {gap:g} m, as their gap here"
        loaded.notes.say("flexes", note)
    pairs = {(a.name, b.name): max(a.friction, b.friction) for a, b in meeting}
    values = list(pairs.values())
    usual = max(set(values), key=values.count)
    others = tuple(
        PairFriction(between=names, friction=value) for names, value in pairs.items() if value != usual
    )
    note = "is rigid with Coulomb friction here; MuJoCo's is a spring with a time constant"
    loaded.notes.say("contact", note)
    return ContactSettings(
        alarm_distance=max(0.004, 4.0 * gap), contact_distance=gap, friction=usual, friction_pairs=others
    )
