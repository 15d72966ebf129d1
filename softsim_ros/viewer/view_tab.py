"""The tab View: what is shown, how it is coloured, what the mouse does, pictures."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from softsim_ros.viewer import readings
from softsim_ros.viewer.inner_view import SHOWN_AT_START, SWITCHES
from softsim_ros.viewer.panel import Inbox, Shown

if TYPE_CHECKING:
    from softsim_ros.viewer.viewer_node import Viewer


class ViewTab:
    """What changes the picture.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
        viewer: The node; its picture is what is switched.
    """

    def __init__(self, gui: Any, inbox: Inbox, viewer: Viewer) -> None:
        self._viewer, picture = viewer, viewer.picture
        stage = picture.stage
        inbox.on_change(gui.add_checkbox("Stress colours", stage.surface.by_stress), picture.colour_by_stress)
        top = gui.add_number("Top of the scale [kPa], 0: automatic", 0.0, min=0.0, step=1.0)
        inbox.on_change(top, picture.set_top_stress)
        self._legend = Shown(gui.add_html(""))
        inbox.on_change(gui.add_checkbox("Bodies", True), picture.show_bodies)
        inbox.on_change(gui.add_checkbox("Wire frame", False), picture.show_wireframe)
        for name, words in SWITCHES.items():
            box = gui.add_checkbox(words, name in SHOWN_AT_START)
            inbox.on_change(box, partial(picture.show_inner, name))
        for words, switch in (
            ("Cables", stage.cables.switch),
            ("Contacts and forces", stage.contacts.switch),
            ("Rigid bodies", stage.rigid.switch),
        ):
            inbox.on_change(gui.add_checkbox(words, True), switch)
        with gui.add_folder("Mouse"):
            inbox.on_change(gui.add_checkbox("Drag pulls (as Shift + drag)", False), stage.set_pull_mode)
            stiffness = gui.add_slider("Spring [N/m]", 1.0, 200.0, 1.0, viewer.pull_stiffness)
            inbox.on_change(stiffness, viewer.set_pull_stiffness)
        inbox.on_click(gui.add_button("Reset view"), picture.reset_view)
        gui.add_button("Save picture").on_click(save_picture)

    def refresh(self) -> None:
        """Show the scale of the stress."""
        surface = self._viewer.picture.stage.surface
        self._legend.show(readings.legend(surface.shown_top) if surface.by_stress else "")


def save_picture(event: Any) -> None:
    """Give the browser that asked a picture of what it shows (in viser's pool: it waits for the browser)."""
    from imageio.v3 import imwrite

    client = event.client
    if client is not None:
        picture = client.get_render(height=900, width=1200, timeout=30.0)
        client.send_file_download("softsim.png", imwrite("<bytes>", picture, extension=".png"))
