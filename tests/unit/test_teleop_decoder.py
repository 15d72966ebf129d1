"""Terminal bytes become keys: every form of every key, in any chunking; nothing leaks out of a sequence."""

from __future__ import annotations

import string
from itertools import pairwise

import pytest
from hypothesis import given, seed, settings, strategies as st

from softsim_core.scene import KEY_NAMES
from softsim_ros.keys import KeyPress
from softsim_ros.nodes.teleop import ESCAPE_TIMEOUT_S, KeyDecoder

UP, CTRL_UP = KeyPress("up"), KeyPress("up", ctrl=True)

KEYS = [
    (b"\x1b[M\x80azq", [KeyPress("q")]),  # after a mouse report, whose first byte can be any
    # plain keys
    (b"a", [KeyPress("a")]),
    (b"A", [KeyPress("a")]),
    (b"7", [KeyPress("7")]),
    (b"?", [KeyPress("?")]),
    (b" ", [KeyPress("space")]),
    (b"+=", [KeyPress("plus")] * 2),
    (b"-_", [KeyPress("minus")] * 2),
    (b"\r", [KeyPress("enter")]),
    (b"\x7f", [KeyPress("backspace")]),
    # control bytes
    (b"\x01", [KeyPress("a", True)]),
    (b"\x02", [KeyPress("b", True)]),
    (b"\x03", [KeyPress("c", True)]),
    (b"\x09", [KeyPress("i", True)]),  # Tab
    (b"\x11", [KeyPress("q", True)]),
    (b"\x1a", [KeyPress("z", True)]),
    (b"\x1f", [KeyPress("minus", True)]),
    (b"\x00", [KeyPress("space", True)]),
    # arrows: CSI, SS3, xterm modifiers, rxvt, old xterm, SS3 with a modifier
    (b"\x1b[A\x1b[B\x1b[C\x1b[D", [UP, KeyPress("down"), KeyPress("right"), KeyPress("left")]),
    (b"\x1bOA\x1bOB\x1bOC\x1bOD", [UP, KeyPress("down"), KeyPress("right"), KeyPress("left")]),
    (b"\x1b[1;5A", [CTRL_UP]),
    (b"\x1b[1;5D", [KeyPress("left", True)]),
    (b"\x1b[1;6A", [CTRL_UP]),  # with Shift
    (b"\x1b[1;2A", [UP]),  # Shift
    (b"\x1b[1;1A", [UP]),
    (b"\x1b[;5A", [CTRL_UP]),
    (b"\x1b[5A", [CTRL_UP]),
    (b"\x1bOa\x1bOb", [CTRL_UP, KeyPress("down", True)]),
    (b"\x1bOc\x1bOd", [KeyPress("right", True), KeyPress("left", True)]),
    (b"\x1b[a", [UP]),
    (b"\x1bO5A", [CTRL_UP]),
    (b"\x1bO1;5A", [CTRL_UP]),
    (b"\x9bA", [UP]),  # eight-bit terminals
    (b"\x8fA", [UP]),
    # keypad in application mode
    (b"\x1bOk\x1bOm\x1bOM", [KeyPress("plus"), KeyPress("minus"), KeyPress("enter")]),
    (b"\x1bOp\x1bOy", [KeyPress("0"), KeyPress("9")]),
    # editing keys
    (b"\x1b[H\x1b[F", [KeyPress("home"), KeyPress("end")]),
    (b"\x1b[1~\x1b[3~\x1b[5~", [KeyPress("home"), KeyPress("delete"), KeyPress("page_up")]),
    (b"\x1b[6;5~", [KeyPress("page_down", True)]),
    (b"\x1b[5^\x1b[5$", [KeyPress("page_up", True), KeyPress("page_up")]),
    # kitty
    (b"\x1b[43;5u", [KeyPress("plus", True)]),
    (b"\x1b[61;5u\x1b[61;6u", [KeyPress("plus", True)] * 2),
    (b"\x1b[45;5u", [KeyPress("minus", True)]),
    (b"\x1b[105;5u", [KeyPress("i", True)]),
    (b"\x1b[99;5u", [KeyPress("c", True)]),
    (b"\x1b[97;9u", [KeyPress("a", True)]),  # Cmd
    (b"\x1b[97;69u", [KeyPress("a", True)]),  # Ctrl with Caps Lock
    (b"\x1b[97u", [KeyPress("a")]),
    (b"\x1b[27u", [KeyPress("escape")]),
    (b"\x1b[61:43;6u", [KeyPress("plus", True)]),  # with an alternate code
    (b"\x1b[97;5:1u\x1b[97;5:2u\x1b[97;5:3u", [KeyPress("a", True)] * 2),  # press, repeat, release
    (b"\x1b[1;5:3A", []),
    (b"\x1b[57413;5u\x1b[57412u\x1b[57419u", [KeyPress("plus", True), KeyPress("minus"), UP]),
    # modifyOtherKeys
    (b"\x1b[27;5;43~", [KeyPress("plus", True)]),
    (b"\x1b[27;5;61~", [KeyPress("plus", True)]),
    (b"\x1b[27;6;43~", [KeyPress("plus", True)]),
    (b"\x1b[27;5;45~", [KeyPress("minus", True)]),
    (b"\x1b[27;5;9~", [KeyPress("i", True)]),
    # a broken sequence gives way to the next one
    (b"\x1b[1;\x1b[A", [UP]),
    (b"\x1b[1;\xc3\xa9z", [KeyPress("z")]),
    (b"\xe2\x82a", [KeyPress("a")]),
    # no byte of a character that is no key begins a sequence
    (b"\xc3\xa9a\xe2\x82\xaca\xf0\x9f\x98\x80a", [KeyPress("a")] * 3),
]

