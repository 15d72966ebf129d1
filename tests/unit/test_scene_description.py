"""Rules of a scene description that no loader adds."""

from __future__ import annotations

import pytest

from softsim_core.errors import SceneError
from softsim_core.scene.description import SceneDescription


@pytest.mark.parametrize("name", ["", "two words", "9lives", "a/b", "é"])
def test_a_scene_name_is_a_ros_namespace(name: str) -> None:
    with pytest.raises(SceneError, match="scene: name must be letters, digits and underscores"):
        SceneDescription(name=name)
