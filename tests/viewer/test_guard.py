"""Who may load the page: hosts, origins, tokens, ports."""

from __future__ import annotations

import asyncio
import dataclasses
import gzip
import http.client
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("viser")

import websockets
from tcp_ports import free_port
from waiting import DEADLINE_S
from websockets.asyncio.client import connect
from websockets.datastructures import Headers
from websockets.http11 import Request

from softsim_ros.nodes.viewer import AccessRule, GuardedServer, ViewerError, is_loopback, requested_token

LOCAL = AccessRule("127.0.0.1", 8080)
OPEN = AccessRule("0.0.0.0", 8080, "secret")


def request(path: str = "/", **headers: str) -> Request:
    return Request(path, Headers({"Host": "127.0.0.1:8080", **headers}))


def test_this_machine_is_let_in() -> None:
    assert LOCAL.refusal(request()) is None
    assert LOCAL.refusal(request(Host="localhost:8080", Origin="http://localhost:8080")) is None


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 421),
        ({"Host": "127.0.0.1:9999"}, 421),
        ({"Host": "127.0.0.1.evil.example:8080"}, 421),
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://127.0.0.1:8081"}, 403),
        ({"Origin": "https://127.0.0.1:8080"}, 403),
    ],
)
def test_another_page_is_kept_out(headers: dict[str, str], status: int) -> None:
    refusal = LOCAL.refusal(request(**headers))
    assert refusal is not None
    assert refusal[0] == status


def test_the_network_needs_the_token_or_the_cookie() -> None:
    assert OPEN.refusal(request(Host="robot.lan:8080")) is not None
    assert OPEN.refusal(request("/?token=wrong", Host="robot.lan:8080")) is not None
    assert OPEN.refusal(request("/?token=secret", Host="robot.lan:8080")) is None
    assert OPEN.refusal(request(Host="robot.lan:8080", Cookie=f"{OPEN.cookie}=secret")) is None
    assert OPEN.refusal(request(Host="robot.lan:8080", Cookie=f"{OPEN.cookie}=secre")) is not None
    with_origin = request(
        Host="robot.lan:8080", Cookie=f"{OPEN.cookie}=secret", Origin="https://evil.example"
    )
    assert OPEN.refusal(with_origin) is not None
    assert OPEN.address.endswith("/?token=secret")


def test_this_machine_needs_the_token_too_and_its_own_name() -> None:
    rule = AccessRule("127.0.0.1", 8080, "secret")
    assert rule.refusal(request()) is not None
    assert rule.refusal(request("/?token=secret")) is None
    assert rule.refusal(request("/?token=secret", Host="evil.example:8080")) is not None
    assert rule.refusal(request(Cookie="softsim_viewer_8080=secret")) is None
    assert rule.refusal(request(Cookie="softsim_viewer_8081=secret")) is not None


def test_every_address_of_this_machine_may_be_the_host() -> None:
    for host in ("127.0.0.2", "::1"):
        rule = AccessRule(host, 8080, "secret")
        name = rule.address.removeprefix("http://").split("/")[0]
        assert rule.refusal(request("/?token=secret", Host=name)) is None


def test_a_host_is_an_address() -> None:
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("0.0.0.0")
    with pytest.raises(ViewerError, match=r"not an IP address; use 127\.0\.0\.1"):
        is_loopback("robot.lan")


def test_the_network_without_a_token_is_refused() -> None:
    with pytest.raises(ViewerError, match="needs a token"):
        GuardedServer(AccessRule("0.0.0.0", 8080), "test")


def test_a_busy_port_is_refused() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {port} of 127.0.0.1 is busy"):
            GuardedServer(AccessRule("127.0.0.1", port), "test")


@pytest.fixture
def server(request: pytest.FixtureRequest) -> Iterator[GuardedServer]:
    running = GuardedServer(AccessRule("127.0.0.1", free_port(), getattr(request, "param", None)), "test")
    yield running
    running.stop()