SWALLOWED = [
    b"\x1ba",  # Alt+a
    b"\x1b\x01",
    b"\x1b[1;3A",  # Alt+Up
    b"\x1b\x1b[A",
    b"\x1b\x1bOa",
    b"\x1b[97;3u",
    b"\x1b[11~\x1b[24;5~",  # function keys
    b"\x1bOP\x1bOQ",
    b"\x1b[1;5P",
    b"\x1b[[A\x1b[[E",  # function keys of the Linux console
    b"\x1b[Z",  # Shift+Tab
    b"\x1b[I\x1b[O",  # focus
    b"\x1b[?1u\x1b[?62;1;4c\x1b[>0;276;0c",  # answers of the terminal
    b"\x1b[24;80R",
    b"\x1b[?2004;1$y",
    b"\x1b]0;a title with qaz\x07",
    b"\x1b]11;rgb:aaaa/bbbb/cccc\x1b\\",
    b"\x1bP>|a terminal (1.2)\x1b\\",
    b"\x1b_Gi=31;OK\x1b\\",
    b"\x1b[Maqz",  # mouse: X10, UTF-8 pair, SGR, urxvt
    b"\x1b[M \xc2\xa0a",
    b"\x1b[<0;10;20M\x1b[<0;10;20m",
    b"\x1b[32;10;20M",
    b"\x1b[200~aqz\x1b[A pasted \r\n text\x1b[201~",
    "é ü € 機 🤖 ß".replace(" ", "").encode(),
    b"\xff\xfe\x80\xc0",
    b"\x1b[999999999999999999999999999999u",
    b"\x1b[" + b"9" * 1000 + b"A",
    b"\x1b[1;99999999999999A",
    b"\x1b[;;;;;u\x1b[:u\x1b[u\x1b[~\x1b[x",
]


@pytest.mark.parametrize(("data", "expected"), KEYS)
def test_keys_whole_and_byte_by_byte(data: bytes, expected: list[KeyPress]) -> None:
    assert KeyDecoder().feed(data) == expected
    decoder = KeyDecoder()
    assert [key for byte in data for key in decoder.feed(bytes((byte,)))] == expected


@pytest.mark.parametrize("data", SWALLOWED)
def test_everything_else_is_swallowed_whole(data: bytes) -> None:
    assert KeyDecoder().feed(data) == []
    decoder = KeyDecoder()
    assert [key for byte in data for key in decoder.feed(bytes((byte,)))] == []


@pytest.mark.parametrize("letter", string.ascii_lowercase)
def test_every_ctrl_letter(letter: str) -> None:
    byte = ord(letter) - 0x60
    expected = KeyPress("enter") if letter == "m" else KeyPress(letter, ctrl=True)
    assert KeyDecoder().feed(bytes((byte,))) == [expected]


