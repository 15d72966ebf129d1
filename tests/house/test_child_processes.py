"""Every child process is started in one place, which keeps the current folder off its import path."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from source_trees import tree_of

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCES = (
    "softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "benchmarks", "docs", "examples",
    "build_backend",
)  # fmt: skip

STARTERS = {
    "subprocess": {"Popen", "run", "call", "check_call", "check_output", "getoutput", "getstatusoutput"},
    "os": {"system", "popen", "startfile", "posix_spawn", "posix_spawnp"},
    "pty": {"spawn", "fork"},
    "asyncio": {"create_subprocess_exec", "create_subprocess_shell"},
}
"""Functions that start a program, by their module of the standard library; os.exec* and os.spawn*, too."""

MAY_START = {
    "softsim_core/base/processes.py": "the one place",
    "softsim_ros/cli/install.py": "runs before the suite is installed; its programs are isolated (-I)",
    "softsim_node/environment.py": "becomes this program again, with its own options",
    "softsim_ros/cli/upkeep/suite.py": "becomes pytest, by a command of python_command",
}


def files() -> Iterator[tuple[str, ast.Module]]:
    for folder in SOURCES:
        for file in sorted((REPOSITORY / folder).rglob("*.py")):
            yield str(file.relative_to(REPOSITORY)), tree_of(file)


def starts(tree: ast.Module) -> Iterator[int]:
    """Lines that call a starter, by its module or by a name that was imported."""
    every = set().union(*STARTERS.values())
    imported = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in STARTERS
        for alias in node.names
        if alias.name in every or alias.name.startswith(("exec", "spawn"))
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name) and node.func.id in imported:
            yield node.lineno
        if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
            module, name = node.func.value.id, node.func.attr
            if name in STARTERS.get(module, ()) or (module == "os" and name.startswith(("exec", "spawn"))):
                yield node.lineno


def options(tree: ast.Module) -> Iterator[int]:
    """Lines of lists and tuples that hold the option -m or -c behind an interpreter."""
    for node in ast.walk(tree):
        if isinstance(node, ast.List | ast.Tuple):
            words = [each.value for each in node.elts if isinstance(each, ast.Constant)]
            names = {ast.unparse(each) for each in node.elts if not isinstance(each, ast.Constant)}
            if {"-m", "-c"} & set(words) and ("sys.executable" in names or "python" in " ".join(names)):
                yield node.lineno


def test_no_other_file_starts_a_process() -> None:
    found = [f"{name}:{line}" for name, tree in files() if name not in MAY_START for line in starts(tree)]
    assert found == []


def test_no_file_runs_a_module_without_a_safe_path() -> None:
    own = ("softsim_core/base/processes.py", "softsim_ros/cli/install.py")
    found = [f"{name}:{line}" for name, tree in files() if name not in own for line in options(tree)]
    assert found == []
    installer = (REPOSITORY / "softsim_ros/cli/install.py").read_text()
    assert re.findall(r'"-[IPum]".*"-[mc]"', installer) == ['"-I", "-u", "-m"']


def test_the_launcher_asks_each_python_in_isolation() -> None:
    launcher = (REPOSITORY / "softsim").read_text()
    calls = re.findall(r'"\$\w+"((?: -\w)+) ', launcher)
    assert calls.count(" -I -c") == 3
    assert {each for each in calls if " -I" not in each} <= {" -V", " -m"}
    assert re.findall(r".*-m softsim_ros.*", launcher) == [
        '    cd -- "$root" && PYTHONDONTWRITEBYTECODE=1 exec "$chosen" -m softsim_ros.cli "$@"'
    ]


def test_the_readers_see_every_form() -> None:
    code = """
import os, subprocess
from subprocess import Popen as start
start(["x"])
with subprocess.Popen(["x"]) as child: pass
os.execvp("x", ["x"])
subprocess.PIPE
command = [sys.executable, "-m", "x"]
command = (str(python), "-c", "x")
"""
    tree = ast.parse(code)
    assert sorted(starts(tree)) == [4, 5, 6]
    assert sorted(options(tree)) == [8, 9]
