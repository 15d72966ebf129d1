"""What a browser may send, checked before viser sees it: values of controls that are there, camera, mouse.

viser itself lets a page change any property of a control, its callbacks too, upload files without end, and
call what was never asked for. Here a message passes only if it is one of `RULES`, has just the fields of that
kind, and each of them is what that field may be.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import msgspec

MOST_BYTES: Final = 16 * 2**20
"""Longest message: a picture of the view, which the page was asked for."""

LONGEST_TEXT: Final = 20_000
LARGEST: Final = 1.0e9
RATE_HZ: Final = 300.0
"""So many messages a second are taken from one page; a faster one has to wait."""

BURST: Final = 1000
MOST_REFUSED: Final = 100
"""After so many refused messages a connection is closed."""

Check = Callable[[Any], bool]


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _numbers(count: int) -> Check:
    return lambda value: isinstance(value, list) and len(value) == count and all(map(_number, value))


def _whole_or_none(value: Any) -> bool:
    return value is None or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**31)


def _text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST_TEXT


def _text_or_none(value: Any) -> bool:
    return value is None or _text(value)


def _one_of(*allowed: str) -> Check:
    return lambda value: isinstance(value, str) and value in allowed


def _bytes(value: Any) -> bool:
    return isinstance(value, bytes)


def _value_alone(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == {"value"}


_NODE: Final[dict[str, Check]] = {"name": _text, "owner": _text}

RULES: Final[Mapping[str, Mapping[str, Check]]] = {
    "GuiUpdateMessage": {"uuid": _text, "updates": _value_alone},
    "CommandTriggerMessage": {"uuid": _text},
    "ViewerCameraMessage": {
        **{name: _numbers(3) for name in ("position", "look_at", "up_direction")},
        **dict.fromkeys(("fov", "near", "far", "image_height", "image_width"), _number),
        "wxyz": _numbers(4),
    },
    "TransformControlsUpdateMessage": {**_NODE, "wxyz": _numbers(4), "position": _numbers(3)},
    "TransformControlsDragStartMessage": _NODE,
    "TransformControlsDragEndMessage": _NODE,
    "SceneNodeDragMessage": {
        **_NODE,
        **{name: _numbers(3) for name in ("start_position", "end_position")},
        **{name: _numbers(2) for name in ("start_screen_pos", "end_screen_pos")},
        "phase": _one_of("start", "update", "end"),
        "instance_index": _whole_or_none,
        "button": _one_of("left", "middle", "right"),
        "modifier": _text_or_none,
    },
    "SceneNodeClickMessage": {
        **_NODE,
        **{name: _numbers(3) for name in ("ray_origin", "ray_direction")},
        "screen_pos": _numbers(2),
        "instance_index": _whole_or_none,
        "modifier": _text_or_none,
    },
    "GetRenderResponseMessage": {"payload": _bytes, "render_uuid": _text},
}
"""Kinds of messages that a page may send, and what each field may be; `owner` may be left out."""

_MAY_LACK: Final = {"owner"}


class PageFilter:
    """Decides about messages of pages.

    Args:
        controls: Gives viser's handles of the controls that are on the page now, by their ids.
    """

    def __init__(self, controls: Callable[[], Mapping[str, Any]]) -> None:
        self._controls = controls

    def passes(self, raw: bytes | str) -> bool:
        """Whether a message may go on to viser."""
        if not isinstance(raw, bytes):
            return False
        try:
            message = msgspec.msgpack.decode(raw)
        except (msgspec.DecodeError, RecursionError, ValueError):
            return False
        if not isinstance(message, dict):
            return False
        rule = RULES.get(message["type"]) if isinstance(message.get("type"), str) else None
        if rule is None:
            return False
        given = {key: value for key, value in message.items() if key != "type"}
        if not set(rule) - _MAY_LACK <= set(given) <= set(rule):
            return False
        if not all(rule[key](value) for key, value in given.items()):
            return False
        if message["type"] == "GuiUpdateMessage":
            handle = self._controls().get(given["uuid"])
            return handle is not None and may_have(handle, given["updates"]["value"])
        return True


def may_have(handle: Any, value: Any) -> bool:
    """Whether a person could give a control this value: of its type, from its list, within its range."""
    state = handle._impl
    props, present = state.props, state.value
    if getattr(props, "disabled", False):
        return False
    options = getattr(props, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    if isinstance(present, bool):
        return isinstance(value, bool)
    if isinstance(present, str):
        return _text(value)
    if not isinstance(present, int | float) or not _number(value):
        return False
    lower, upper = (getattr(props, name, None) for name in ("min", "max"))
    slack = 1e-6 * max(abs(lower or 0.0), abs(upper or 0.0))
    return (lower is None or value >= lower - slack) and (upper is None or value <= upper + slack)


class FilteredConnection:
    """A WebSocket connection whose incoming messages have passed the filter; the rest is the inner one's.

    Args:
        inner: The connection.
        page_filter: What decides.
    """

    def __init__(self, inner: Any, page_filter: PageFilter) -> None:
        self._inner, self._filter = inner, page_filter
        self._refused, self._credit, self._counted_at = 0, float(BURST), time.monotonic()

    def __getattr__(self, name: str) -> Any:
        """Whatever else is asked of the connection."""
        return getattr(self._inner, name)

    async def recv(self) -> bytes:
        """The next message that is allowed; a page that sends too many others is left."""
        while True:
            raw = await self._inner.recv()
            await self._wait_for_turn()
            if self._filter.passes(raw):
                return bytes(raw)
            self._refused += 1
            if self._refused > MOST_REFUSED:
                await self._inner.close(1008, "too many messages that a page does not send")

    async def _wait_for_turn(self) -> None:
        now = time.monotonic()
        self._credit = min(self._credit + RATE_HZ * (now - self._counted_at), float(BURST)) - 1.0
        self._counted_at = now
        if self._credit < 0.0:
            await asyncio.sleep(math.ceil(-self._credit) / RATE_HZ)