def test_ctrl_c_gets_through_whatever_came_before() -> None:
    for start in (
        b"\x1b",
        b"\x1b[",
        b"\x1bO",
        b"\x1b]0;",
        b"\x1b[M",
        b"\x1b[200~abc",
        b"\xe2",
        b"\x1b[[",
        b"\x1bP\x1b",
    ):
        assert KeyDecoder().feed(start + b"\x03a") == [KeyPress("c", True), KeyPress("a")], start


def test_a_lone_escape_is_resolved_by_silence() -> None:
    decoder = KeyDecoder(timeout_s=0.5)
    assert decoder.feed(b"\x1b", now=10.0) == []
    assert decoder.pending
    assert decoder.flush(10.4) == []
    assert decoder.flush(10.5) == [KeyPress("escape")]
    assert not decoder.pending
    assert decoder.flush(11.0) == []
    assert decoder.feed(b"a", now=11.0) == [KeyPress("a")]


def test_a_sequence_split_by_a_slow_link_still_is_one_key() -> None:
    decoder = KeyDecoder()
    keys = []
    for number, byte in enumerate(b"\x1b[1;5A"):
        now = number * 0.9 * ESCAPE_TIMEOUT_S
        keys += decoder.flush(now) + decoder.feed(bytes((byte,)), now)
    assert keys == [CTRL_UP]


@pytest.mark.parametrize(
    "start", [b"\x1b[", b"\x1b[1;", b"\x1bO", b"\x1b]0;ti", b"\x1b[M ", b"\xe2\x82", b"\x1b[["]
)
def test_unfinished_sequences_are_given_up_without_a_key(start: bytes) -> None:
    decoder = KeyDecoder(timeout_s=0.5)
    assert decoder.feed(start, now=0.0) == []
    assert decoder.flush(1.0) == []
    assert decoder.feed(b"a", now=1.0) == [KeyPress("a")]


def test_a_paste_never_times_out() -> None:
    decoder = KeyDecoder(timeout_s=0.5)
    assert decoder.feed(b"\x1b[200~aq", now=0.0) == []
    assert decoder.flush(60.0) == []
    assert decoder.feed(b"z\x1b[201~", now=60.0) == []
    assert decoder.feed(b"z", now=60.0) == [KeyPress("z")]


TERMINAL_LIKE = st.lists(
    st.one_of(st.binary(max_size=4), st.sampled_from([data for data, _ in KEYS] + SWALLOWED)), max_size=12
).map(b"".join)


@seed(20)
@settings(max_examples=400, deadline=None)
@given(data=st.one_of(st.binary(max_size=80), TERMINAL_LIKE), cuts=st.lists(st.integers(0, 200), max_size=10))
@pytest.mark.slow
def test_any_bytes_in_any_chunks_give_the_same_known_keys(data: bytes, cuts: list[int]) -> None:
    whole = KeyDecoder().feed(data)
    assert all(key.name in KEY_NAMES for key in whole)
    edges = sorted({0, len(data), *(min(cut, len(data)) for cut in cuts)})
    decoder = KeyDecoder()
    assert [key for a, b in pairwise(edges) for key in decoder.feed(data[a:b])] == whole


@seed(21)
@settings(max_examples=200, deadline=None)
@given(data=st.one_of(st.binary(max_size=80), TERMINAL_LIKE))
@pytest.mark.slow
def test_after_silence_the_decoder_is_ready_again(data: bytes) -> None:
    decoder = KeyDecoder()
    decoder.feed(data, now=0.0)
    decoder.flush(10.0)
    decoder.feed(b"\x1b[201~", now=10.0)  # ends a paste, is nothing otherwise
    assert decoder.feed(b"q", now=10.0) == [KeyPress("q")]


@pytest.mark.parametrize(
    ("key", "label"),
    [
        (UP, "Up"),
        (CTRL_UP, "Ctrl+Up"),
        (KeyPress("a", True), "Ctrl+A"),
        (KeyPress("q"), "q"),
        (KeyPress("?"), "?"),
    ],
)
def test_keys_have_readable_labels(key: KeyPress, label: str) -> None:
    assert str(key) == label
