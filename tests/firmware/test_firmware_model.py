"""The Python model of the board moves as the firmware does: same bytes into both, same widths."""

from __future__ import annotations

import pytest
from firmware_line import heard
from hypothesis import given, settings, strategies as st

from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import FRAME_S, TICKS_PER_US, ExtendedBoard, FrameParser, PacketParser, frames

pytestmark = pytest.mark.usefixtures("emulator")

LATE_FRAMES = 3
"""A width shows on the pins so many frames after the command at most: latched, sent, measured."""

degree = st.integers(60, 180)
width = st.integers(544, 2400)
seq = st.integers(0, 63)
three = st.tuples(width, width, width).map(lambda widths: tuple(sorted(widths)))
command = st.one_of(
    st.tuples(degree, degree, degree).map(lambda pose: bytes([255, *pose])),
    st.builds(frames.set_widths, seq, st.tuples(width, width, width)),
    st.builds(frames.set_limits, seq, st.tuples(three, three, three)),
    st.builds(frames.slew, seq, st.integers(0, 130)),
    st.builds(frames.hold, seq),
    st.builds(frames.relax, seq),
    st.builds(frames.ping, seq),
    st.builds(frames.identify, seq, st.integers(0, frames.NO_IDENTITY)),
)
half = st.one_of(
    st.builds(lambda number: frames.ping(number)[:3], seq),
    st.tuples(degree, degree).map(lambda pose: bytes([255, *pose])),
)
pause = st.sampled_from([0.1, 0.3, 0.6, 2.6])
step = st.one_of(
    st.tuples(command, st.just(0.02)),
    st.tuples(command, pause),
    st.tuples(half, pause),  # dropped by then, counted by both
)
script = st.lists(step, min_size=1, max_size=8)


def run(board: EmulatedBoard, model: ExtendedBoard, seconds: float) -> None:
    """Let time pass for both."""
    end = board.time_s + seconds
    while board.time_s < end:
        board.run(FRAME_S)
        model.motion.advance(board.time_s)


def on_the_edge(model: ExtendedBoard) -> bool:
    """Whether a time limit runs out just now, where the two may be a frame apart."""
    return any(abs(model.motion._silence - frame) <= 3 for frame in (25, 100)) and model.motion._silence < 100


def told(model: ExtendedBoard, now: float) -> frames.Telemetry:
    return frames.read_telemetry(FrameParser().feed(model.say(now))[-1])


@pytest.mark.slow
@settings(max_examples=80, deadline=None, derandomize=True)
@given(script)
def test_same_commands_same_widths_flags_and_counters(commands: list[tuple[bytes, float]]) -> None:
    with EmulatedBoard() as board:
        board.run(0.01)
        model = ExtendedBoard(PacketParser())
        model.motion.advance(board.time_s)
        fastest = model.motion.slew  # a frame between them stays where a motion is stopped or slowed down
        for data, pause in commands:
            while on_the_edge(model):
                run(board, model, FRAME_S)
            board.feed(data)
            model.feed(data, board.time_s)
            fastest = max(fastest, model.motion.slew)
            run(board, model, pause)
            while on_the_edge(model):
                run(board, model, FRAME_S)
            said = heard(board)
            expected = told(model, board.time_s)
            assert (said.seq, said.rejects) == (expected.seq, expected.rejects)
            if not on_the_edge(model):
                assert said.flags == expected.flags
            for seen, wanted in zip(said.widths_us, expected.widths_us, strict=True):
                assert abs(seen - wanted) <= LATE_FRAMES * fastest / TICKS_PER_US + 1.0
        run(board, model, 6.0)  # silence: both end in the rest pose, or without pulses
        final = board.widths_us()
        apart = 1.5 if model.motion.arrived else LATE_FRAMES * fastest / TICKS_PER_US
        assert final is None or final == pytest.approx(model.motion.widths_us, abs=apart)
        assert (final is None) == (model.motion.widths_us is None)
