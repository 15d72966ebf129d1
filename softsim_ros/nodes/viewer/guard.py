"""A viser server that only its own page may talk to: token, origin, and a check of every message.

By itself viser listens on every interface, accepts any Origin and Host, moves on to another port when one is
busy, opens a public tunnel when a page asks for it, and lets a page change any property of a control,
including its callbacks, and upload files without end. Here every request and every WebSocket handshake passes
`AccessRule` first, every message the function `passes`, and the tunnel is disabled. The hook is
`websockets.asyncio.server.serve`, which viser calls once; if it no longer does, nothing is served.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import hashlib
import hmac
import http
import io
import ipaddress
import logging
import math
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union
from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from softsim_core.base import SoftSimError

MOST_BYTES: Final = 16 * 2**20
"""Largest size of a message in bytes; the largest is a picture of the view, which the server requests."""

LONGEST_TEXT: Final = 20_000
LARGEST: Final = 1.0e9
RATE_HZ: Final = 300.0
"""Largest rate of messages that are accepted from one page; a faster page has to wait."""

BURST: Final = 1000
MOST_REFUSED: Final = 100
"""Number of refused messages after which a connection is closed."""

Number = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]  # rejects NaN and booleans, too
Index = Annotated[int, msgspec.Meta(gt=-(2**31), lt=2**31)]
Text = Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]
Pair = tuple[Number, Number]
Point = tuple[Number, Number, Number]
Turn = tuple[Number, Number, Number, Number]
Node = {"name": Text, "owner": Text}
Value = msgspec.defstruct("Value", [("value", Any)], forbid_unknown_fields=True)

RULES: Final[Mapping[str, Mapping[str, Any]]] = {
    "GuiUpdateMessage": {"uuid": Text, "updates": Value},
    "CommandTriggerMessage": {"uuid": Text},
    "ViewerCameraMessage": {
        **dict.fromkeys(("position", "look_at", "up_direction"), Point),
        **dict.fromkeys(("fov", "near", "far", "image_height", "image_width"), Number),
        "wxyz": Turn,
    },
    "TransformControlsUpdateMessage": {**Node, "wxyz": Turn, "position": Point},
    "TransformControlsDragStartMessage": Node,
    "TransformControlsDragEndMessage": Node,
    "SceneNodeDragMessage": {
        **Node,
        **dict.fromkeys(("start_position", "end_position"), Point),
        **dict.fromkeys(("start_screen_pos", "end_screen_pos"), Pair),
        "phase": Literal["start", "update", "end"],
        "instance_index": Index | None,
        "button": Literal["left", "middle", "right"],
        "modifier": Text | None,
    },
    "SceneNodeClickMessage": {
        **Node,
        **dict.fromkeys(("ray_origin", "ray_direction"), Point),
        "screen_pos": Pair,
        "instance_index": Index | None,
        "modifier": Text | None,
    },
    "GetRenderResponseMessage": {"payload": bytes, "render_uuid": Text},
}
"""Kinds of messages that a page may send, with the type of each field; `owner` may be missing."""


def _message_type(name: str, rule: Mapping[str, Any]) -> Any:
    fields = [(key, kind) if key != "owner" else (key, kind, "") for key, kind in rule.items()]
    return msgspec.defstruct(
        name, fields, tag_field="type", tag=name, kw_only=True, forbid_unknown_fields=True
    )


_MESSAGES: Final[Any] = Union[tuple(_message_type(name, rule) for name, rule in RULES.items())]  # noqa: UP007


def passes(raw: bytes | str, controls: Mapping[str, Any]) -> bool:
    """Return whether a page's message may be passed on to viser; `controls` are its handles by their ids."""
    if not isinstance(raw, bytes):
        return False
    try:  # in two steps, since viser decodes to a dictionary, too: both see the same of doubled keys
        message = msgspec.convert(msgspec.msgpack.decode(raw), _MESSAGES, builtin_types=(bytes,))
    except (msgspec.DecodeError, RecursionError, ValueError):
        return False
    if hasattr(message, "updates"):
        handle = controls.get(message.uuid)
        return handle is not None and may_have(handle, message.updates.value)
    return True


