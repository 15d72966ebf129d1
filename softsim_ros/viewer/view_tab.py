"""The tab View: what is shown, how it is coloured, what the mouse does, pictures."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from softsim_ros.viewer import readings
from softsim_ros.viewer.layers import LAYERS
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.picture import Picture
from softsim_ros.viewer.pull import MousePull
from softsim_ros.viewer.saved_view import view_file
from softsim_ros.viewer.surface import MM
from softsim_ros.viewer.tuning import KILO

NODE_SIZES: Final = (0.2, 5.0, 0.1)
"""Range and step of the size at which nodes are drawn, in [mm]."""


class ViewTab:
    """What changes the picture.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        picture: What is switched.
        mouse: The spring of a pull.
    """

    def __init__(self, gui: Any, inbox: Inbox, picture: Picture, mouse: MousePull) -> None:
        self._picture = picture
        view = picture.view
        self._legend = Shown(gui.add_html(""))
        top = gui.add_number(
            "Top of the scale [kPa], 0: automatic", (view.stress_top or 0.0) / KILO, min=0.0, step=1.0
        )
        inbox.on_change(top, lambda shown: picture.change(stress_top=KILO * shown or None))
        self._boxes = {
            name: inbox.on_change(
                gui.add_checkbox(words, getattr(view, name)), partial(_switch, picture, name)
            )
            for name, words in LAYERS.items()
        }
        size = gui.add_slider("Size of nodes [mm]", *NODE_SIZES, MM * view.node_size)
        inbox.on_change(size, lambda shown: picture.change(node_size=shown / MM))
        with gui.add_folder("Mouse"):
            inbox.on_change(gui.add_checkbox("Drag pulls (as Shift + drag)", False), picture.set_pull_mode)
            stiffness = gui.add_slider("Spring [N/m]", 1.0, 200.0, 1.0, mouse.stiffness)
            inbox.on_change(stiffness, mouse.set_stiffness)
        inbox.on_click(gui.add_button("Reset view"), picture.reset_view)
        save = gui.add_button("Save view", hint="a file, and where Reset view goes from now on")
        save.on_click(partial(_save_view, inbox, picture))
        gui.add_button("Save picture").on_click(save_picture)

    def refresh(self) -> None:
        """Show the scale of the stress, and what is switched."""
        surface, view = self._picture.stage.surface, self._picture.view
        for name, box in self._boxes.items():
            box.show(getattr(view, name))
        self._legend.show(readings.legend(surface.shown_top) if surface.by_stress else "")


def _switch(picture: Picture, layer: str, shown: bool) -> None:
    picture.change(**{layer: shown})


async def _save_view(inbox: Inbox, picture: Picture, event: Any) -> None:
    """Keep the camera of the browser that asked, and give it the view as a file."""
    client = event.client
    if client is None:
        return
    position, target = client.camera.position.tolist(), client.camera.look_at.tolist()

    def save() -> None:
        picture.save_view(position, target)
        text = view_file(picture.robot, picture.view)
        client.send_file_download(f"{picture.robot.name}_view.yaml", text.encode(), save_immediately=True)

    inbox.put(save)


def save_picture(event: Any) -> None:
    """Give the browser that asked a picture of what it shows (in viser's pool: it waits for the browser)."""
    from imageio.v3 import imwrite

    client = event.client
    if client is not None:
        picture = client.get_render(height=900, width=1200, timeout=30.0)
        content = imwrite("<bytes>", picture, extension=".png")
        client.send_file_download("softsim.png", content, save_immediately=True)
