"""The reference scenes select the nodes that the reference simulator selected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference_scenes import SILICONE_PLACEMENT, from_reference, full_tripod, held_centre

from softsim_core.base import Array
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.scene import AttachmentDescription, SceneDescription, load_scene, nodes_in

pytestmark = pytest.mark.reference

TIP_0 = "203 204 213 215 216 220 222 223 224 225 226 227 228 229 230 231 232 233 234"
TIP_1 = "140 141 169 172 173 174 181 185 191 192 197 199 208 209 210 211 219 221"
TIP_2 = "0 1 2 3 4 5 6 7 8 11 16 18 21 22 33 35 38 40"
CENTRE = "73 74 75 76 77 78 87 88 89 90 96 97 99 101 106 108"


def mesh_points(reference_dir: Path, level: str) -> Array:
    """Node coordinates of a GiD mesh as in the file, in [mm], shape (n, 3)."""
    lines = (reference_dir / "data" / "tripod" / f"tripod_{level}.gidmsh").read_text().splitlines()
    start, end = lines.index("Coordinates"), lines.index("End Coordinates")
    return np.array([[float(word) for word in line.split()[1:]] for line in lines[start + 1 : end]])


def placed(points: Array) -> Array:
    rotation = rotation_euler(np.radians(SILICONE_PLACEMENT.rotation_deg))
    return SILICONE_PLACEMENT.scale * points @ rotation.T + np.array(SILICONE_PLACEMENT.translation)


def selected(scene: SceneDescription, attachment: AttachmentDescription, points: Array) -> list[int]:
    if attachment.relative_to is not None:
        base = scene.joints[scene.joint_names.index(attachment.relative_to)].base
        points = (points - np.array(base.translation)) @ rotation_euler(np.radians(base.rotation_deg))
    region = attachment.box or attachment.sphere
    assert region is not None
    return nodes_in(region, points).tolist()


def test_placement_is_the_reference_loading_followed_by_the_change_of_frame(reference_dir: Path) -> None:
    x, y, z = mesh_points(reference_dir, "low").T
    in_reference = np.column_stack([x, -z + 30.0, y])  # +90 deg about x, +30 along y
    np.testing.assert_allclose(placed(np.column_stack([x, y, z])), from_reference(in_reference), atol=1e-15)


@pytest.mark.parametrize(
    ("name", "ids"), [("tip_0", TIP_0), ("tip_1", TIP_1), ("tip_2", TIP_2), ("centre", CENTRE)]
)
def test_regions_of_the_low_mesh_are_the_documented_nodes(reference_dir: Path, name: str, ids: str) -> None:
    scene = full_tripod(reference_dir, "low")
    attachment = next(each for each in scene.scene.attachments if each.name == name)
    points = placed(mesh_points(reference_dir, "low"))
    assert selected(scene, attachment, points) == [int(word) for word in ids.split()]


@pytest.mark.parametrize(
    ("level", "counts"), [("low", [19, 18, 18, 16]), ("mid", [61, 61, 56, 31]), ("high", [110, 111, 113, 71])]
)
def test_region_sizes(reference_dir: Path, level: str, counts: list[int]) -> None:
    scene = full_tripod(reference_dir, level)
    points = placed(mesh_points(reference_dir, level))
    assert [len(selected(scene, each, points)) for each in scene.scene.attachments] == counts


@pytest.mark.parametrize("level", ["low", "mid"])
def test_regions_are_the_simulators(reference_dir: Path, level: str) -> None:
    results = np.load(reference_dir / "simulator" / f"tripod_{level}.npz")
    scene = full_tripod(reference_dir, level)
    points = placed(mesh_points(reference_dir, level))
    keys = ("box0_indices", "box1_indices", "box2_indices", "center_indices")
    for key, attachment in zip(keys, scene.scene.attachments, strict=True):
        assert selected(scene, attachment, points) == sorted(results[key].tolist())


@pytest.mark.parametrize("level", ["low", "mid"])
def test_held_nodes_are_the_simulators(reference_dir: Path, level: str) -> None:
    results = np.load(reference_dir / "simulator" / f"held_centre_{level}.npz")
    scene = held_centre(reference_dir, level)
    points = placed(mesh_points(reference_dir, level))
    assert selected(scene.scene, scene.scene.attachments[0], points) == sorted(results["fixed"].tolist())


def test_fixing_box_of_step_3_holds_46_nodes_of_the_reference_mesh(reference_dir: Path) -> None:
    scene = load_scene("tripod_step_3")
    lying = placed(mesh_points(reference_dir, "low")) - np.array([0.0, 0.0, 0.030])
    assert len(selected(scene.scene, scene.scene.attachments[0], lying)) == 46