def get(server: GuardedServer, path: str = "/", **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.rule.port, timeout=DEADLINE_S)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    result = answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    connection.close()
    return result


def test_the_page_is_served_with_its_rules(server: GuardedServer) -> None:
    status, headers, body = get(server)
    assert status == 200
    assert b"stopPropagation" in gzip.decompress(body)
    assert headers["content-security-policy"].startswith("default-src 'self'")
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert get(server, Host="evil.example")[0] == 421
    assert get(server, Origin="https://evil.example")[0] == 403
    assert get(server, "/../../etc/passwd")[0] == 404


def handshake(server: GuardedServer, **options: object) -> int:
    """Status of a WebSocket handshake; 101 is success."""

    async def attempt() -> int:
        try:
            async with connect(
                f"ws://127.0.0.1:{server.rule.port}",
                subprotocols=["viser-v1.1.1"],
                max_size=None,
                **options,
            ):
                return 101
        except websockets.exceptions.InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(attempt())


def test_a_hostile_origin_gets_no_connection(server: GuardedServer) -> None:
    assert handshake(server, origin="https://evil.example") == 403
    assert handshake(server, origin=f"http://127.0.0.1:{server.rule.port}") == 101


@pytest.mark.parametrize("server", ["secret"], indirect=True)
def test_the_token_becomes_a_cookie(server: GuardedServer) -> None:
    assert get(server)[0] == 403
    assert handshake(server) == 403
    name = f"{server.rule.own_name}:{server.rule.port}"
    status, headers, _ = get(server, "/?token=secret", Host=name)
    assert (status, headers["location"]) == (303, "/")
    assert "HttpOnly" in headers["set-cookie"]
    assert "SameSite=Strict" in headers["set-cookie"]
    cookie = headers["set-cookie"].split(";")[0]
    assert get(server, Cookie=cookie)[0] == 200
    assert handshake(server, additional_headers={"Cookie": cookie}) == 101


@pytest.mark.parametrize("server", ["secret"], indirect=True)
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_no_cookie_is_set_for_a_host_that_other_pages_share(server: GuardedServer, host: str) -> None:
    status, headers, _ = get(server, "/?token=secret", Host=f"{host}:{server.rule.port}")
    assert (status, headers["location"]) == (303, server.rule.address)
    assert "set-cookie" not in headers
    assert server.rule.address.startswith("http://softsim-")
    assert ".localhost:" in server.rule.address


def test_the_name_of_the_page_follows_its_token() -> None:
    names = {AccessRule("127.0.0.1", 8080, token).own_name for token in ("secret", "other", "secret")}
    assert len(names) == 2
    assert AccessRule("127.0.0.1", 8080).own_name == AccessRule("0.0.0.0", 8080, "secret").own_name == ""


def test_the_token_comes_out_of_the_environment_or_a_file(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("secret_of_a_file\n")
    assert requested_token({}) == ""
    assert requested_token({"SOFTSIM_PAGE_TOKEN": "secret_given"}) == "secret_given"
    assert requested_token({"SOFTSIM_PAGE_TOKEN_FILE": str(file)}) == "secret_of_a_file"
    for text in ("", "short", "two words", "a" * 201, "new\r\nline_in_it"):
        file.write_text(text)
        with pytest.raises(ViewerError, match="holds no token; one has 8 to 200"):
            requested_token({"SOFTSIM_PAGE_TOKEN_FILE": str(file)})
    with pytest.raises(ViewerError, match=r"SOFTSIM_PAGE_TOKEN_FILE names .*: No such file"):
        requested_token({"SOFTSIM_PAGE_TOKEN_FILE": str(tmp_path / "none")})


@pytest.mark.ros
def test_nobody_reads_the_token_out_of_the_parameters() -> None:
    from softsim_ros.nodes.viewer import ViewerSettings

    assert "token" not in {each.name for each in dataclasses.fields(ViewerSettings)}


def test_no_tunnel_is_opened(server: GuardedServer) -> None:
    assert server.request_share_url() is None
