"""Studies as files: what varies, which values go together, and what is refused in one sentence."""

from __future__ import annotations

import copy
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from study_files import LOAD, written

from softsim_core.base import SoftSimError
from softsim_core.lab.study import known_studies, load_study, prepare_study, values_of_runs

TWO = [
    {"name": "g", "lower": 1.0, "upper": 100.0, "spacing": "log", "count": 3},
    {"name": "h", "values": [2.0, 5.0]},
]
OVERLAY = {"gravity": ["= h", 0.0, "= -g"]}


def test_a_grid_is_every_value_with_every_other(tmp_path: Path) -> None:
    values = values_of_runs(load_study(written(tmp_path, variables=TWO, overlay=OVERLAY)))
    assert values == pytest.approx(np.array([[1, 2], [1, 5], [10, 2], [10, 5], [100, 2], [100, 5]]))


def test_a_list_takes_the_values_side_by_side(tmp_path: Path) -> None:
    variables = [{"name": "g", "values": [1.0, 2.0]}, {"name": "h", "values": [3.0, 5.0]}]
    study = load_study(written(tmp_path, variables=variables, overlay=OVERLAY, design={"kind": "list"}))
    assert values_of_runs(study).tolist() == [[1.0, 3.0], [2.0, 5.0]]


@pytest.mark.parametrize("kind", ["random", "sobol", "latin_hypercube"])
def test_spread_values_fill_the_bounds_and_follow_the_seed(tmp_path: Path, kind: str) -> None:
    variables = [{**TWO[0], "count": None}, {"name": "h", "lower": -1.0, "upper": 1.0}]
    drawn = {}
    for seed in (0, 0, 1):
        design = {"kind": kind, "samples": 50, "seed": seed}
        study = load_study(written(tmp_path, variables=variables, overlay=OVERLAY, design=design))
        values = values_of_runs(study)
        assert values.shape == (50, 2)
        assert (values >= [1.0, -1.0]).all()
        assert (values <= [100.0, 1.0]).all()
        assert np.array_equal(drawn.setdefault(seed, values), values)
        counts = np.histogram(np.log10(values[:, 0]), bins=2, range=(0.0, 2.0))[0]  # even in the logarithm
        assert counts.min() >= (15 if kind == "random" else 24)
    assert not np.array_equal(drawn[0], drawn[1])


def test_a_latin_hypercube_has_each_share_once(tmp_path: Path) -> None:
    variables = [{"name": "g", "lower": 0.0, "upper": 1.0}]
    design = {"kind": "latin_hypercube", "samples": 16}
    values = values_of_runs(load_study(written(tmp_path, variables=variables, design=design)))
    assert sorted(np.floor(16.0 * values[:, 0]).tolist()) == list(range(16))
    assert all(low < high for low, high in pairwise(sorted(values[:, 0].tolist())))


def test_what_a_calibration_left_open_is_drawn_beside_what_varies(tmp_path: Path) -> None:
    """Correlated numbers of a distribution, and a variable of the study's own."""
    overlay = {"bodies": [{"name": "finger", "material": {"young_modulus": "= 1e6 * young"}}]}
    left_open = {
        "name": "finger", "robot": "cable_finger", "names": ["young", "zero"], "units": ["MPa", "m"],
        "mean": [1.0, 0.001], "covariance": [[0.04, 1.8e-5], [1.8e-5, 1e-8]], "lower": [0.5, 0.0],
        "upper": [2.0, 0.01], "overlay": overlay,
    }  # fmt: skip
    (tmp_path / "left_open.yaml").write_text(yaml.safe_dump(left_open))
    drawn: dict[str, Any] = {
        "scene": None,
        "posterior": "left_open.yaml",
        "variables": [{"name": "pull", "lower": 0.002, "upper": 0.015}],
        "overlay": {"gravity": [0.0, 0.0, -5.0]},
        "command": [{"joints": {"cable": "= pull + zero"}}],
        "design": {"kind": "sobol", "samples": 400, "seed": 3},
    }
    study = load_study(written(tmp_path, **drawn))
    values = values_of_runs(study)
    assert study.scene == "cable_finger"
    assert [each.name for each in study.variables] == ["young", "zero", "pull"]
    assert np.corrcoef(values[:, 0], values[:, 1])[0, 1] == pytest.approx(0.9, abs=0.05)
    assert values[:, 0].std() == pytest.approx(0.2, rel=0.15)
    assert np.histogram(values[:, 2], bins=4, range=(0.002, 0.015))[0].tolist() == [100] * 4
    robot = prepare_study(tmp_path / "load.yaml").work.robot(values[0])
    assert robot.scene.bodies[0].material.young_modulus == pytest.approx(1e6 * values[0, 0])
    assert robot.scene.gravity == (0.0, 0.0, -5.0)
    with pytest.raises(SoftSimError, match="give a design with samples"):
        load_study(written(tmp_path, **{**drawn, "design": {"kind": "grid"}}))
    with pytest.raises(SoftSimError, match=r"none\.yaml.*no such file"):
        load_study(written(tmp_path, **{**drawn, "posterior": "none.yaml"}))


