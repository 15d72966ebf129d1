"""Playing a path: start, pause, loop, end."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.base import CommandError
from softsim_core.control.inverse import EffectorPath
from softsim_ros.nodes.inverse import PathPlayer

UP = np.array([0.0, 0.0, 0.0, 1.0])
PATH = EffectorPath([0.0, 2.0], [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [UP, UP])


def x_of(player: PathPlayer, elapsed: float, **options: bool) -> float | None:
    pose = player.advance(elapsed, **options)
    return None if pose is None else float(pose.position[0])


def test_it_plays_pauses_and_ends_on_the_last_pose() -> None:
    player = PathPlayer()
    assert x_of(player, 0.1) is None
    player.start(PATH)
    assert x_of(player, 0.5) == 0.5
    player.pause(True)
    assert x_of(player, 10.0) is None
    player.pause(False)
    assert x_of(player, 0.5) == 1.0
    assert player.percent == 50.0
    assert x_of(player, 5.0) == 2.0
    assert (player.state, player.percent) == ("ended", 100.0)
    assert x_of(player, 5.0) is None
    player.start(PATH)
    assert x_of(player, 0.0) == 0.0


def test_a_loop_begins_again() -> None:
    player = PathPlayer()
    player.start(PATH)
    assert x_of(player, 5.0, loop=True) == pytest.approx(1.0)
    assert (player.rounds, player.state) == (2, "running")


def test_one_pose_ends_at_once_even_in_a_loop() -> None:
    player = PathPlayer()
    player.start(EffectorPath([0.0], [(1.0, 0.0, 0.0)], [UP]))
    assert x_of(player, 0.0, loop=True) == 1.0
    assert player.percent == 100.0


def test_nothing_to_pause() -> None:
    with pytest.raises(CommandError, match=r"no path is running \(it is idle\)"):
        PathPlayer().pause(True)
