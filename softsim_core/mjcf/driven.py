"""Joints and cables of a scene, and what drives them, in a MuJoCo model."""

from __future__ import annotations

import math

import numpy as np

from softsim_core.actuation.cable import CableDescription
from softsim_core.actuation.cable.builder import cable_points
from softsim_core.arrays import Array
from softsim_core.mechanics.model import FIXED, FREE, Model
from softsim_core.mjcf.elements import Draft, add, words
from softsim_core.scene.joint import JointDescription

_FIRM = {"revolute": 1e3, "prismatic": 1e5}
"""Stiffness in [N m/rad] or [N/m] of servos that give way to nothing in a scene of ours."""
_TIGHT = 1e5
"""The same of cables in [N/m]."""
_HELD_KG_M2 = 1e-4


def joint_attributes(model: Model, j: int, joint: JointDescription) -> dict[str, str]:
    """A joint that moves a frame, where it starts."""
    axis = model.joints[j].base_rotation @ model.joints[j].axis
    found = {
        "name": joint.name,
        "type": "hinge" if joint.kind == "revolute" else "slide",
        "axis": words(axis),
        "ref": words([joint.rest]),
        "armature": words([joint.inertia or (0.0 if joint.stiffness else _HELD_KG_M2)]),
    }
    if math.isfinite(joint.limits.lower) and math.isfinite(joint.limits.upper):
        found["range"] = words([joint.limits.lower, joint.limits.upper])
    return found


def add_servos(draft: Draft) -> None:
    """A position actuator for each joint that moves a frame; what other joints are is told."""
    for joint in draft.scene.joints:
        if joint.moves_frame:
            stiffness = joint.stiffness or _FIRM[joint.kind]
            add(
                draft.section("actuator"),
                "position",
                name=joint.name,
                joint=joint.name,
                kp=words([stiffness]),
                **({} if joint.stiffness else {"dampratio": "1"}),
            )
            if joint.stiffness is None:
                draft.told.say(
                    f"joint {joint.name}",
                    f"follows its command with {stiffness:g} N·m/rad (N/m) there",
                )
            if joint.rest:
                draft.told.say(f"joint {joint.name}", f"set its control to {joint.rest:g}, where it starts")
            if any(joint.base.rotation_deg) or joint.limits.speed < math.inf:
                draft.told.say(f"joint {joint.name}", "has no limit of speed in the model")
        elif not isinstance(joint.actuator, CableDescription):
            draft.told.say(f"joint {joint.name}", f"kind {joint.kind}: MuJoCo has nothing for it")


def add_cables(draft: Draft) -> None:
    """A tendon through the points of each cable, with what pulls it."""
    for joint in draft.scene.joints:
        if isinstance(joint.actuator, CableDescription):
            _add_cable(draft, joint, joint.actuator)


def _add_cable(draft: Draft, joint: JointDescription, cable: CableDescription) -> None:
    body = next(k for k, each in enumerate(draft.scene.bodies) if each.name == cable.body)
    points = cable_points(cable, draft.built.bodies[body].solid)
    tendon = add(draft.section("tendon"), "spatial", name=joint.name)
    places: list[tuple[Array, str]] = [(point, _owner(draft, body, point)) for point in points]
    if cable.pull_point is not None:
        places.insert(0, (np.array(cable.pull_point), cable.pull_on or "world"))
    for k, (point, owner) in enumerate(places):
        _add_site(draft, f"{joint.name}_{k}", point, owner)
        add(tendon, "site", site=f"{joint.name}_{k}")
    draft.told.say(f"cable {joint.name}", "its points sit on the nearest nodes in the model")
    if not cable.pull_only:
        draft.told.say(f"cable {joint.name}", "pushes, too: in the model it pulls only")
    most = cable.max_tension or 1e6
    section = draft.section("actuator")
    if cable.control == "force":
        add(
            section,
            "motor",
            name=joint.name,
            tendon=joint.name,
            gear="-1",
            ctrlrange=words([0.0, _bounded(joint, most)]),
        )
        return
    length = float(np.linalg.norm(np.diff([place for place, _ in places], axis=0), axis=1).sum())
    rest = cable.rest_length or length
    draft.told.say(f"cable {joint.name}", f"holds its displacement with {_TIGHT:g} N/m in the model")
    add(
        section,
        "general",
        name=joint.name,
        tendon=joint.name,
        gear="-1",
        gainprm=words([_TIGHT]),
        biastype="affine",
        biasprm=words([-_TIGHT * rest, -_TIGHT, 0.0]),
        forcerange=words([0.0, most]),
        ctrlrange=words([max(joint.limits.lower, -rest), _bounded(joint, rest)]),
    )


def _bounded(joint: JointDescription, otherwise: float) -> float:
    return joint.limits.upper if math.isfinite(joint.limits.upper) else otherwise


def _owner(draft: Draft, body: int, point: Array) -> str:
    """The body of the node of a soft body that is nearest to a point."""
    model, own = draft.built.model, draft.built.bodies[body]
    nearest = int(np.argmin(np.linalg.norm(model.rest[own.nodes] - point, axis=1)))
    region = int(model.region_of_node[own.nodes.start + nearest])
    if region == FREE:
        return f"{own.name}_{nearest}"
    if region == FIXED:
        return "world"
    moved = model.regions[region]
    return model.frame_names[moved.frame] if moved.frame >= 0 else model.joints[moved.joint].name


def _add_site(draft: Draft, name: str, point: Array, owner: str) -> None:
    if owner == "world":
        add(draft.world, "site", name=name, pos=words(point))
    elif owner in draft.carriers:
        element, origin = draft.carriers[owner]
        add(element, "site", name=name, pos=words(point - origin))
    else:
        element = next(each for each in draft.world if each.get("name") == owner)
        start = np.array([float(word) for word in element.get("pos", "0 0 0").split()])
        add(element, "site", name=name, pos=words(point - start))