def begin(file: Path) -> None:
    """All that is looked at before the first run."""
    prepared = prepare_study(file)
    prepared.plan(2, 1, values_of_runs(prepared.study)[0])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"scene": "no_such_scene"}, "no such file, and no robot or scene of that name"),
        ({"variables": []}, "give one variable or more"),
        ({"variables": [{"name": "g"}]}, "give its values, or lower and upper"),
        ({"variables": [{"name": "g", "lower": 2.0, "upper": 1.0}]}, "less than upper"),
        ({"variables": [{"name": "g", "lower": 0.0, "upper": 1.0, "spacing": "log"}]}, "bounds > 0"),
        ({"variables": [{"name": "tip", "values": [1.0]}]}, "the name 'tip' is taken"),
        ({"variables": [{"name": "g g", "values": [1.0]}]}, "a word of letters"),
        ({"overlay": {}}, "variable g stands in no expression"),
        ({"overlay": {"gravity": [0, 0, "= -g*k"]}}, "names 'k'; the variables are g"),
        ({"overlay": {"gravity": [0, 0, "= g if g else 0"]}}, "must be of numbers"),
        ({"design": {"kind": "cube"}}, "one of grid, list, random, sobol, latin_hypercube"),
        ({"design": {"kind": "sobol"}}, "give samples"),
        ({"measure": [{"name": "tip", "of": "effector.position", "at": "often"}]}, "one of end, max"),
        ({"measure": [{"name": "tip", "of": "python"}]}, "belong together"),
        ({"duration": -1.0}, "> 0"),
        ({"duration": None, "measure": [{"name": "t", "of": "effector.tilt", "at": "max"}]}, "at end"),
        ({"command": [{"time": 1.0}, {"time": 0.5}]}, "in order of time"),
        ({"arguments": {"depth": "= g"}}, "are for Python scenes"),
        ({"objective": {"minimise": "= top"}}, "the objective names 'top'"),
        ({"extra": 1}, "extra"),
    ],
)
def test_a_bad_study_is_refused_in_one_sentence(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(SoftSimError) as refused:
        begin(written(tmp_path, **changes))
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def paths_in(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path, *(below for key, each in items for below in paths_in(each, (*path, key)))]


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**30), 10**30),
    st.floats(),
    st.text(max_size=8),
    st.just([]),
    st.just({}),
    st.sampled_from(["= g", "= 1/0", "= g**1e9", "=", "../../etc", [[[]]], {"name": []}]),
)


@pytest.mark.slow
@given(path=st.sampled_from(paths_in(LOAD)[1:]), junk=JUNK)
def test_junk_anywhere_is_a_study_or_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, path: tuple[Any, ...], junk: Any
) -> None:
    data = copy.deepcopy(LOAD)
    place: Any = data
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = junk
    file = tmp_path_factory.mktemp("junk") / "study.yaml"
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    told = ""
    try:
        prepare_study(file)
    except SoftSimError as refused:
        told = str(refused)
    assert "\n" not in told


def test_code_runs_only_where_it_is_allowed(tmp_path: Path) -> None:
    measure = [{"name": "told", "of": "python", "function": "functions.py:gated"}]
    file = written(tmp_path, measure=measure)
    with pytest.raises(SoftSimError, match="allow it: --allow-code"):
        prepare_study(file)
    assert prepare_study(file, [tmp_path]).study.measure[0].function == "functions.py:gated"
    with pytest.raises(SoftSimError, match="no such file"):
        prepare_study(written(tmp_path, measure=[{**measure[0], "function": "other.py:slow"}]), [tmp_path])


@pytest.mark.parametrize("name", known_studies())
def test_shipped_studies_can_be_prepared(name: str) -> None:
    prepared = prepare_study(name)
    assert prepared.study.about
    assert len(values_of_runs(prepared.study)) > 1
