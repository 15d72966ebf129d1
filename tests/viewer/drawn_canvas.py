"""A scene of the page that only records what is drawn in it."""

from __future__ import annotations


class Drawn:
    """Stands for a thing in the 3-D view: keeps what it was given."""

    def __init__(self, **given: object) -> None:
        self.__dict__.update(given, visible=True, removed=False)

    def remove(self) -> None:
        self.removed = True

    def on_update(self, callback: object) -> None:
        self.callback = callback


class Canvas:
    """Records what is drawn, by name."""

    def __init__(self) -> None:
        self.drawn: dict[str, Drawn] = {}

    def add(
        self, name: str, points: object = None, faces: object = None, *_: object, **more: object
    ) -> Drawn:
        self.drawn[name] = Drawn(points=points, vertices=points, faces=faces, **more)
        return self.drawn[name]

    add_line_segments = add_point_cloud = add_mesh_simple = add_icosphere = add
    add_frame = add_label = add_box = add_transform_controls = add
