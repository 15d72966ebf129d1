"""The loop on two tilts: it closes, saturates without winding up, refuses nonsense, and logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import CommandError, ConfigError
from softsim_core.control.inverse import (
    COLUMNS,
    ClosedLoopLog,
    TiltController,
    TiltGains,
    read_closed_loop_log,
)


def test_it_brings_a_slow_biased_plate_to_the_reference() -> None:
    controller, measure, reference = TiltController(), np.zeros(2), np.array([0.3, -0.2])
    for _ in range(500):  # 10 s of a plate that answers late, too weakly, and stands askew
        command = controller.update(reference, measure, 0.02)
        measure = measure + 0.02 / 0.1 * (0.8 * command + [0.05, -0.03] - measure)
    assert measure == pytest.approx(reference, abs=1e-4)
    assert not controller.is_saturated


def test_it_leaves_saturation_at_once() -> None:
    wound = {gain: TiltController(TiltGains(anti_windup=gain)) for gain in (0.0, 0.98)}
    for controller in wound.values():
        for _ in range(500):
            assert (np.abs(controller.update([1.0, -1.0], [0.0, 0.0], 0.02)) <= 0.7).all()
        assert controller.is_saturated
    steps = dict.fromkeys(wound, 0)
    for gain, controller in wound.items():
        while controller.is_saturated:
            controller.update([-1.0, 1.0], [0.0, 0.0], 0.02)
            steps[gain] += 1
    assert steps[0.98] < 0.2 * steps[0.0]


@pytest.mark.parametrize(
    ("reference", "measure", "elapsed"),
    [
        ((np.nan, 0.0), (0.0, 0.0), 0.02),
        ((0.0, 0.0), (0.0, np.inf), 0.02),
        ((0.0, 0.0, 0.0), (0.0, 0.0), 0.02),
        ((0.1, 0.0), (0.0, 0.0), -1.0),
        ((0.1, 0.0), (0.0, 0.0), np.nan),
    ],
)
def test_nonsense_changes_nothing(reference: tuple[float], measure: tuple[float], elapsed: float) -> None:
    controller, other = TiltController(), TiltController()
    for each in (controller, other):
        each.update([0.2, 0.1], [0.0, 0.0], 0.02)
    with pytest.raises(CommandError, match="nothing was changed"):
        controller.update(reference, measure, elapsed)
    assert np.array_equal(
        controller.update([0.2, 0.1], [0.0, 0.0], 0.02), other.update([0.2, 0.1], [0.0, 0.0], 0.02)
    )


@pytest.mark.parametrize("wrong", [{"integral": -1.0}, {"proportional": np.nan}, {"saturation": 0.0}])
def test_wrong_gains_are_named(wrong: dict[str, float]) -> None:
    with pytest.raises(CommandError, match=next(iter(wrong))):
        TiltGains(**wrong)


def test_the_log_comes_back_the_same(tmp_path: Path) -> None:
    rng, file = np.random.default_rng(2), tmp_path / "log.csv"
    table = rng.normal(size=(20, 7))
    with ClosedLoopLog(file) as log:
        for row in table:
            log.write(row[0], row[[1, 4]], row[[2, 5]], row[[3, 6]])
    record = read_closed_loop_log(file)
    assert np.array_equal(record.time, table[:, 0])
    assert np.array_equal(record.reference, table[:, [1, 4]])
    assert np.array_equal(record.command, table[:, [2, 5]])
    assert np.array_equal(record.measure, table[:, [3, 6]])
    lines = file.read_bytes().split(b"\r\n")
    assert lines[0] == ",".join(COLUMNS).encode()
    assert lines[-1] == b""
    assert len(lines) == 22


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "row 1: the columns must be time,x_reference"),
        (",".join(COLUMNS) + "\n1,2\n", "row 2: needs 7 numbers"),
        (",".join(COLUMNS) + "\n1,2,3,4,5,6,nan\n", "row 2: every number must be finite"),
    ],
)
def test_a_wrong_log_is_one_sentence(tmp_path: Path, content: str, sentence: str) -> None:
    file = tmp_path / "wrong.csv"
    file.write_text(content)
    with pytest.raises(ConfigError) as refusal:
        read_closed_loop_log(file)
    assert sentence in str(refusal.value)


def test_a_log_needs_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory"):
        ClosedLoopLog(tmp_path / "nowhere" / "log.csv")