def may_have(handle: Any, value: Any) -> bool:
    """Return whether a user could give a control this value: its type, list and range must fit."""
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
        return isinstance(value, str) and len(value) <= LONGEST_TEXT
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST
    if not isinstance(present, int | float) or not is_number:
        return False
    lower, upper = (getattr(props, name, None) for name in ("min", "max"))
    slack = 1e-6 * max(abs(lower or 0.0), abs(upper or 0.0))
    return (lower is None or value >= lower - slack) and (upper is None or value <= upper + slack)


class FilteredConnection:
    """A WebSocket connection that receives only messages that pass; see `passes`.

    Everything else is passed to the inner connection.

    Args:
        inner: The connection.
        controls: Returns viser's handles of the controls that are on the page now.
    """

    def __init__(self, inner: Any, controls: Callable[[], Mapping[str, Any]]) -> None:
        self._inner, self._controls = inner, controls
        self._refused, self._credit, self._counted_at = 0, float(BURST), time.monotonic()

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the inner connection."""
        return getattr(self._inner, name)

    async def recv(self) -> bytes:
        """Return the next message that passes; close a page that sends too many others."""
        while True:
            raw = await self._inner.recv()
            await self._wait_for_turn()
            if passes(raw, self._controls()):
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


COOKIE: Final = "softsim_viewer"
"""First part of the cookie's name; the port follows, since all ports of a host share cookies."""

MOST_CONNECTIONS: Final = 100
"""Largest number of open connections; a further one is closed at once."""

HANDSHAKE_WITHIN_S: Final = 5.0
"""Time limit in [s] for the request of a new connection."""

ANYWHERE: Final = ("0.0.0.0", "::")

CONTENT_POLICY: Final = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""The page loads from and connects to this server only, and no other page can frame it."""

KEYS_STAY_HERE: Final = (
    "<script>document.documentElement.addEventListener('keydown',"
    "event=>{if(event.ctrlKey||event.metaKey)event.stopPropagation()})</script>"
)
"""Script that reserves keys with Ctrl for the robot; otherwise Ctrl+arrow would also move the camera."""


class ViewerError(SoftSimError, RuntimeError):
    """The page cannot be served."""


@dataclass(frozen=True)
class AccessRule:
    """Rule that decides who may load the page and connect to it.

    Attributes:
        host: Address to listen on.
        port: Its port.
        token: Secret that a browser sends once as `?token=` and then in a cookie; None requires none.
    """

    host: str
    port: int
    token: str | None = None

    @property
    def address(self) -> str:
        """Address of the page for a browser on this machine."""
        anywhere = self.host in ANYWHERE
        host = socket.gethostname() if anywhere else f"[{self.host}]" if ":" in self.host else self.host
        host = self.own_name or host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    @property
    def own_name(self) -> str:
        """Host name of this machine that only those with the token know; empty if there is none.

        Browsers send a cookie to every port of the host that set it, hence also to pages that other accounts
        serve at 127.0.0.1. Those pages do not know this name, which every browser resolves to this machine.
        """
        if self.token is None or self.host != "127.0.0.1":
            return ""
        return f"softsim-{hashlib.sha256(f'host of {self.token}'.encode()).hexdigest()[:16]}.localhost"

    @property
    def cookie(self) -> str:
        """Name of the cookie that stores the token."""
        return f"{COOKIE}_{self.port}"

    def refusal(self, request: Request) -> tuple[http.HTTPStatus, str] | None:
        """Return status and message for a request that is not allowed, or None if it is."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own_host(hosts[0]):
            return http.HTTPStatus.MISDIRECTED_REQUEST, f"unknown Host; open {self.address.split('?')[0]}"
        if len(origins) > 1 or (origins and origins[0].lower() != f"http://{hosts[0].lower()}"):
            return http.HTTPStatus.FORBIDDEN, "this Origin may not use the viewer"
        if self.token is not None and not (self._has_cookie(request) or self.has_token(request)):
            return http.HTTPStatus.FORBIDDEN, "open the address with its token, as printed at the start"
        return None

    def has_token(self, request: Request) -> bool:
        """Return whether the address of the request contains the token."""
        tokens = parse_qs(urlsplit(request.path).query).get("token", [])
        return self.token is not None and any(_equal(value, self.token) for value in tokens)

    def _has_cookie(self, request: Request) -> bool:
        assert self.token is not None
        cookies: SimpleCookie = SimpleCookie()
        for line in request.headers.get_all("Cookie"):
            with contextlib.suppress(CookieError):
                cookies.load(line)
        return self.cookie in cookies and _equal(cookies[self.cookie].value, self.token)

    def _is_own_host(self, host: str) -> bool:
        if not is_loopback(self.host):  # any name may lead here; only the token protects the page
            return True
        own = f"[{self.host}]" if ":" in self.host else self.host
        names = [own, "127.0.0.1", "localhost", "[::1]", *filter(None, [self.own_name])]
        return host.lower() in {f"{name}:{self.port}" for name in names}


