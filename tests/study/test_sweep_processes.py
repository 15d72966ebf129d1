"""Whole studies in worker processes: the same bytes on any number, after kills, with runs that go wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from study_files import fingerprint, gate, written
from study_processes import PATIENCE_S, children, kept, started, swept, until, workers

from softsim_core.lab.study import read_results
from softsim_core.simulation import cached_kernels

pytest.importorskip("distributed")
pytest.importorskip("zarr")
pytestmark = pytest.mark.slow

GATED = [
    {"name": "tip", "of": "effector.position"},
    {"name": "told", "of": "python", "function": "functions.py:gated"},
]


def grid(count: int) -> dict[str, Any]:
    return {"variables": [{"name": "g", "lower": 0.0, "upper": 9.81, "count": count}], "measure": GATED}


@pytest.mark.exhaustive
def test_one_worker_and_three_write_the_same_bytes(tmp_path: Path) -> None:
    study = written(tmp_path, **{**grid(14), "block": 4})
    assert swept(study, tmp_path / "one", "--workers", "1").returncode == 0
    assert swept(study, tmp_path / "three", "--workers", "3", "--batch", "3").returncode == 0
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "three")
    again = swept(study, tmp_path / "one", "--json")
    assert json.loads(again.stdout) == {
        "store": str(tmp_path / "one"),
        "runs": 14,
        "new": 0,
        "counts": {"done": 14},
    }


def killed_and_continued(tmp_path: Path, runs: int, at: tuple[int, int]) -> None:
    """Kill a worker, then the client; the continued store is that of an undisturbed study.

    The undisturbed one, as every later one of its scene, finds all kernels compiled. With two workers at most
    six runs are under way, and the runs of a killed worker may have to wait for all others: of 28 runs at
    least eleven are kept before both workers wait at the gate.
    """
    study = written(tmp_path, **{**grid(runs), "block": 7})
    store = tmp_path / "killed"
    with gate(tmp_path, 0.8 * 9.81):  # the last fifth of the runs waits: the client is killed before them
        client = started(study, store, "--workers", "2")
        assert client.stderr is not None

        def keeps(count: int) -> bool:
            return store.exists() and kept(store) >= count

        try:
            for count in at:
                until(lambda count=count: keeps(count) or client.poll() is not None)
                assert client.poll() is None, client.stderr.read()
                if count == at[0]:
                    os.kill(workers(client.pid)[0], signal.SIGKILL)
            below = children(client.pid)
            client.kill()
            client.wait()
            until(lambda: not any(Path(f"/proc/{each}").exists() for each in below))  # they die with it
        finally:
            client.kill()
            client.wait()
            client.stderr.close()
    before = kept(store)
    assert at[1] <= before < runs
    ended = swept(study, store, "--workers", "2", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["counts"] == {"done": runs}
    assert told["new"] <= runs - at[1]
    count = cached_kernels()[0]
    assert swept(study, tmp_path / "undisturbed", "--workers", "2").returncode == 0
    assert cached_kernels()[0] == count  # nothing is compiled anew
    assert fingerprint(store) == fingerprint(tmp_path / "undisturbed")


def test_a_killed_worker_and_a_killed_client_lose_nothing_that_was_done(tmp_path: Path) -> None:
    killed_and_continued(tmp_path, 28, (6, 11))


@pytest.mark.exhaustive
def test_two_hundred_runs_outlive_a_killed_worker_and_a_killed_client(tmp_path: Path) -> None:
    killed_and_continued(tmp_path, 200, (50, 120))


def test_runs_that_diverge_raise_or_crash_do_not_stop_a_study(tmp_path: Path) -> None:
    variables = [{"name": "g", "values": [0.0, 1.0, 3.0, 4.0, 1e9]}]
    measure = [{"name": "told", "of": "python", "function": "functions.py:faulty"}]
    study = written(tmp_path, variables=variables, measure=measure, block=4)
    ended = swept(study, tmp_path / "s", "--workers", "2", "--batch", "2")
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    results = read_results(tmp_path / "s")
    assert results.counts == {"done": 2, "diverged": 1, "raised": 2}
    assert results.errors[1] == "ValueError: one is refused"
    assert results.errors[2].startswith("its worker process was killed")
    assert results.errors[4].startswith("diverged at step 1")
    assert results.quantities["told"][[0, 3]].tolist() == [0.0, 4.0]
    assert "run 1: ValueError: one is refused" in ended.stdout


def test_a_run_that_hangs_does_not_stop_a_study(tmp_path: Path) -> None:
    variables = [{"name": "g", "values": [2.0, 0.0]}]
    measure = [{"name": "told", "of": "python", "function": "functions.py:faulty"}]
    study = written(tmp_path, variables=variables, measure=measure, time_limit=1.0)
    ended = swept(study, tmp_path / "s", "--workers", "1", "--batch", "1")
    assert ended.returncode == 0, ended.stderr
    results = read_results(tmp_path / "s")
    assert results.errors[0] == "exceeded its time limit of 1 s"
    assert sum(results.counts.values()) == 2  # the second run has ended, too, in time or late


@pytest.mark.exhaustive
def test_a_scheduler_that_goes_away_is_one_sentence_and_the_study_goes_on(tmp_path: Path) -> None:
    from tcp_ports import free_port

    study, port = written(tmp_path, **grid(60)), free_port()
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard"]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-dashboard",
    ]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    scheduler = subprocess.Popen([*dask, "--host", "127.0.0.1"], **quiet)
    hand = subprocess.Popen([*worker, "--no-nanny", "--death-timeout", "20"], **quiet)
    try:
        with gate(tmp_path, 0.5 * 9.81):
            client = started(study, tmp_path / "s", "--scheduler", address)
            until(lambda: (tmp_path / "s").exists() and kept(tmp_path / "s") >= 5)
            scheduler.kill()
            _, said = client.communicate(timeout=PATIENCE_S)
    finally:
        for each in (scheduler, hand):
            each.kill()
            each.wait()
    assert client.returncode == 1
    assert said.splitlines()[-1] == (
        f"softsim: the Dask scheduler {address} went away; what was done is kept, and the same command goes "
        "on when it is back"
    )
    assert "Traceback" not in said
    before = kept(tmp_path / "s")
    told = json.loads(swept(study, tmp_path / "s", "--workers", "2", "--json").stdout)
    assert told["counts"] == {"done": 60}
    assert told["new"] == 60 - before


def test_an_interrupt_keeps_what_was_done(tmp_path: Path) -> None:
    study = written(tmp_path, **grid(60))
    with gate(tmp_path, 0.5 * 9.81):
        client = started(study, tmp_path / "s", "--workers", "2")
        until(lambda: (tmp_path / "s").exists() and kept(tmp_path / "s") >= 5)
        os.killpg(client.pid, signal.SIGINT)  # as a terminal does
        _, said = client.communicate(timeout=PATIENCE_S)
    assert client.returncode == 130
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "softsim: interrupted"
    assert kept(tmp_path / "s") >= 5
