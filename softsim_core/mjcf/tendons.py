"""Tendons of a MuJoCo model that run through soft bodies, as cables of ours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from softsim_core.actuation.cable import CableDescription
from softsim_core.arrays import Array
from softsim_core.mechanics.limits import JointLimits
from softsim_core.mjcf.carriers import Carrier, vector
from softsim_core.mjcf.flexes import SoftBody
from softsim_core.mjcf.reading import Loaded
from softsim_core.scene.joint import JointDescription

_NEAR = 0.02
"""A point may lie so far outside a soft body, in diagonals of the box around it."""


@dataclass(frozen=True, slots=True)
class _Site:
    """A point of a tendon: in a soft body, in the world or on a joint."""

    place: Array
    soft: str | None
    joint: str | None


def cables(
    loaded: Loaded, soft: tuple[SoftBody, ...], found: dict[int, Carrier]
) -> tuple[JointDescription, ...]:
    """A joint of kind cable for each tendon that can be one; of the others it is told why not."""
    m = loaded.model
    joints: list[JointDescription] = []
    for t in range(m.ntendon):
        called = f"tendon {m.tendon(t).name or t}"
        joint = _cable(loaded, t, called, soft, found)
        if joint is not None:
            joints.append(joint)
    return tuple(joints)


def _cable(
    loaded: Loaded, t: int, called: str, soft: tuple[SoftBody, ...], found: dict[int, Carrier]
) -> JointDescription | None:
    m, kinds = loaded.model, loaded.mujoco.mjtWrap
    wraps = range(int(m.tendon_adr[t]), int(m.tendon_adr[t] + m.tendon_num[t]))
    if any(m.wrap_type[w] != kinds.mjWRAP_SITE for w in wraps):
        loaded.told.say(called, "runs over joints, geoms or pulleys: it is not taken over")
        return None
    sites = [_site(loaded, int(m.wrap_objid[w]), soft, found) for w in wraps]
    inside = [k for k, site in enumerate(sites) if site.soft]
    bodies = {sites[k].soft for k in inside}
    if len(bodies) != 1 or inside != list(range(inside[0], inside[-1] + 1)):
        loaded.told.say(called, "does not run through one soft body: it is not taken over")
        return None
    if inside[0] == 0 and inside[-1] < len(sites) - 1:
        sites, inside = sites[::-1], [len(sites) - 1 - k for k in reversed(inside)]
    if inside[-1] != len(sites) - 1:
        loaded.told.say(called, "is pulled at both ends: it is not taken over")
        return None
    pulled = sites[inside[0] - 1] if inside[0] else None
    points = tuple(vector(sites[k].place) for k in inside)
    if len(points) + (pulled is not None) < 2:
        loaded.told.say(called, "has a single point: it is not taken over")
        return None
    (body,) = bodies
    limits, how = _command(loaded, t, called)
    for name in ("stiffness", "damping"):
        if np.any(getattr(m, f"tendon_{name}")[t]):
            loaded.told.say(called, f"{name} is not taken over: a cable does not stretch here")
    return JointDescription(
        name=loaded.names.new(m.tendon(t).name, "cable"),
        kind="cable",
        limits=limits,
        actuator=CableDescription(
            body=str(body),
            points=points,
            pull_point=None if pulled is None else vector(pulled.place),
            pull_on=None if pulled is None else pulled.joint,
            **how,
        ),
    )


def _site(loaded: Loaded, s: int, soft: tuple[SoftBody, ...], found: dict[int, Carrier]) -> _Site:
    m, b = loaded.model, int(loaded.model.site_bodyid[s])
    place = np.array(loaded.data.site_xpos[s])
    if loaded.is_vertex(b):
        owner = next((each.body.name for each in soft if (loaded.flex_bodies(each.flex) == b).any()), None)
        return _Site(place, owner, None)
    carrier = found[b]
    if carrier.kind == "joint":
        return _Site(place, None, carrier.name)
    if carrier.kind == "frame":  # a point of the soft body that the frame is in
        weld = carrier.body
        for each in soft:
            points = loaded.flex_points(each.flex)
            pinned = m.body_weldid[loaded.flex_bodies(each.flex)] == weld
            size = float(np.linalg.norm(np.ptp(points, axis=0)))
            if pinned.any() and np.linalg.norm(points - place, axis=1).min() < 10.0 * _NEAR * size:
                return _Site(place, each.body.name, None)
    return _Site(place, None, None)


def _command(loaded: Loaded, t: int, called: str) -> tuple[JointLimits, dict[str, Any]]:
    """Limits and control of the cable: by force for a motor, by displacement otherwise."""
    m, d = loaded.model, loaded.data
    of_tendon = loaded.mujoco.mjtTrn.mjTRN_TENDON
    acting = [k for k in range(m.nu) if m.actuator_trntype[k] == of_tendon and m.actuator_trnid[k, 0] == t]
    length = float(d.ten_length[t])
    if acting and not np.any(m.actuator_biasprm[acting[0]]):
        k = acting[0]
        scale = float(m.actuator_gear[k, 0] * m.actuator_gainprm[k, 0])
        pulls = (
            [-scale * each for each in m.actuator_ctrlrange[k].tolist()] if m.actuator_ctrllimited[k] else []
        )
        loaded.told.say(
            called, f"is commanded by its tension in N here, which is {-scale:g} times MuJoCo's control"
        )
        return JointLimits(lower=0.0, upper=max([*pulls, 0.0]) or math.inf), {"control": "force"}
    if acting:
        loaded.told.say(called, "is commanded by how much it is shortened, in m, and holds that exactly here")
    how: dict[str, Any] = {}
    if m.tendon_limited[t] and m.tendon_range[t, 1] > 0.0:
        rest = float(m.tendon_range[t, 1])
        if not math.isclose(rest, length, rel_tol=1e-6):
            how["rest_length"] = rest
    elif not acting:
        loaded.told.say(called, "is not limited in MuJoCo; here it does not get longer than it starts")
    return JointLimits(lower=0.0, upper=0.5 * length), how