def _equal(text: str, secret: str) -> bool:
    return hmac.compare_digest(text.encode(errors="replace"), secret.encode())


def is_loopback(host: str) -> bool:
    """Return whether `host` can be reached from this machine only.

    Raises:
        ViewerError: not an IP address.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError as error:
        raise ViewerError(
            f"viewer: host {host!r} is not an IP address; use 127.0.0.1 (this machine) or 0.0.0.0 (network)"
        ) from error


class GuardedServer(viser.ViserServer):
    """A viser server behind an AccessRule.

    Args:
        rule: Address, and who may use it.
        label: Title of the panel.

    Raises:
        ViewerError: the port is busy, an address beyond this machine has no token, or viser has changed.
    """

    def __init__(self, rule: AccessRule, label: str) -> None:
        if rule.token is None and not is_loopback(rule.host):
            raise ViewerError(f"viewer: {rule.host} is reached from the network, which needs a token")
        self.rule = rule
        _check_free(rule)
        os.environ.pop("_VISER_PORT_OVERRIDE", None)
        guarded: list[bool] = []
        with _guarding(rule, self._controls, guarded), contextlib.redirect_stdout(io.StringIO()):
            super().__init__(host=rule.host, port=rule.port, label=label, verbose=False)
        if not guarded or self.get_port() != rule.port:
            self.stop()
            raise ViewerError(
                _busy(rule)
                if guarded
                else "viewer: this version of viser cannot be guarded; install the pinned one"
            )

    def _controls(self) -> dict[str, Any]:
        """Return viser's handles of the controls that are on the page now."""
        gui = getattr(self, "gui", None)
        return {} if gui is None else gui._gui_input_handle_from_uuid

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None: a request opens no public tunnel."""
        return None

    def stop(self) -> None:
        """Close the page's connections and the port."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def _check_free(rule: AccessRule) -> None:
    family = socket.AF_INET6 if ":" in rule.host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
        try:
            probe.bind((rule.host, rule.port))
            probe.listen()
        except PermissionError as error:
            raise ViewerError(f"viewer: port {rule.port} needs root; use one from 1024 to 65535") from error
        except OSError as error:
            raise ViewerError(_busy(rule)) from error


def _busy(rule: AccessRule) -> str:
    return (
        f"viewer: port {rule.port} of {rule.host} is busy or not there; close the program that uses it, or "
        "take another port (parameter port)"
    )


