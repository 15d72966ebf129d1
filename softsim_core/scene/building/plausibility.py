"""Detection of implausible values in a scene: most often a length, density or modulus in another unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem import ElementGroup
from softsim_core.scene import SceneDescription
from softsim_core.scene.building.bodies import Body
from softsim_core.scene.building.contact_builder import RigidBody, thicknesses

SIZES = (1e-3, 3.0)
"""Plausible extents of bodies in [m]."""

DENSITIES = (50.0, 25_000.0)
"""Plausible densities in [kg/m^3]: from foam to the heaviest metals."""

MODULI = (100.0, 1e12)
"""Plausible moduli in [Pa]: from the softest gels to diamond."""

ROUNDED = 1.001
"""Factor by which a distance may exceed a thickness, which for round bodies is measured on facets."""


def implausible(
    scene: SceneDescription,
    bodies: Sequence[Body],
    groups: Sequence[ElementGroup],
    rigid: Sequence[RigidBody],
) -> list[str]:
    """Return messages on implausible values of a scene and of what it is compiled to.

    Rigid bodies on the world, such as a floor, may have any size.
    """
    found = [(f"body {each.name}", each.mesh.points) for each in bodies]
    moving = [each for each in rigid if each.on != "world" or each.free >= 0]
    found += [(f"rigid body {each.name}", each.surface.points) for each in moving]
    return [
        *(message for owner, points in found for message in _size(owner, points)),
        *_densities(scene, bodies, groups),
        *_moduli(scene),
        *_contact_distances(scene, bodies, rigid),
    ]


def _size(owner: str, points: Array) -> list[str]:
    extent = float(np.ptp(points, axis=0).max(initial=0.0))
    if extent > SIZES[1]:
        return [
            f"{owner}: is {extent:.4g} m large; lengths are in m. Was it drawn in mm? Then give its mesh "
            "`placement: {scale: 0.001}`"
        ]
    if 0.0 < extent < SIZES[0]:
        return [
            f"{owner}: is {1e3 * extent:.4g} mm large; lengths are in m. Was it drawn in m, or scaled twice? "
            "Then change the `scale` of its `placement`"
        ]
    return []


def _densities(scene: SceneDescription, bodies: Sequence[Body], groups: Sequence[ElementGroup]) -> list[str]:
    volumes = np.zeros(len(bodies))
    for group in groups:
        volumes += np.bincount(group.body, group.volumes, minlength=len(bodies))
    messages = []
    for description, volume in zip(scene.bodies, volumes.tolist(), strict=True):
        density = description.density
        if description.total_mass is not None and not description.is_rod:
            density = description.total_mass / volume
        if density is None or DENSITIES[0] <= density <= DENSITIES[1]:
            continue
        if description.total_mass is not None:
            slip = f"`total_mass: {description.total_mass:g}` is in kg"
            slip += ". Was it meant in g?" if density > DENSITIES[1] else "; is its mesh of the right size?"
        elif density < DENSITIES[0]:
            slip = f"`density` is in kg/m^3. Was it meant in g/cm^3? Then write {1e3 * density:g}"
        else:
            slip = f"`density` is in kg/m^3. Was it meant in g/m^3? Then write {1e-3 * density:g}"
        messages.append(f"body {description.name}: has a density of {density:.4g} kg/m^3; {slip}")
    return messages


def _moduli(scene: SceneDescription) -> list[str]:
    messages = []
    for (owner, values), law in zip(scene.materials, scene.laws, strict=True):
        moduli = {each.name: values[each.name] for each in law.parameters if each.unit == "Pa"}
        if not moduli:
            continue
        name = max(moduli, key=lambda each: abs(moduli[each]))
        value = abs(moduli[name])
        if 0.0 < value < MODULI[0]:
            slip = f"Was it meant in kPa or MPa? Then write {1e3 * value:g} or {1e6 * value:g}"
        elif value > MODULI[1]:
            slip = "It is stiffer than any material; was it multiplied by a unit twice?"
        else:
            continue
        messages.append(f"body {owner}: {name} is {value:.4g} Pa; moduli are in Pa. {slip}")
    return messages


def _contact_distances(
    scene: SceneDescription, bodies: Sequence[Body], rigid: Sequence[RigidBody]
) -> list[str]:
    """Return messages on explicit distances that are too large for a body's thickness.

    The alarm distance is a margin of the search, so it may be somewhat larger than a body is thick.
    """
    settings = scene.contact
    allowed = {"alarm_distance": (2.0, "twice "), "contact_distance": (1.0, "")}
    named = {name: getattr(settings, name) for name in allowed}
    distances = {name: value for name, value in named.items() if value is not None}
    widths = thicknesses(scene, bodies, rigid) if distances else {}
    if not widths:
        return []
    thinnest = min(widths, key=lambda each: widths[each])
    width = widths[thinnest]
    return [
        f"contact: {name} is {1e3 * value:.3g} mm, more than {allowed[name][1]}the thickness of "
        f"body {thinnest}, {1e3 * width:.3g} mm; give a smaller one, or leave it out: the default fits the "
        "thinnest body"
        for name, value in distances.items()
        if value > ROUNDED * allowed[name][0] * width
    ]
