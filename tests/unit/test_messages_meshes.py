"""Surfaces as messages: point cloud, topology, stress colours, and the marker spliced into its bytes."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from softsim_core.base import SoftSimError  # noqa: E402
from softsim_ros import messages  # noqa: E402
from softsim_ros.messages import (  # noqa: E402
    colour_table,
    linear_rgb,
    markers as marker_module,
)

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
STAMP = messages.time_message(12.5)


def corners(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(4, 3))


def test_a_point_cloud_keeps_vertices_and_stress_in_order() -> None:
    points, stress = corners(), np.array([0.0, 1.0e3, 2.0e5, 7.0])
    cloud = messages.point_cloud(STAMP, "world", points, stress)
    assert [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields] == [
        ("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("von_mises", 12, 7, 1)
    ]  # fmt: skip
    assert (cloud.width, cloud.height, cloud.point_step, cloud.row_step) == (4, 1, 16, 64)
    rows = messages.read_point_cloud(cloud)
    np.testing.assert_array_equal(rows[:, :3], points.astype(np.float32))
    np.testing.assert_array_equal(rows[:, 3], stress.astype(np.float32))


def test_an_empty_surface_is_an_empty_cloud() -> None:
    assert messages.point_cloud(STAMP, "world", np.zeros((0, 3)), np.zeros(0)).width == 0


def test_the_topology_holds_rest_vertices_and_triangles() -> None:
    mesh = messages.topology(corners(), TETRAHEDRON)
    assert [triangle.vertex_indices.tolist() for triangle in mesh.triangles] == TETRAHEDRON.tolist()
    assert [[p.x, p.y, p.z] for p in mesh.vertices] == corners().tolist()


def test_the_spliced_marker_is_the_marker_built_from_objects() -> None:
    template = messages.MarkerTemplate("world", TETRAHEDRON, alpha=0.5)
    for seed in (1, 2):
        points, stress = corners(seed), np.random.default_rng(seed).uniform(0.0, 1e4, 4)
        spliced = deserialize_message(template.fill(STAMP, points, stress), Marker)
        colours = np.column_stack([messages.stress_colours(stress, stress.max()), np.full(4, 0.5)])
        built = marker_module.triangle_marker(
            "world", points[TETRAHEDRON.ravel()], colours[TETRAHEDRON.ravel()]
        )
        built.header.stamp = STAMP
        assert spliced == deserialize_message(serialize_message(built), Marker)
        assert spliced.points[5].x == points[3, 0]  # exact: doubles
        assert len(spliced.points) == len(spliced.colors) == 12


def test_a_changed_serialised_form_is_refused_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(marker_module, "serialize_message", lambda message: serialize_message(message)[:-200])
    with pytest.raises(SoftSimError, match="cannot locate"):
        messages.MarkerTemplate("world", TETRAHEDRON)


def test_the_stress_scale_grows_evenly_in_lightness() -> None:
    table = colour_table(64).astype(float)
    assert ((table >= 0.0) & (table <= 1.0)).all()
    linear = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]  # of BT.709, not the space the table was made in
    assert (np.diff(luminance) > 0.0).all()
    white = linear_rgb(np.ones(1), np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(white, np.ones((1, 3)), atol=1e-6)


def test_stress_colours_run_from_zero_to_the_highest_and_stop_there() -> None:
    colours = messages.stress_colours(np.array([0.0, 50.0, 100.0, 1e9]), 100.0)
    table = colour_table()
    np.testing.assert_array_equal(colours[[0, 2, 3]], table[[0, 255, 255]])
    assert 0.2 < colours[1].mean() < 0.8
    np.testing.assert_array_equal(messages.stress_colours(np.zeros(2), 0.0), table[[0, 0]])
