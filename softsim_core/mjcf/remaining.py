"""Elements and attributes of a MuJoCo model that a scene of ours has nothing for, by name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from softsim_core.mjcf.source import Source

_POSE = "name class pos quat axisangle xyaxes zaxis euler"
_READ: Final = {
    "option": "timestep gravity",
    "flag": "contact gravity filterparent",
    "body": f"{_POSE} childclass mocap",
    "frame": f"{_POSE} childclass",
    "inertial": f"{_POSE} mass diaginertia fullinertia",
    "joint": "name class type pos axis ref range limited stiffness springref armature",
    "freejoint": "name align",
    "geom": f"{_POSE} type size fromto mass density mesh rgba contype conaffinity friction hfield "
    "shellinertia fitscale group",
    "site": f"{_POSE} type size fromto group rgba",
    "flexcomp": f"{_POSE} type group dim count spacing point element texcoord mass inertiabox file rigid "
    "radius rgba origin scale dof cellcount",
    "flex": "name class dim radius body vertex element rgba node group dof cellcount texcoord elemtexcoord",
    "elasticity": "young poisson damping",
    "pin": "id range grid gridrange",
    "exclude": "name body1 body2",
    "spatial": "name class limited range stiffness damping group width rgba",
    "position": "name class joint tendon kp gear ctrllimited ctrlrange",
    "motor": "name class joint tendon gear ctrllimited ctrlrange",
    "general": "name class joint tendon gear ctrllimited ctrlrange gainprm biasprm gaintype biastype dyntype",
    "mesh": None,
}
"""Attributes that are taken over, or of which the conversion tells by itself; None: all of them."""

_UNDER: Final = {
    ("flexcomp", "contact"): "contype conaffinity friction",
    ("flex", "contact"): "contype conaffinity friction",
    ("spatial", "site"): "site",
    ("spatial", "geom"): "geom sidesite",
}
"""The same of tags that mean something else under others."""

_WHOLE: Final = ("mujoco", "compiler", "default", "worldbody", "include", "replicate", "asset", "deformable")
_HOLDERS: Final = ("contact", "tendon", "actuator", "extension", "custom")
"""Tags that only hold others, and what MuJoCo's own reader makes something of."""

_PICTURES: Final = ("light", "camera", "texture", "material", "skin", "visual", "statistic", "layer")
_SECTIONS: Final = ("sensor", "equality", "keyframe", "custom", "extension", "visual")
_MOST_NAMES: Final = 4


def remaining(source: Source) -> tuple[str, ...]:
    """A line for each element and attribute that is not taken over, with the names of what has it."""
    found: dict[str, dict[str, list[str]]] = {}
    for element, above in source.elements():
        tag, parent = element.tag, above[-1] if above else ""
        if tag in _PICTURES or any(each in ("visual", "skin") for each in above):
            found.setdefault("pictures alone", {}).setdefault("", []).append(tag)
        elif parent in _SECTIONS:
            found.setdefault(f"{parent}/{tag}", {}).setdefault("", []).append(element.get("name", ""))
        elif not _is_holder(tag, parent) and not _is_inside_one(above):
            _note(found, tag, parent, dict(element.attrib))
    return tuple(_lines(found))


def _is_holder(tag: str, parent: str) -> bool:
    return tag in _WHOLE or (tag in (*_HOLDERS, *_SECTIONS) and parent in ("mujoco", ""))


def _is_inside_one(above: tuple[str, ...]) -> bool:
    """Whether something above it is told of as a whole."""
    known = (*_READ, *_WHOLE, *_HOLDERS)
    return any(each not in known for each in above)


def _note(found: dict[str, dict[str, list[str]]], tag: str, parent: str, attributes: dict[str, str]) -> None:
    read: str | None = _UNDER.get((parent, tag), _READ.get(tag, ""))
    called = f"{parent}/{tag}" if (parent, tag) in _UNDER or tag not in _READ else tag
    if tag not in _READ and (parent, tag) not in _UNDER:
        found.setdefault(called, {}).setdefault("", []).append(attributes.get("name", ""))
        return
    for name in attributes:
        if read is not None and name not in read.split():
            found.setdefault(called, {}).setdefault(name, []).append(attributes.get("name", ""))


def _lines(found: dict[str, dict[str, list[str]]]) -> Iterator[str]:
    for tag, attributes in found.items():
        if tag == "pictures alone":
            kinds = attributes[""]
            counted = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
            yield f"pictures alone, not taken over: {counted}"
            continue
        by_names: dict[tuple[str, ...], list[str]] = {}
        for attribute, names in attributes.items():
            by_names.setdefault(tuple(names), []).append(attribute)
        for owners, which in by_names.items():
            what = ", ".join(each for each in which if each) or "the whole element"
            yield f"{tag}: {what} not taken over{_of(owners)}"


def _of(names: tuple[str, ...]) -> str:
    given = [name for name in names if name]
    shown = ", ".join(given[:_MOST_NAMES]) + (", ..." if len(given) > _MOST_NAMES else "")
    if len(names) == 1:
        return f" ({shown})" if shown else ""
    return f" ({len(names)} of them{': ' + shown if shown else ''})"
