"""Files are written by softsim_core.base.files alone: whole, and never through a link."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from source_trees import tree_of

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "benchmarks")

ELSEWHERE = {
    "softsim_core/base/files.py": "the one place; lock files, whose content stays",
    "softsim_core/lab/meshing/filling.py": "hands a surface to the mesher in a new temporary folder",
    "softsim_core/lab/meshing/tetwild.py": "the mesher, which imports nothing of this suite, answers there",
    "softsim_node/signals.py": "/dev/null in place of a stream that was closed",
    "softsim_ros/cli/install.py": "runs before this suite is installed",
    "softsim_ros/nodes/teleop/terminal.py": "the terminal, /dev/tty",
}
"""Files that open others for writing by themselves, with the reason."""

METHODS = {"write_text", "write_bytes", "tofile", "hardlink_to", "link_to"}
"""Methods of paths and arrays that write into a file or let it have another name."""

CALLS = {
    *("os.truncate", "os.link", "os.mkfifo", "os.mknod"),
    *("shutil.copy", "shutil.copy2", "shutil.copyfile", "shutil.copyfileobj", "shutil.move"),
    *("np.save", "np.savez", "np.savez_compressed"),
}
TO_STREAMS = {"np.savetxt": 0, "figure.savefig": 0, "imwrite": 0, "meshio.write": 0, "parquet.write_table": 1}
"""Functions of libraries and the argument that names a file, or is a stream as it must be here."""

WRITING = set("wax+")
DESCRIPTORS = {"O_WRONLY", "O_RDWR", "O_CREAT", "O_TRUNC", "O_APPEND"}
STREAMS = {"text", "data", "stream", "'<bytes>'", "new"}
"""What these arguments are called; `new` is a file that put_in_place moves."""


def writing_calls(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Calls that write a file by its name: line and text."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        method = called.rpartition(".")[2]
        names = {each.attr for each in ast.walk(node) if isinstance(each, ast.Attribute)}
        given = [*node.args, *(each.value for each in node.keywords)]
        modes = [
            each.value for each in given if isinstance(each, ast.Constant) and isinstance(each.value, str)
        ]
        opens = method in ("open", "fdopen") and called not in ("os.open", "os.fdopen")
        if (
            method in METHODS
            or called in CALLS
            or (called == "os.open" and names & DESCRIPTORS)
            or (opens and any(WRITING & set(mode) and len(mode) <= 3 for mode in modes))
            or (called in TO_STREAMS and ast.unparse(node.args[TO_STREAMS[called]]) not in STREAMS)
        ):
            yield node.lineno, ast.unparse(node)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_is_opened_for_writing_elsewhere(package: str) -> None:
    found = [
        f"{name}:{line}: {call}"
        for file in sorted((REPOSITORY / package).rglob("*.py"))
        if (name := str(file.relative_to(REPOSITORY))) not in ELSEWHERE
        for line, call in writing_calls(tree_of(file))
    ]
    assert found == [], "use write_file or open_in_place of softsim_core.base.files"


def test_each_exception_still_writes() -> None:
    for name in ELSEWHERE:
        assert list(writing_calls(tree_of(REPOSITORY / name))), name


@pytest.mark.parametrize(
    "code",
    [
        'file.open("w")',
        'open(file, "ab")',
        'Path(file).open(mode="r+b")',
        "file.write_text(text)",
        "os.open(file, os.O_WRONLY | os.O_CREAT)",
        "figure.savefig(file)",
        "np.savez(file, points=points)",
        "shutil.copyfile(a, b)",
    ],
)
def test_what_writes_is_found(code: str) -> None:
    assert list(writing_calls(ast.parse(code)))


@pytest.mark.parametrize(
    "code", ['file.open("rb")', "open(file)", "os.open(file, os.O_RDONLY)", "figure.savefig(data)"]
)
def test_what_reads_or_fills_a_stream_is_left_alone(code: str) -> None:
    assert not list(writing_calls(ast.parse(code)))
