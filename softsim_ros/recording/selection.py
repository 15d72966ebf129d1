"""Which topics of a graph a recording takes."""

from __future__ import annotations

from collections.abc import Sequence

SHARED = ("/diagnostics", "/tf", "/tf_static", "/clock")
"""Topics that all robots share."""

LEFT_OUT = ("mesh/marker", "step_profile", "recorder/enabled", "scene/edit", "scene/proposal")
"""Not recorded unless asked for: made from mesh/points, at five times the size; each step ten times over; the
recorder's own state; edits of the scene's file."""


class Selection:
    """The robot's topics and the shared ones, or those that were named.

    Args:
        namespace: Namespace of the robot, such as "/tripod".
        names: Topics to take, absolute or below the namespace; none takes all but `LEFT_OUT`.
    """

    def __init__(self, namespace: str, names: Sequence[str] = ()) -> None:
        self._prefix = namespace.rstrip("/") + "/"
        self._names = {self.absolute(name) for name in names}
        self._left_out = {self.absolute(name) for name in LEFT_OUT}

    def absolute(self, name: str) -> str:
        """Full name of a topic."""
        return name if name.startswith("/") else self._prefix + name

    def wants(self, topic: str) -> bool:
        """Whether a topic of the graph is taken."""
        if self._names:
            return topic in self._names
        if "/_" in topic:  # hidden, by ROS's rule, such as those of an action
            return False
        return topic in SHARED or (topic.startswith(self._prefix) and topic not in self._left_out)
