"""Change the product in small ways, one at a time, and record whether its tests notice. Run by hand:

    python tests/mutation_check.py --out found.jsonl CHECKOUT [OTHER_CHECKOUT]

Each checkout has an environment in .softsim/venv. The mutations follow from the seed and are the same in all
checkouts: files that differ among them are left out. A mutation is killed where a test fails that passes
without it. The tests are those that `softsim test PATH` runs for the file; they run with -x, without those of
packaging and the exhaustive ones. A run that was interrupted goes on where it was: the output is kept.

With --executed, a folder for each checkout in which the plugin executed_functions has written what a whole
run of its suite executed, tests that run the changed function come first, the quickest in front, and of the
others only those that start processes: the rest cannot notice. Functions that no test runs in its own
process, such as kernels, have all their tests.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from softsim_ros.cli.upkeep import covering_tests

COUNTS = {"softsim_core": 30, "softsim_ros": 14, "softsim_node": 4, "servo_bridge": 12}
KINDS = ("sign", "bound", "factor", "check")
LEFT_OUT = ("softsim_ros/cli/upkeep/",)
"""The tests' own command."""

LIMIT_S = 3600.0
SWAPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
OTHER_BOUND = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}


@dataclass(frozen=True)
class Mutation:
    """One change of one file: the text between two places becomes another one."""

    file: str
    line: int
    kind: str
    start: int
    end: int
    before: str
    after: str


def skipped(node: ast.AST, parent: ast.AST | None) -> bool:
    """Whether what is below a node is text for people or types: it changes nothing that a robot does."""
    if isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert):
        return True
    if isinstance(parent, ast.AnnAssign | ast.arg) and node is parent.annotation:
        return True
    return isinstance(parent, ast.FunctionDef) and (node is parent.returns or node in parent.decorator_list)


def is_number(node: ast.AST) -> bool:
    value = node.value if isinstance(node, ast.Constant) else None
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_text(node: ast.AST) -> bool:
    texts = (ast.JoinedStr, ast.List, ast.Tuple, ast.Set)
    return any(
        isinstance(each, texts) or (isinstance(each, ast.Constant) and isinstance(each.value, str))
        for each in ast.walk(node)
    )


