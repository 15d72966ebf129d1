"""How large the reference's meshes are, to tell beside ours."""

from __future__ import annotations

_SILICONE = {"low": (235, 579), "mid": (781, 2684), "high": (1455, 5221)}
_FINGER = (158, 389)
_FINGERS = {"cable_finger": 1, "gripper_free": 3, "gripper_grasp": 3}


def reference_size(scene: str, mesh: str) -> tuple[int, int]:
    """Nodes and tetrahedra of a benchmark scene on the reference's mesh of the same level."""
    if scene in _FINGERS:
        return _FINGERS[scene] * _FINGER[0], _FINGERS[scene] * _FINGER[1]
    return _SILICONE[mesh.removeprefix("reference_")]
