"""Pages and pictures that programs make are those of today; links find their files.

Notebooks run where the site is built: .ci/run.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from doc_pages import DOCS, PAGES, README, REPOSITORY, anchors, links

from softsim_core.physics.dynamics import TimeStep

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def program(path: str) -> ModuleType:
    """A program of docs/, as a module."""
    file = DOCS / path
    spec = importlib.util.spec_from_file_location(f"docs_{file.stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.usefixtures("ros_domain")
def test_topics_services_and_parameters_are_those_of_the_nodes() -> None:
    pytest.importorskip("viser")
    pytest.importorskip("onnxruntime")
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.path.insert(0, 'docs'); import ros_reference as r; sys.stdout.write(r.page())",
        ],
        cwd=REPOSITORY,
        env={**os.environ, "PYTHONIOENCODING": "utf-8"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    made = done.stdout.decode()
    written = (DOCS / "ros_reference.md").read_text(encoding="utf-8")
    assert written == made[made.index("# Topics") :], "run python docs/ros_reference.py"


def test_every_topic_and_service_of_the_nodes_is_explained() -> None:
    told = "".join(
        page.read_text(encoding="utf-8") for page in DOCS.glob("*.md") if page.stem != "ros_reference"
    )
    rows = re.findall(
        r"^\| (?:(?:publishes|subscribes) \| )?`([^`]+)` \| \w+/\w+ \|",
        (DOCS / "ros_reference.md").read_text(),
        re.M,
    )
    assert len(rows) > 60
    for name in rows:
        if name.startswith("servo_bridge/get_"):
            continue  # ROS's own, of every lifecycle node
        name = name.removeprefix("observer/")
        last = name.rsplit("/", 1)[-1]
        assert name in told or f"`{last}`" in told or f"~/{last}" in told, name


NOT_STARTED = {"emulated_board/pulse_widths", "replay/paused", "/tf", "/tf_static"}
"""Published where ros_reference.py does not look: by nodes that need libsimavr or a bag, with tf2_msgs."""


def cells(text: str) -> Iterator[list[str]]:
    """Cells of each row of the tables in a text."""
    for row in re.findall(r"^\|(.+)\|$", text, re.MULTILINE):
        yield [cell.strip() for cell in row.split("|")]


def names(cell: str) -> list[str]:
    """Names of topics in a cell."""
    return re.findall("`([^`]+)`", cell)


def topics_of_nodes() -> dict[str, set[tuple[str, str]]]:
    """Types and qualities by topic, at its publishers; at its subscribers where no node publishes it."""
    published: dict[str, set[tuple[str, str]]] = {}
    subscribed: dict[str, set[tuple[str, str]]] = {}
    for verb, name, *found in cells((DOCS / "ros_reference.md").read_text(encoding="utf-8")):
        if verb in ("publishes", "subscribes"):
            ends = published if verb == "publishes" else subscribed
            ends.setdefault(names(name)[0], set()).add(
                (found[0], found[1].replace("latched, depth 1", "latched"))
            )
    return subscribed | published


def test_the_tables_of_topics_are_complete_and_true() -> None:
    """A topic of a node without a row fails, and a row without a topic or of another type or quality."""
    found = topics_of_nodes()
    sections = (DOCS / "interfaces.md").read_text(encoding="utf-8").split("\n## ")
    tables = {
        title: next(each for each in sections if each.startswith(title)) for title in ("Topics", "State")
    }
    explained = set()
    for title, table in tables.items():
        for topic, kind, *rest in list(cells(table))[2:]:
            explained |= set(names(topic))
            for name in set(names(topic)) - NOT_STARTED if kind else ():
                assert {each.rpartition("/")[2] for each, _ in found[name]} == {
                    each.rpartition("/")[2] for each in kind.split(", ")
                }, name
                quality = rest[1].partition(";")[0] if title == "Topics" else "reliable, latched"
                assert {each for _, each in found[name]} == {quality}, name
    below = {f"observer/{name}" for name in found}  # the topics of a scene, for the shape that is estimated
    assert sorted(found.keys() - explained - below) == []
    assert sorted(explained - found.keys() - NOT_STARTED) == []


def test_all_pages_give_topics_their_type() -> None:
    found = topics_of_nodes()
    compared = 0
    for page in DOCS.glob("*.md"):
        for topic, kind, *_ in cells(page.read_text(encoding="utf-8")):
            for name in names(topic):
                if name in found and re.fullmatch(r"\w+_msgs/\w+(, latched)?", kind):
                    assert kind.removesuffix(", latched") in {each for each, _ in found[name]}, (page, name)
                    compared += 1
    assert compared > 80


@pytest.mark.ros
def test_layouts_recorder_and_replay_name_topics_of_nodes() -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.description import layouts
    from softsim_ros.recording import recorder_node, replay_node

    found = topics_of_nodes()
    for shown in layouts.SHOWN:
        ((kind, quality),) = found[shown.topic]
        assert (shown.type_name.replace("/msg/", "/"), shown.latched) == (kind, "latched" in quality), shown
    named = {*recorder_node.SHARED, *recorder_node.LEFT_OUT, replay_node.BASE_SHIFT}
    named |= {*replay_node.ROBOT_TOPICS, *replay_node.COMMAND_TOPICS}
    assert sorted(named - found.keys() - NOT_STARTED) == []


def test_the_step_in_the_docs_is_the_one_that_runs() -> None:
    source = textwrap.dedent(inspect.getsource(TimeStep.step))
    assert len(source.splitlines()) < 80
    assert f"```python\n{source}```" in (DOCS / "architecture.md").read_text(encoding="utf-8")


def test_badges_are_true() -> None:
    assert (DOCS / "pictures" / "badges.svg").read_text(encoding="utf-8") == program(
        "pictures/badges.py"
    ).picture()


def test_the_moving_picture_moves_and_is_small() -> None:
    image = pytest.importorskip("PIL.Image")
    file = DOCS / "pictures" / "moving.webp"
    assert file.stat().st_size < 3_000_000
    with image.open(file) as picture:
        assert picture.n_frames > 20


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_links_lead_somewhere(page: Path) -> None:
    for link in links(page):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_in_the_order_of_the_site() -> None:
    order = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8")
    for page in DOCS.rglob("*.md"):
        assert page.relative_to(DOCS).as_posix() in order, page
    for group, names in program("library.py").GROUPS.items():
        made = f"library/{re.sub('[^a-z]+', '_', group.lower())}.md"
        assert made in order or names == "__version__", made
    for notebook in NOTEBOOKS:
        assert f"notebooks/{notebook.stem}.md" in order, notebook


def test_warnings_of_the_site_fail_where_it_is_built() -> None:
    """With --quiet mkdocs counts none, and --strict finds nothing."""
    built = [line for line in (REPOSITORY / ".ci/run").read_text().splitlines() if "mkdocs build" in line]
    assert len(built) == 1
    assert "--strict" in built[0]
    assert "--quiet" not in built[0]


def test_the_front_page_is_one_that_is_read() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 160


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_stored_without_outputs(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells)
    assert notebook.stat().st_size < 20_000
