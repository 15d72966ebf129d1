"""The store: the same bytes whatever the order, nothing lost, no mixture of studies."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from study_files import fingerprint, written

from softsim_core.base import StudyError
from softsim_core.lab.study import (
    DIVERGED,
    DONE,
    Outcome,
    PreparedStudy,
    Store,
    prepare_study,
    read_results,
    values_of_runs,
    write_parquet,
)

pytest.importorskip("zarr")

RUNS = 5


def prepared_in(folder: Path) -> PreparedStudy:
    measure = [
        {"name": "tip", "of": "effector.position"},
        {"name": "course", "of": "effector.position.z", "at": "series", "every": 0.02},
    ]
    return prepare_study(written(folder, measure=measure))


def store_in(folder: Path, name: str = "s.zarr") -> Store:
    prepared = prepared_in(folder)
    return Store(folder / name, prepared.plan(RUNS, 2, [1.0]))


def outcome(number: int) -> Outcome:
    if number == 3:
        return Outcome(DIVERGED, "diverged at step 1", {})
    return Outcome(DONE, "", {"tip": number + np.arange(3.0), "course": np.full(3, float(number))})


def fill(store: Store, numbers: list[int]) -> None:
    for number in numbers:
        store.add(number, {"g": 10.0 * number}, outcome(number))


def test_the_order_in_which_runs_end_does_not_matter(tmp_path: Path) -> None:
    for name, order in (("a", [0, 1, 2, 3, 4]), ("b", [4, 2, 0, 3, 1])):
        with store_in(tmp_path, name) as store:
            fill(store, order)
            assert store.left == []
    assert fingerprint(tmp_path / "a") == fingerprint(tmp_path / "b")
    assert not (tmp_path / "a" / "journal").exists()


def test_a_store_goes_on_where_it_was_cut_off(tmp_path: Path) -> None:
    with store_in(tmp_path, "whole") as store:
        fill(store, [0, 1, 2, 3, 4])
    with store_in(tmp_path, "cut") as store:
        fill(store, [0, 1, 3])
    journal = tmp_path / "cut" / "journal" / "00000001.jsonl"
    journal.write_text(journal.read_text() + '{"run": 2, "sta')  # killed as it wrote
    (tmp_path / "cut" / "tip" / "c" / "0" / "0.8f.partial").write_text("half")
    with store_in(tmp_path, "cut") as store:
        assert store.left == [2, 4]
        assert store.values("tip")[1].tolist() == [1.0, 2.0, 3.0]
        assert store.errors()[3] == "diverged at step 1"
        fill(store, [4, 2])
    assert fingerprint(tmp_path / "cut") == fingerprint(tmp_path / "whole")


def test_a_block_that_was_written_as_its_journal_was_left_is_not_run_again(tmp_path: Path) -> None:
    with store_in(tmp_path) as store:
        fill(store, [0])
        before = (tmp_path / "s.zarr" / "journal" / "00000000.jsonl").read_text()
        fill(store, [1])
    (tmp_path / "s.zarr" / "journal").mkdir()
    (tmp_path / "s.zarr" / "journal" / "00000000.jsonl").write_text(before)
    with store_in(tmp_path) as store:
        assert store.left == [2, 3, 4]
    assert not (tmp_path / "s.zarr" / "journal").exists()


def test_xarray_opens_it_with_names_units_and_the_study(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    with store_in(tmp_path) as store:
        fill(store, [0, 1, 3])  # the second block waits for run 2
    data = xarray.open_zarr(tmp_path / "s.zarr")
    assert data["tip"].dims == ("run", "axis")
    assert data["tip"].attrs["units"] == "m"
    assert data["course"].dims == ("run", "time")
    assert data["time"].values.tolist() == pytest.approx([0.0, 0.02, 0.04])
    assert data["time"].attrs["units"] == "s"
    assert data["g"].attrs == {"units": "m/s^2", "long_name": "variable g", "role": "variable"}
    assert data["g"].values[:2].tolist() == [0.0, 10.0]
    assert np.isnan(data["g"].values[2:]).all()
    assert data["status"].values.tolist() == [1, 1, 0, 0, 0]
    assert data.attrs["study"]["scene"] == "cable_finger"
    assert len(data.attrs["scene_sha256"]) == 64
    assert "numpy" in data.attrs["versions"]
    assert "block: 2" in data.attrs["study_text"]


@pytest.mark.parametrize("change", ["duration", "mesh", "numpy"])
def test_results_of_another_study_are_not_mixed(tmp_path: Path, change: str) -> None:
    prepared = prepared_in(tmp_path)
    plan = prepared.plan(RUNS, 2, [1.0])
    with Store(tmp_path / "s.zarr", plan) as store:
        fill(store, [0])
    if change == "duration":
        told, other = "the study", prepare_study(written(tmp_path, duration=0.07))
    else:
        told, other = "a version", prepared
    plan = other.plan(RUNS, 2, [1.0])
    if change == "mesh":
        told = "its scene"
        plan.attributes["scene_sha256"] = "0" * 64  # type: ignore[index]
    if change == "numpy":
        plan.attributes["versions"]["numpy"] = "0.0"
    before = fingerprint(tmp_path / "s.zarr")
    with pytest.raises(
        StudyError, match=f"holds results from before {told} changed; choose another"
    ) as refused:
        Store(tmp_path / "s.zarr", plan)
    assert "\n" not in str(refused.value)
    assert fingerprint(tmp_path / "s.zarr") == before


def test_the_hash_of_a_scene_follows_what_its_files_hold(tmp_path: Path) -> None:
    from softsim_core.lab.study import scene_hash
    from softsim_core.scene.io import config_file

    hashes = set()
    mesh = config_file("meshes/finger_low.vtk").read_bytes()
    for folder, data in (("one", mesh), ("two", mesh), ("three", mesh + b"\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mesh.vtk").write_bytes(data)
        scene = config_file("scenes/cable_finger.yaml").read_text()
        scene = scene.replace("../meshes/finger_low.vtk", "mesh.vtk")
        scene = scene.replace("../meshes", str(config_file("meshes/finger_low.vtk").parent))
        (tmp_path / folder / "scene.yaml").write_text(scene)
        work = prepare_study(written(tmp_path / folder, scene="scene.yaml")).work
        hashes.add(scene_hash(work.load_unchanged()))
    assert len(hashes) == 2  # where it lies does not matter


def test_a_folder_that_is_no_store_and_one_in_use_are_refused(tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    with pytest.raises(StudyError, match="is no store of a study"):
        store_in(tmp_path, "notes")
    (tmp_path / "notes" / "zarr.json").write_text(json.dumps({"zarr_format": 3, "node_type": "group"}))
    with pytest.raises(StudyError, match="is no store of a study"):
        store_in(tmp_path, "notes")
    with store_in(tmp_path), pytest.raises(StudyError, match="is being written by another process"):
        store_in(tmp_path)


def test_a_result_of_another_shape_is_a_run_that_raised(tmp_path: Path) -> None:
    with store_in(tmp_path) as store:
        wrong = Outcome(DONE, "", {"tip": np.zeros(3), "course": np.zeros(4)})
        store.add(0, {"g": 1.0}, wrong)
        assert store.errors()[0] == "course has the shape (4,), in other runs it is (3,)"


def test_tables_tell_runs_units_and_errors(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    with store_in(tmp_path) as store:
        fill(store, [0, 1, 2, 3, 4])
    results = read_results(tmp_path / "s.zarr")
    assert results.counts == {"done": 4, "diverged": 1}
    write_parquet(results, tmp_path / "t.parquet")
    table = parquet.read_table(tmp_path / "t.parquet")
    assert table.column_names == ["run", "g", "tip_x", "tip_y", "tip_z", "status", "error"]
    assert table["tip_y"].to_pylist()[:3] == [1.0, 2.0, 3.0]
    assert table["status"].to_pylist()[3] == "diverged"
    assert table["error"].to_pylist()[3] == "diverged at step 1"
    assert table.schema.field("tip_x").metadata == {b"units": b"m"}
    shutil.rmtree(tmp_path / "s.zarr")
    with pytest.raises(StudyError, match="is no store of a study that can be read"):
        read_results(tmp_path / "s.zarr")


def test_values_of_a_study_stand_in_its_store(tmp_path: Path) -> None:
    values = values_of_runs(prepared_in(tmp_path).study)
    assert values[:, 0].tolist() == pytest.approx([0.0, 2.4525, 4.905, 7.3575, 9.81])


@pytest.mark.parametrize(
    "linked", ["journal/00000000.jsonl", "journal", "status", "tip/zarr.json", "zarr.json"]
)
def test_a_downloaded_store_with_a_link_is_refused_and_its_target_kept(tmp_path: Path, linked: str) -> None:
    with store_in(tmp_path) as store:
        fill(store, [0, 2, 3])
    place, target = tmp_path / "s.zarr" / linked, tmp_path / "mine" / Path(linked).name
    target.parent.mkdir()
    place.rename(target)  # its content is right, so that nothing but the link is refused
    place.symlink_to(target)
    before = fingerprint(target.parent)
    with pytest.raises(StudyError, match=f"{place.name} is a link, and nothing is written through links"):
        store_in(tmp_path)
    assert fingerprint(target.parent) == before


def test_a_store_is_not_made_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / ".s.zarr.new").symlink_to(tmp_path / "mine")
    with pytest.raises(StudyError, match="cannot be made"):
        store_in(tmp_path)
    assert list((tmp_path / "mine").iterdir()) == []


GOOD = {"run": 0, "status": 2, "error": "", "columns": {}}


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        '{"run": 0, "sta',
        "{}",
        "7",
        "[]",
        "null",
        '"run"',
        5000 * "[",
        json.dumps({"run": 0}),
        *(json.dumps({**GOOD, "run": each}) for each in (2, -1, 99, 10**30, True, "0", 0.0, None)),
        *(json.dumps({**GOOD, "status": each}) for each in (0, 5, -1, "done", None)),
        json.dumps({**GOOD, "error": 3}),
        *(
            json.dumps({**GOOD, "columns": each})
            for each in (
                7,
                [],
                {"tip": 7},
                {"tip": "AAA"},
                {"tip": "AAAAAAAAAAA="},
                {"other": ""},
                {"g": "é"},
            )
        ),
    ],
)
def test_a_damaged_journal_is_one_sentence_and_is_kept(tmp_path: Path, line: str) -> None:
    with store_in(tmp_path) as store:
        fill(store, [0])
    journal = tmp_path / "s.zarr" / "journal" / "00000000.jsonl"
    journal.write_text(journal.read_text() + line + "\n" + journal.read_text())
    before = journal.read_bytes()
    with pytest.raises(
        StudyError, match=r"line 2: is damaged .*; remove this file, and the runs 0 to 1 are"
    ) as said:
        store_in(tmp_path)
    assert "\n" not in str(said.value)
    assert journal.read_bytes() == before
    journal.unlink()
    with store_in(tmp_path) as store:
        assert store.left == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("name", ["notes", "-1", "00000003", "99999999", "²"])
def test_a_file_that_is_no_journal_of_the_store_is_kept(tmp_path: Path, name: str) -> None:
    with store_in(tmp_path) as store:
        fill(store, [0])
    file = tmp_path / "s.zarr" / "journal" / f"{name}.jsonl"
    file.write_text("mine")
    with pytest.raises(StudyError, match="is no journal of this store; remove it"):
        store_in(tmp_path)
    assert file.read_text() == "mine"


@pytest.mark.slow
def test_a_store_with_any_damaged_byte_opens_or_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with store_in(tmp_path, "whole") as store:
        fill(store, [0, 1, 2])
    generator = np.random.default_rng(3)
    files = [file for file in sorted((tmp_path / "whole").rglob("*")) if file.is_file()]
    told = 0
    for number in range(24):
        shutil.copytree(tmp_path / "whole", tmp_path / f"damaged_{number}")
        file = tmp_path / f"damaged_{number}" / files[number % len(files)].relative_to(tmp_path / "whole")
        data = bytearray(file.read_bytes())
        data[generator.integers(len(data))] = generator.integers(256)
        file.write_bytes(data)
        try:
            store_in(tmp_path, file.parts[len(tmp_path.parts)]).__exit__(None, None, None)
        except StudyError as error:
            told += 1
            assert "\n" not in str(error), error  # noqa: PT017
    assert told > 0


def test_chunks_are_on_the_disk_before_their_journal_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced, fsync, folder = list[int](), os.fsync, tmp_path / "s.zarr"
    unlink, seen = Path.unlink, list[list[str]]()

    def note(number: int) -> None:
        synced.append(os.fstat(number).st_ino)
        fsync(number)

    def unlinked(file: Path, missing_ok: bool = False) -> None:
        if file.suffix == ".jsonl":
            chunks = [each for each in folder.rglob("c/**/*") if each.is_file()]
            assert [each for each in chunks if each.stat().st_ino not in synced] == []
            seen.append([each.relative_to(folder).parts[0] for each in chunks])
            last = {name: synced.index((folder / name / "c" / "0").stat().st_ino) for name in ("g", "status")}
            assert last["g"] < last["status"]
        unlink(file, missing_ok=missing_ok)

    monkeypatch.setattr(os, "fsync", note)
    monkeypatch.setattr(Path, "unlink", unlinked)
    with store_in(tmp_path) as store:
        fill(store, [0, 1])
    assert [set(each) for each in seen] == [{"axis", "course", "g", "status", "time", "tip"}]
