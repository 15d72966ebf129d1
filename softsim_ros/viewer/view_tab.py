"""The tab View: what is shown, how it is coloured, what the mouse does, pictures."""

from __future__ import annotations

import io
import itertools
import time
from functools import partial
from typing import Any, Final

from softsim_core.scene.view import STRESS_MAPS, Section
from softsim_ros.viewer import readings
from softsim_ros.viewer.layers import LAYERS
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.picture import Picture
from softsim_ros.viewer.pull import MousePull
from softsim_ros.viewer.saved_view import view_file
from softsim_ros.viewer.surface import MM, band_colours
from softsim_ros.viewer.tuning import KILO

NODE_SIZES: Final = (0.2, 5.0, 0.1)
"""Range and step of the size at which nodes are drawn, in [mm]."""

CLIP_S: Final = 4.0
CLIP_SIZE: Final = (480, 640)
"""Height and width of a clip in pixels."""
UNCUT: Final = "nothing"
AXES: Final = ("x", "y", "z")


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
        colours = gui.add_dropdown("Colours of stress", STRESS_MAPS, initial_value=view.stress_map)
        self._colours = inbox.on_change(colours, lambda chosen: picture.change(stress_map=chosen))
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
        self._add_section(gui, inbox)
        size = gui.add_slider("Size of nodes [mm]", *NODE_SIZES, MM * view.node_size)
        inbox.on_change(size, lambda shown: picture.change(node_size=shown / MM))
        with gui.add_folder("Mouse"):
            inbox.on_change(gui.add_checkbox("Drag pulls (as Shift + drag)", False), picture.set_pull_mode)
            stiffness = gui.add_slider("Spring [N/m]", 1.0, 200.0, 1.0, mouse.stiffness)
            inbox.on_change(stiffness, mouse.set_stiffness)
        inbox.on_change(gui.add_checkbox("Dark page", picture.is_dark), picture.set_dark)
        inbox.on_click(gui.add_button("Reset view"), picture.reset_view)
        save = gui.add_button("Save view", hint="a file, and where Reset view goes from now on")
        save.on_click(partial(_save_view, inbox, picture))
        gui.add_button("Save picture").on_click(save_picture)
        clip = gui.add_button("Save clip", hint=f"the next {CLIP_S:g} s of the picture, moving")
        clip.on_click(save_clip)

    def _add_section(self, gui: Any, inbox: Inbox) -> None:
        """Where bodies are cut open: an axis, and how far along it."""
        cut = self._picture.view.section
        axis = gui.add_dropdown("Cut open along", (UNCUT, *AXES), initial_value=cut.axis if cut else UNCUT)
        at = gui.add_slider("Cut at [%]", 0.0, 100.0, 1.0, 50.0, hint="of the bodies' extent at rest")

        def change(_: Any) -> None:
            section = None
            if axis.value in AXES:
                lower, upper = self._picture.extent(AXES.index(axis.value))
                section = Section(axis=axis.value, at=(lower + 0.01 * at.value * (upper - lower)) / MM)
            self._picture.change(section=section)

        for handle in (axis, at):
            inbox.on_change(handle, change)

    def refresh(self) -> None:
        """Show the scale of the stress, and what is switched."""
        surface, view = self._picture.stage.surface, self._picture.view
        for name, box in self._boxes.items():
            box.show(getattr(view, name))
        self._colours.show(view.stress_map)
        colours = band_colours(view.stress_map)
        self._legend.show(readings.legend(surface.shown_top, colours) if view.stress else "")


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


def save_clip(event: Any) -> None:
    """Give the browser that asked a clip of what it shows (in viser's pool: it waits for the browser)."""
    from PIL import Image

    client = event.client
    if client is None:
        return
    height, width = CLIP_SIZE
    frames, times = [], [time.monotonic()]
    while times[-1] - times[0] < CLIP_S:
        render = client.get_render(height=height, width=width, transport_format="jpeg", timeout=30.0)
        frames.append(Image.fromarray(render[..., :3]))
        times.append(time.monotonic())
    content = io.BytesIO()
    lasting = [max(1, round(1e3 * (b - a))) for a, b in itertools.pairwise(times)]
    frames[0].save(
        content, "WEBP", save_all=True, append_images=frames[1:], duration=lasting, loop=0, quality=80
    )
    client.send_file_download("softsim.webp", content.getvalue(), save_immediately=True)


def save_picture(event: Any) -> None:
    """Give the browser that asked a picture of what it shows (in viser's pool: it waits for the browser)."""
    from imageio.v3 import imwrite

    client = event.client
    if client is not None:
        picture = client.get_render(height=900, width=1200, timeout=30.0)
        content = imwrite("<bytes>", picture, extension=".png")
        client.send_file_download("softsim.png", content, save_immediately=True)
