"""From scene descriptions to models: regions, masses, springs; what does not fit is refused in a sentence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import body, machine, scene, slab

from softsim_core import Simulation
from softsim_core.base import SceneError, Sphere
from softsim_core.physics.mechanics import FIXED, FREE, rotation_euler
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    Motion,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
    place_scene,
)
from softsim_core.scene.building import build

MESH = box_mesh((0.04, 0.01, 0.01), (4, 1, 1))


def test_bodies_follow_each_other_in_the_model() -> None:
    built = build(machine())
    bridge, rod = built.bodies
    assert (bridge.nodes.start, bridge.nodes.stop, rod.nodes.stop) == (0, 54, 54 + 20)
    assert rod.nodes.start == bridge.nodes.stop
    assert len(built.model.rest) == rod.nodes.stop
    np.testing.assert_array_equal(built.model.rest[rod.nodes], rod.mesh.points)
    in_rod = built.model.groups[0].cells[built.model.groups[0].body == 1]
    assert in_rod.min() == rod.nodes.start
    assert rod.boundary.min() == rod.nodes.start
    assert len(built.parameters.materials) == 2


def test_equal_masses_are_those_of_all_nodes_of_a_body() -> None:
    scene = machine()
    bodies = tuple(replace(each, mass_distribution="equal") for each in scene.bodies)
    built = build(replace(scene, bodies=bodies))
    assert built.model.mass[built.bodies[0].nodes] == pytest.approx(np.full(54, 0.03 / 54))
    assert built.model.mass[built.bodies[1].nodes] == pytest.approx(np.full(20, 0.01 / 20))


def test_regions_of_every_kind() -> None:
    model = build(machine()).model
    assert (model.region_of_node == FIXED).sum() == 6
    assert (model.region_of_node == FREE).sum() == len(model.free_nodes) == 74 - 6 - 3 * 6 - 2 * 4
    names = [region.name for region in model.regions]
    assert names == ["driven", "sprung", "middle", "slid", "lifted"]
    for number, region in enumerate(model.regions):
        np.testing.assert_array_equal(region.nodes, np.flatnonzero(model.region_of_node == number))
    middle = model.regions[2]
    assert (middle.frame, middle.joint, middle.reduced.tolist()) == (0, -1, [0, 1, 2, 3, 4, 5])
    assert [region.reduced.tolist() for region in model.regions[:2]] == [[6], [7]]
    assert model.reduced_size == 6 + 4
    assert model.compliant_joints.tolist() == [1, 2]
    assert model.spring[model.spring > 0.0] == pytest.approx(np.full(4, 40.0))


def test_regions_stand_where_the_rest_shape_is() -> None:
    """Joints that are not at 0 at rest, bases that are turned: placing the regions moves nothing."""
    model = build(machine()).model
    state = model.rest_state()
    np.testing.assert_allclose(state.positions, model.rest, atol=1e-16)
    hinge = model.joints[0]
    np.testing.assert_allclose(
        hinge.base_rotation, rotation_euler(np.radians([10.0, 20.0, 30.0])), atol=1e-15
    )
    assert state.joint_positions.tolist() == [0.1, 0.0, -0.002, 0.0]


def test_a_region_without_nodes_is_refused_with_where_the_body_is() -> None:
    with pytest.raises(SceneError, match=r"attachment nowhere: no node of body body.*body spans"):
        build(scene(body(MESH), attachments=(slab("nowhere", "world", 0.5),)))


def test_regions_that_share_nodes_are_refused() -> None:
    with pytest.raises(SceneError, match="attachments first and second share 4 nodes"):
        build(scene(body(MESH), attachments=(slab("first", "world", 0.0), slab("second", "free", 0.0))))


def test_a_soft_fixing_may_share_nodes_with_another_and_adds_up() -> None:
    fixings = (slab("a", "world", 0.0, stiffness=3.0), slab("b", "world", 0.0, stiffness=4.0))
    assert build(scene(body(MESH), attachments=fixings)).model.spring.max() == 7.0


@pytest.mark.parametrize("radius", [1e-4, 0.0101])
def test_a_free_frame_on_a_point_or_a_line_is_refused(radius: float) -> None:
    """One node, or a few on one line, do not say how the frame is turned."""
    line = box_mesh((0.04, 0.1, 0.1), (4, 1, 1))
    sphere = Sphere(center=(0.02, 0.0, 0.0), radius=radius)
    frame = AttachmentDescription(name="frame", body="body", to="free", sphere=sphere)
    with pytest.raises(SceneError, match=r"attachment frame: the . nodes of a free frame lie on one line"):
        build(scene(body(line), attachments=(frame,)))


def rod(*attachments: AttachmentDescription, effector: str | None) -> SceneDescription:
    """A straight rod along x, 0.5 m long, clamped at its start."""
    hanging = BodyDescription(
        name="rod",
        rod=RodDescription(
            centreline=((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)),
            section=RodSectionDescription(shape="rectangle", size=(0.01, 0.01)),
        ),
        material=MaterialDescription(law="rod", young_modulus=1e6, poisson_ratio=0.4),
        density=1000.0,
    )
    clamp = AttachmentDescription(name="clamp", body="rod", to="world", end="start")
    return SceneDescription(
        name="rod",
        gravity=(0.0, 0.0, 0.0),
        bodies=(hanging,),
        attachments=(clamp, *attachments),
        effector=effector,
    )


def test_a_free_frame_that_is_not_given_is_in_the_middle_of_its_region() -> None:
    """Also where the scene is mounted elsewhere, with which it turns."""
    tip = AttachmentDescription(name="tip", body="rod", to="free", end="end")
    described = rod(tip, effector="tip")
    pose = Simulation(described, backend="scipy").effector_pose
    assert pose is not None
    np.testing.assert_allclose(pose.position, (0.5, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(pose.quaternion_xyzw, (0.0, 0.0, 0.0, 1.0), atol=1e-12)
    turned = Motion(rotation_euler(np.array([0.0, 0.0, np.pi / 2])), np.array([0.0, 0.0, 1.0]))
    there = build(place_scene(described, turned)).model
    np.testing.assert_allclose(there.frame_rest[0], [(0.0, 0.5, 1.0)], atol=1e-12)
    np.testing.assert_allclose(there.frame_rest[1], [turned.rotation], atol=1e-12)


def test_a_region_relative_to_a_joint_moves_with_its_base() -> None:
    from softsim_core.base import Placement

    base = Placement(translation=(0.04, 0.005, 0.005), rotation_deg=(0.0, 0.0, 90.0))
    hinge = JointDescription(name="hinge", base=base)
    region = slab("tip", "hinge", 0.0, relative_to="hinge")  # the base's own x is the world's y
    model = build(
        scene(body(box_mesh((0.04, 0.01, 0.01), (4, 2, 1))), joints=(hinge,), attachments=(region,))
    ).model
    np.testing.assert_allclose(model.rest[model.regions[0].nodes, 1], 0.005)
    assert len(model.regions[0].nodes) == 5 * 2


def test_an_empty_scene_is_a_model_without_nodes() -> None:
    built = build(scene())
    assert built.model.rest.shape == (0, 3)
    assert built.parameters.materials == []