def changed(node: ast.AST) -> Iterator[tuple[str, ast.expr, str]]:
    """Kinds of mutations of a node: what is replaced, and by what."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub) and not is_text(node):
        swapped = ast.BinOp(node.left, SWAPPED[type(node.op)](), node.right)
        yield "sign", node, f"({ast.unparse(swapped)})"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not is_number(node.operand):
        yield "sign", node, f"({ast.unparse(node.operand)})"
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in SWAPPED:
        swapped_order = ast.Compare(node.left, [SWAPPED[type(node.ops[0])]()], node.comparators)
        yield "bound", node, f"({ast.unparse(swapped_order)})"
    if isinstance(node, ast.Name) and node.id in OTHER_BOUND and isinstance(node.ctx, ast.Load):
        yield "bound", node, OTHER_BOUND[node.id]
    if isinstance(node, ast.Attribute) and node.attr in OTHER_BOUND:
        yield "bound", node, f"{ast.unparse(node.value)}.{OTHER_BOUND[node.attr]}"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div) and not is_text(node):
        if is_number(node.left) and isinstance(node.op, ast.Mult):
            yield "factor", node, f"({ast.unparse(node.right)})"
        if is_number(node.right):
            yield "factor", node, f"({ast.unparse(node.left)})"
    if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in ("radians", "degrees"):
        yield "factor", node, f"({ast.unparse(node.args[0])})"
    if isinstance(node, ast.If) and not node.orelse and isinstance(node.body[-1], ast.Raise | ast.Return):
        yield "check", node.test, "False"


def mutations(root: Path, file: str) -> Iterator[Mutation]:
    """Every mutation of a file of a checkout."""
    text = (root / file).read_bytes()
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def below(node: ast.AST, parent: ast.AST | None = None) -> Iterator[ast.AST]:
        if not skipped(node, parent):
            yield node
            for child in ast.iter_child_nodes(node):
                yield from below(child, node)

    for node in below(ast.parse(text)):
        for kind, place, after in changed(node):
            assert place.end_lineno is not None
            assert place.end_col_offset is not None
            start = starts[place.lineno - 1] + place.col_offset
            end = starts[place.end_lineno - 1] + place.end_col_offset
            yield Mutation(file, place.lineno, kind, start, end, text[start:end].decode(), after)


def drawn(roots: list[Path], seed: int) -> list[Mutation]:
    """As many mutations of each package as COUNTS says, its kinds in turn, in an order of chance."""
    draw, found = random.Random(seed), list[Mutation]()
    for package, count in COUNTS.items():
        files = sorted(str(each.relative_to(roots[0])) for each in (roots[0] / package).rglob("*.py"))
        same = [
            file
            for file in files
            if not file.startswith(LEFT_OUT)
            and all(
                (root / file).is_file() and (root / file).read_bytes() == (roots[0] / file).read_bytes()
                for root in roots
            )
        ]
        every = [each for file in same for each in mutations(roots[0], file)]
        for number in range(count):
            left = [each for each in every if each not in found]
            of_kind = [each for each in left if each.kind == KINDS[number % len(KINDS)]]
            found.append(draw.choice(of_kind or left))
    draw.shuffle(found)
    return found


@contextmanager
def applied(root: Path, mutation: Mutation) -> Iterator[None]:
    """A checkout with the mutation; its file and its compiled kernels are as before in the end."""
    file = root / mutation.file
    seen, text = file.stat(), file.read_bytes()
    with tempfile.TemporaryDirectory() as kept:
        kernels = list(root.glob("softsim_core/**/__pycache__/kernels-*"))
        for number, folder in enumerate(kernels):
            shutil.copytree(folder, f"{kept}/{number}")
        try:
            file.write_bytes(text[: mutation.start] + mutation.after.encode() + text[mutation.end :])
            yield
        finally:
            file.write_bytes(text)
            os.utime(file, ns=(seen.st_atime_ns, seen.st_mtime_ns))
            for folder in root.glob("softsim_core/**/__pycache__/kernels-*"):
                if folder not in kernels:
                    shutil.rmtree(folder)
            for number, folder in enumerate(kernels):
                shutil.copytree(f"{kept}/{number}", folder, dirs_exist_ok=True)


class Executed:
    """Which tests of a checkout run a function in their own process, by what the plugin wrote in a folder."""

    def __init__(self, folder: Path) -> None:
        self._seconds: dict[str, float] = {}
        self._tests: dict[tuple[str, int], set[str]] = defaultdict(set)
        fixtures: dict[tuple[str, int], set[str]] = defaultdict(set)
        for line in (line for file in folder.glob("executed_*.jsonl") for line in file.open()):
            row = json.loads(line)
            self._seconds[row["id"]] = self._seconds.get(row["id"], 0.0) + row["seconds"]
            for file, number in row["functions"]:
                self._tests[file, number].add(row["id"])
                if row["when"] == "setup":
                    fixtures[file, number].add(row["id"].partition("::")[0])
        for test in self._seconds:  # what a fixture of a module ran serves all of its tests
            for function, files in fixtures.items():
                if test.partition("::")[0] in files:
                    self._tests[function].add(test)

    def tests_of(self, root: Path, mutation: Mutation) -> list[str]:
        """Tests that run the function around a mutation, the quickest first; empty where none does."""
        around = [
            min([node.lineno, *(each.lineno for each in node.decorator_list)])
            for node in ast.walk(ast.parse((root / mutation.file).read_bytes()))
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            and node.lineno <= mutation.line <= (node.end_lineno or 0)
        ]
        tests = self._tests.get((mutation.file, max(around)), ()) if around else ()
        return sorted(tests, key=lambda test: self._seconds[test])


def run(root: Path, tests: list[str]) -> tuple[int | None, list[str]]:
    """Run tests until one fails; returns pytest's exit code (None: out of time) and what failed."""
    words = [str(root / ".softsim/venv/bin/python"), "-m", "pytest", "-n", "0", "-x", "-q", "-rfE"]
    words += ["-p", "no:cacheprovider", "-m", "not exhaustive and not packaging"]
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as names:
        names.write("\n".join(tests))
        names.flush()
        process = subprocess.Popen(
            [*words, f"@{names.name}"],
            cwd=root,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.communicate()
            return None, []
    return process.returncode, re.findall(r"^(?:FAILED|ERROR) (tests/.+?)(?: - .*)?$", output, re.MULTILINE)


def judged(root: Path, mutation: Mutation, executed: Executed | None) -> dict[str, object]:
    """What the tests say of a mutation."""
    covering = [file for file in covering_tests(mutation.file, root) if (root / file).exists()]
    direct = executed.tests_of(root, mutation) if executed is not None else []
    if direct:
        files = [
            each for name in covering for each in (sorted((root / name).rglob("test_*.py")) or [root / name])
        ]
        covering = [str(file.relative_to(root)) for file in files if "mark.ros" in file.read_text()]
    began, failed = time.monotonic(), list[str]()
    code: int | None = 0
    with applied(root, mutation):
        for tests in filter(None, (direct, covering)):
            if code in (0, 5):  # 5: all of them were deselected
                code, failed = run(root, tests)
    verdicts = {0: "survived", 5: "survived", None: "out of time", 1: "killed"}
    if code not in verdicts and (code or 0) > 0:
        raise SystemExit(f"pytest ended with {code} on {mutation}")  # it could not run the tests
    verdict = verdicts.get(code, f"killed by signal {-(code or 0)}")
    if failed and run(root, failed[:1])[0] != 0:
        verdict = "fails without the mutation"
    return {"verdict": verdict, "by": failed[:1], "seconds": round(time.monotonic() - began)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkouts", nargs="+", type=Path, metavar="CHECKOUT")
    parser.add_argument("--executed", nargs="+", type=Path, default=[], help="folder of each checkout")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=sum(COUNTS.values()), help="the first of them only")
    parser.add_argument("--out", type=Path, required=True, help="results are added here, one JSON a line")
    parser.add_argument("--list", action="store_true", help="show the mutations and run nothing")
    arguments = parser.parse_args()
    roots = [each.resolve() for each in arguments.checkouts]
    executed = [Executed(each) for each in arguments.executed] or [None] * len(roots)
    done = arguments.out.read_text().splitlines() if arguments.out.exists() else []
    known = {(row["checkout"], row["file"], row["start"], row["kind"]) for row in map(json.loads, done)}
    for mutation in drawn(roots, arguments.seed)[: arguments.count]:
        print(f"{mutation.file}:{mutation.line}: {mutation.kind}: {mutation.before} -> {mutation.after}")
        for root, runs in zip(roots, executed, strict=True):
            if arguments.list or (str(root), mutation.file, mutation.start, mutation.kind) in known:
                continue
            row = {"checkout": str(root), **asdict(mutation), **judged(root, mutation, runs)}
            print(f"    {root}: {row['verdict']} {row['by']} {row['seconds']} s", flush=True)
            with arguments.out.open("a") as file:
                file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
