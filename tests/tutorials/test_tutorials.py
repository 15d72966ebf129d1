"""Every step of the tutorials runs, every command in the text is one, and pictures show today's scenes."""

from __future__ import annotations

import functools
import importlib.util
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from doc_pages import (
    QUICK_START,
    README,
    REPOSITORY,
    TUTORIAL_PAGES,
    TUTORIALS,
    Fence,
    anchors,
    code_lines,
    commands,
    fences,
    links,
    parsed_command,
)
from waiting import BUILD_S, DEADLINE_S, spin_until

from softsim_core import Simulation, load_scene
from softsim_ros.cli.running import NODES

STEPS = 50
FENCES = [fence for page in TUTORIAL_PAGES for fence in fences(page)]
CONSOLE = [fence for fence in FENCES if fence.language == "console"] + list(fences(README, QUICK_START))
STARTED = [fence for fence in CONSOLE if fence.flags is not None]
STEP_PAGES = [page for page in TUTORIAL_PAGES if page.parent != TUTORIALS]
CONFIGS = REPOSITORY / "configs"
STARTS = sorted((CONFIGS / "tutorials").glob("*_step_*"))


@functools.cache
def run(scene: str) -> None:
    """A scene takes some steps and stays finite."""
    simulation = Simulation(load_scene(scene))
    for _ in range(STEPS):
        simulation.step()
    assert np.isfinite(simulation.positions).all()
    assert all(np.isfinite(pose.position).all() for pose in simulation.rigid_poses)


@pytest.mark.slow
@pytest.mark.parametrize("fence", CONSOLE, ids=str)
def test_every_command_of_the_text_is_one(fence: Fence, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    for program, name, *words in commands(fence):
        assert program == "./softsim"
        if name == "run":
            assert words[0] in NODES, f"unknown node {words[0]}"
            assert words[1:2] in ([], ["--ros-args"])
            continue
        arguments = parsed_command(name, words)
        if name == "up":
            run(arguments.robot)


@pytest.mark.parametrize("start", STARTS, ids=lambda path: f"{path.parent.name}/{path.stem}")
@pytest.mark.slow
def test_every_start_version_runs_and_says_what_to_write(start: Path) -> None:
    run(str(start))
    assert "Write here: " in start.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("page", STEP_PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_every_step_has_a_finished_scene_a_start_version_and_a_picture(page: Path) -> None:
    targets = [(page.parent / target).resolve() for target in links(page) if "configs/" in target]
    finished = [target for target in targets if target.parent.name == "scenes"]
    assert finished
    assert any(target in STARTS for target in targets)
    for scene in finished:
        run(str(scene))
    pictures = [page.parent / target for target in links(page) if target.endswith(".png")]
    assert all(picture.stat().st_size < 80_000 for picture in pictures)
    films = [page.parent / target for target in links(page) if target.endswith(".gif")]
    assert [film.stem for film in films] == [p.stem for p in pictures if p.with_suffix(".gif").is_file()]
    assert all(film.stat().st_size < 200_000 for film in films)


def test_every_start_version_belongs_to_a_page() -> None:
    named = {(page.parent / target).resolve() for page in STEP_PAGES for target in links(page)}
    assert set(STARTS) <= named


@pytest.mark.parametrize("page", TUTORIAL_PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_links_lead_somewhere(page: Path) -> None:
    for link in links(page):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target), link


def started(page: Path) -> Path:
    """The start version that a page of a step names."""
    return next(target for link in links(page) if (target := (page.parent / link).resolve()) in STARTS)


def typed(start: str, fence: Fence) -> str:
    """The start version as somebody leaves it who types what the page prints: a section of the same name, or
    one that its comment says goes away, is replaced; lines behind `create_scene` replace the function."""
    if fence.language == "python":
        return (
            fence.body if fence.body.startswith(("import", "from")) else start.split("def ")[0] + fence.body
        )
    ours = re.findall(r"^(\w+):", fence.body, re.MULTILINE) + re.findall(r"instead of `(\w+)", start)
    sections = re.split(r"^(?=\w+:)", start, flags=re.MULTILINE)
    kept = [section for section in sections if section.split(":")[0] not in ours]
    return "".join(section.rstrip() + "\n" for section in kept) + fence.body


@pytest.mark.slow
@pytest.mark.parametrize("page", STEP_PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_what_a_page_prints_runs_when_it_is_typed_into_the_start_version(page: Path, tmp_path: Path) -> None:
    for folder in CONFIGS.iterdir():
        if folder.name != "tutorials":
            (tmp_path / folder.name).symlink_to(folder)
    start = started(page)
    scene = tmp_path / "tutorials" / start.name
    scene.parent.mkdir()
    text = start.read_text(encoding="utf-8")
    for fence in fences(page):
        if fence.source is not None and fence.language in ("yaml", "python"):
            text = typed(text, fence)
    scene.write_text(text, encoding="utf-8")
    run(str(scene))


SHOWN = [fence for fence in FENCES if fence.language in ("yaml", "python", "json")]


@pytest.mark.parametrize("fence", SHOWN, ids=str)
def test_code_of_the_text_is_that_of_the_scene_or_runs(fence: Fence, tmp_path: Path) -> None:
    if fence.source is not None:
        lines = code_lines(fence.source.read_text(encoding="utf-8"))
        missing = [line for line in code_lines(fence.body) if line not in lines]
        assert not missing, f"not in {fence.source.name}"
    else:
        assert fence.language == "python"
        scene = tmp_path / "scene.py"
        scene.write_text(fence.body, encoding="utf-8")
        run(str(scene))


def script(name: str) -> ModuleType:
    """A program beside the pages, as a module."""
    spec = importlib.util.spec_from_file_location(f"tutorial_{name}", TUTORIALS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_reference_is_that_of_the_program() -> None:
    written = (TUTORIALS / "reference.md").read_text(encoding="utf-8")
    assert written == script("reference").page(), "run python docs/tutorials/reference.py"


@pytest.mark.slow
def test_the_pictures_show_the_scenes_of_today() -> None:
    pytest.importorskip("daqp")
    pictures = script("pictures")
    shown = {file for shot in pictures.SHOTS for file in shot.files}
    assert shown == set((TUTORIALS / "pictures").iterdir())
    assert not [sentence for shot in pictures.SHOTS for sentence in pictures.differences(shot)]


def test_the_films_move() -> None:
    image = pytest.importorskip("PIL.Image")
    for film in (TUTORIALS / "pictures").glob("*.gif"):
        with image.open(film) as frames:
            assert frames.n_frames > 5, film.name
            first = np.asarray(frames.convert("RGB"), dtype=float)
            frames.seek(frames.n_frames - 1)
            assert np.abs(np.asarray(frames.convert("RGB")) - first).max() > 100.0, film.name


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("fence", STARTED, ids=str)
def test_marked_commands_run_and_end_at_ctrl_c(
    fence: Fence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    ((_, *words),) = commands(fence)
    assert fence.flags is not None
    said = tmp_path / "said.txt"
    with said.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "softsim_ros.cli", *words, *fence.flags.split()],
            cwd=REPOSITORY,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )
    try:
        spin_until(lambda: "running" in said.read_text() or process.poll() is not None, BUILD_S)
        assert "running" in said.read_text(), said.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0, said.read_text()
        assert "Traceback" not in said.read_text()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