@contextlib.contextmanager
def _guarding(
    rule: AccessRule, controls: Callable[[], Mapping[str, Any]], guarded: list[bool]
) -> Iterator[None]:
    """Apply rule and filter to servers started inside the context; `guarded` is then not empty."""
    serve = websockets.asyncio.server.serve
    page = _page()
    silent = logging.getLogger("softsim_ros.nodes.viewer.websockets")
    silent.disabled = True  # requests of strangers cannot fill the terminal

    def guarded_serve(handler: Any, *args: Any, **options: Any) -> Any:
        guarded.append(True)
        options["process_request"] = _guard(rule, page, options.get("process_request"))
        options["create_connection"] = _counted_connections()
        options["open_timeout"], options["max_size"] = HANDSHAKE_WITHIN_S, MOST_BYTES
        options["logger"] = silent

        async def handle_filtered(connection: Any) -> None:
            await handler(FilteredConnection(connection, controls))

        return serve(handle_filtered, *args, **options)

    module: Any = websockets.asyncio.server
    module.serve = guarded_serve
    try:
        yield
    finally:
        module.serve = serve


def _counted_connections() -> type[websockets.asyncio.server.ServerConnection]:
    """Return a connection class that allows at most MOST_CONNECTIONS open connections."""
    live: set[object] = set()

    class Counted(websockets.asyncio.server.ServerConnection):
        """A connection that is closed at once if too many are open."""

        def connection_made(self, transport: Any) -> None:
            """Count the connection, or close it."""
            super().connection_made(transport)
            if len(live) >= MOST_CONNECTIONS:
                transport.abort()
            else:
                live.add(self)

        def connection_lost(self, exc: Exception | None) -> None:
            """Remove the connection from the count."""
            live.discard(self)
            super().connection_lost(exc)

    return Counted


def _guard(rule: AccessRule, page: bytes, inner: Any) -> Callable[[Any, Request], Response | None]:
    def process(connection: Any, request: Request) -> Response | None:
        refusal = rule.refusal(request)
        if refusal is not None:
            status, message = refusal
            return _response(status, f"{message}\n".encode(), "text/plain; charset=utf-8")
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return None
        if rule.has_token(request):
            answer = _response(http.HTTPStatus.SEE_OTHER, b"", "text/plain")
            if rule.own_name and request.headers["Host"].lower() != f"{rule.own_name}:{rule.port}":
                answer.headers["Location"] = rule.address  # set no cookie for a host name that others share
                return answer
            answer.headers["Location"] = "/"
            answer.headers["Set-Cookie"] = f"{rule.cookie}={rule.token}; Path=/; HttpOnly; SameSite=Strict"
            return answer
        if urlsplit(request.path).path in ("/", "/index.html"):
            answer = _response(http.HTTPStatus.OK, page, "text/html; charset=utf-8")
            answer.headers["Content-Encoding"] = "gzip"
            return answer
        other: Response | None = inner(connection, request)
        if other is not None:
            _protect(other.headers)
        return other

    return process


def _page() -> bytes:
    """Return viser's page with our script in it, compressed."""
    file = Path(viser.__file__).parent / "client" / "build" / "index.html"
    text = file.read_text(encoding="utf-8")
    head = text.find("<head>")
    if head < 0:
        raise ViewerError("viewer: viser's page has another form; install the pinned version")
    cut = head + len("<head>")
    return gzip.compress((text[:cut] + KEYS_STAY_HERE + text[cut:]).encode(), mtime=0)


def _response(status: http.HTTPStatus, body: bytes, content_type: str) -> Response:
    headers = Headers({"Content-Type": content_type, "Content-Length": str(len(body)), "Connection": "close"})
    _protect(headers)
    return Response(status.value, status.phrase, headers, body)


def _protect(headers: Headers) -> None:
    headers["Content-Security-Policy"] = CONTENT_POLICY
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Referrer-Policy"] = "no-referrer"
    headers["Cache-Control"] = "no-store"
