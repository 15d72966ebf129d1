"""Values in another unit are warned of when a scene is built, however it came."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from small_scenes import scene

from softsim_core import load_scene
from softsim_core.base import Placement
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mesh import Shape, box_mesh, write_tets
from softsim_core.scene import (
    BodyDescription,
    CollisionDescription,
    MaterialDescription,
    RigidBodyDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)
from softsim_core.scene.building import build

SILICONE = MaterialDescription(young_modulus=2e5, poisson_ratio=0.4)


def told(made: SceneDescription) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        build(made)
    return [str(each.message) for each in caught]


def block(
    size: float = 0.1, density: float = 1070.0, material: MaterialDescription = SILICONE
) -> BodyDescription:
    mesh = box_mesh((size, 0.3 * size, 0.3 * size), (2, 1, 1), (0.0, 0.0, 0.0), "block")
    return BodyDescription(name="block", mesh=mesh, material=material, density=density)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (block(size=103.0), "body block: is 103 m large.*drawn in mm.*`placement: .scale: 0.001.`"),
        (block(size=1e-4), "body block: is 0.1 mm large.*scaled twice"),
        (block(density=1.07), "body block: has a density of 1.07 kg/m.3.*in g/cm.3. Then write 1070"),
        (block(density=1.07e6), "has a density of 1.07e.06 kg/m.3.*in g/m.3. Then write 1070"),
        (replace(block(), density=None, total_mass=9.6), "density of .*`total_mass: 9.6` is in kg.*in g"),
        (block(material=SILICONE.with_values(young_modulus=0.2)), "young_modulus is 0.2 Pa.*kPa or MPa"),
        (block(material=SILICONE.with_values(young_modulus=2e15)), "young_modulus is 2e.15 Pa.*unit twice"),
        (block(material=MaterialDescription(law="yeoh", c1=0.036, poisson_ratio=0.4)), "c1 is 0.036 Pa"),
    ],
)
def test_a_slip_of_units_is_named(made: BodyDescription, message: str) -> None:
    assert len(told(scene(made))) == 1
    with pytest.warns(UserWarning, match=message):
        build(scene(made))


def sheet(thickness: float, contact: ContactSettings) -> SceneDescription:
    mesh = box_mesh(
        (0.02, 0.02, thickness), (8, 8, max(1, round(thickness / 0.0025))), (0.0, 0.0, 0.0), "sheet"
    )
    body = BodyDescription(name="sheet", mesh=mesh, material=SILICONE, density=1070.0)
    floor = RigidBodyDescription(
        name="floor", shape=Shape(box=(1.0, 1.0, 0.001)), pose=Placement(translation=(0.0, 0.0, -0.1))
    )
    collisions = tuple(CollisionDescription(name=name, body=name) for name in ("sheet", "floor"))
    return replace(scene(body), name="sheets", rigid_bodies=(floor,), collisions=collisions, contact=contact)


def test_contact_distances_above_a_thickness_are_named() -> None:
    large = ContactSettings(alarm_distance=0.004, contact_distance=0.001)
    assert told(sheet(0.002, large)) == []
    assert [each.split(";")[0] for each in told(sheet(0.0008, large))] == [
        "contact: alarm_distance is 4 mm, more than twice the thickness of body sheet, 0.8 mm",
        "contact: contact_distance is 1 mm, more than the thickness of body sheet, 0.8 mm",
    ]


@pytest.mark.parametrize(("thickness", "alarm"), [(0.02, 0.004), (0.004, 0.004), (0.0008, 0.0008)])
def test_default_contact_distances_fit_the_thinnest_body(thickness: float, alarm: float) -> None:
    made = sheet(thickness, ContactSettings())
    assert told(made) == []
    limits = build(made).contact
    assert limits.alarm_distance == pytest.approx(alarm)
    assert limits.contact_distance == pytest.approx(alarm / 4)
    assert limits.tolerance == pytest.approx(1e-8 * alarm / 0.004)


@pytest.mark.parametrize(
    ("given", "alarm", "gap"),
    [
        (ContactSettings(alarm_distance=0.0005), 0.0005, 0.000125),
        (ContactSettings(contact_distance=0.002), 0.004, 0.002),
        (ContactSettings(contact_distance=0.01), 0.04, 0.01),
        (ContactSettings(alarm_distance=0.003, contact_distance=0.0), 0.003, 0.0),
    ],
)
def test_a_default_contact_distance_fits_the_one_given(
    given: ContactSettings, alarm: float, gap: float
) -> None:
    assert given.limits()[:2] == (alarm, gap)


def test_plausible_values_are_not_warned_of() -> None:
    assert told(scene(block(), block_of_steel())) == []
    floor = RigidBodyDescription(name="floor", shape=Shape(box=(10.0, 10.0, 0.1)))
    assert told(scene(block(), rigid_bodies=(floor,))) == []


def block_of_steel() -> BodyDescription:
    return replace(block(density=7850.0, material=SILICONE.with_values(young_modulus=2.1e11)), name="steel")


def test_rods_and_rigid_bodies_are_looked_at_too() -> None:
    section = RodSectionDescription(shape="ellipse", size=(4.0, 4.0))
    rod = RodDescription(centreline=((0.0, 0.0, 0.0), (200.0, 0.0, 0.0)), section=section, elements=4)
    material = MaterialDescription(law="rod", young_modulus=0.9, poisson_ratio=0.4)
    drawn = BodyDescription(name="rod", rod=rod, material=material, density=1.1)
    ball = RigidBodyDescription(name="ball", shape=Shape(sphere=20.0), mass=0.1)
    messages = told(scene(drawn, rigid_bodies=(ball,)))
    owners = [each.partition(":")[0] for each in messages]
    assert owners == ["body rod", "rigid body ball", "body rod", "body rod"]


def test_a_file_in_millimetres_is_warned_of_once_scaled_it_is_not(tmp_path: Path) -> None:
    write_tets(tmp_path / "finger.vtk", box_mesh((103.0, 20.0, 20.0), (2, 1, 1), (0.0, 0.0, 0.0), "finger"))
    text = (
        "name: finger\nbodies:\n  - name: finger\n    mesh: {file: finger.vtk SCALE}\n"
        "    material: {young_modulus: 2.0e+5, poisson_ratio: 0.4}\n    density: 1070\n"
    )
    file = tmp_path / "finger.yaml"
    for scale, warned in (("", 1), (", placement: {scale: 0.001}", 0)):
        file.write_text(text.replace(" SCALE", scale))
        assert len(told(load_scene(file).scene)) == warned
