"""The command line as people expect it: overview, near names, options, exit codes, colours, Tab."""

from __future__ import annotations

import argparse
import io
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import softsim_core
from softsim_core.base import install_command
from softsim_ros.cli import Colours, Parser, app, main

REPOSITORY = Path(__file__).resolve().parents[2]
NEWCOMERS = ("up", "demo", "scenes", "new", "doctor")


def softsim(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", *words],
        cwd=REPOSITORY,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), **variables},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_softsim_alone_shows_five_commands_and_names_the_rest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    assert [name for name, command in app.COMMANDS.items() if command.help in shown] == [
        name for name in app.COMMANDS if name in NEWCOMERS
    ]
    for name in app.COMMANDS:
        assert name in shown
    assert len(shown.splitlines()) < 24  # a small terminal


def test_a_command_in_no_group_is_shown_nevertheless(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(app.COMMANDS, "juggle", app.Command("nowhere", "keep three balls in the air"))
    assert main(["--help"]) == 0
    assert "keep three balls in the air" in capsys.readouterr().out.split("more:")[1]


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (["upp"], 2, "softsim: unknown command 'upp'; did you mean up? (all: softsim --help)"),
        (["tripood"], 2, "to run the robot: softsim up tripod"),
        (["up", "--heedless"], 2, "unrecognized arguments: --heedless; did you mean --headless?"),
        (["up", "--xyz=2"], 2, "unrecognized arguments: --xyz=2\n"),
        (["demo", "gras"], 2, "'gras' is not one of grasp, pick_and_place (did you mean grasp?)"),
        (["material", "Dragonskin 2O"], 1, "did you mean Dragon Skin 20 or Dragon Skin 30?"),
        (["workspace", "tripood"], 1, "did you mean tripod"),
        (["validate", "silicon_beam"], 1, "did you mean silicone_beam"),
        (["urdf", "tripod", "--nmaespace", "x"], 2, "did you mean --namespace?"),
    ],
)
def test_a_wrong_word_is_answered_with_a_near_one(
    words: list[str], code: int, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        ended = main(words)
    except SystemExit as end:
        ended = int(str(end.code))
    assert ended == code
    told = capsys.readouterr().err
    assert sentence in told
    assert told.count(",") < 30
    assert "Traceback" not in told


def parsers() -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Every command's parser, and those of what it does: "mjcf import"."""
    for name, command in app.COMMANDS.items():
        parser = Parser(prog=name)
        command.import_module().configure(parser)
        yield name, parser
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                yield from ((f"{name} {each}", below) for each, below in action.choices.items())


def test_every_command_is_made_alike() -> None:
    outs = 0
    for name, parser in parsers():
        assert isinstance(parser, Parser), name  # near names
        assert parser.format_help(), name
        for action in parser._actions:
            words = action.option_strings
            assert action.help or isinstance(action, argparse._SubParsersAction), (name, action.dest)
            assert not ({"-o", "--out", "--to", "--output"} & {*words}) or {"-o", "--out"} <= {*words}, name
            assert all(re.fullmatch("-[a-z]|--[a-z]+(-[a-z0-9]+)*", word) for word in words), (name, words)
            outs += "-o" in words
    assert outs >= 12


@pytest.mark.parametrize("name", [name for name, each in app.COMMANDS.items() if not each.passes_on])
def test_every_command_refuses_what_it_does_not_know(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--no-such-word"])
    assert ended.value.code == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith(f"softsim {name}: error: ")


def test_the_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"softsim {softsim_core.__version__}\n"


@pytest.mark.slow
def test_exit_codes_are_those_that_the_help_tells(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--help"])
    shown = capsys.readouterr().out
    for code, meaning in app.EXIT_CODES.items():
        assert f"  {code:<18}{meaning}" in shown
    text = (REPOSITORY / "docs" / "command_line.md").read_text()
    assert all(f"| {code} |" in text for code in app.EXIT_CODES)
    assert softsim("scenes").returncode == 0
    assert softsim("scenes", "--show", "tripood").returncode == 1
    assert softsim("fly").returncode == 2


def test_an_interrupted_command_ends_with_130() -> None:
    code = (
        "import os, signal, sys; from softsim_ros.cli import app, main\n"
        "class Long:\n"
        "    configure = staticmethod(lambda parser: None)\n"
        "    run = staticmethod(lambda arguments: os.kill(os.getpid(), signal.SIGINT))\n"
        "sys.modules['softsim_ros.cli.long'] = Long\n"
        "app.COMMANDS['long'] = app.Command('long', 'x')\n"
        "sys.exit(main(['long']))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (130, b"softsim: interrupted\n")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_colours_are_for_terminals_that_have_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert Colours(Terminal())("red", "no") == "\x1b[31mno\x1b[0m"
    assert Colours(io.StringIO())("red", "no") == "no"
    monkeypatch.setenv("TERM", "dumb")
    assert Colours(Terminal())("red", "no") == "no"
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    assert Colours(Terminal())("red", "no") == "no"


@pytest.mark.parametrize(
    "words",
    [
        ("doctor", "--port", "/dev/none"),
        ("up", "tripood"),
        *(pytest.param(words, marks=pytest.mark.exhaustive) for words in ((), ("--help",))),
    ],
)
@pytest.mark.slow
def test_a_pipe_gets_no_colours(words: tuple[str, ...]) -> None:
    done = softsim(*words, TERM="xterm-256color")
    assert "\x1b" not in done.stdout + done.stderr


def candidates(line: str, tmp_path: Path) -> set[str]:
    """What Tab proposes at the end of a line."""
    file = tmp_path / "proposed"
    done = softsim(
        _ARGCOMPLETE="1",
        _ARGCOMPLETE_STDOUT_FILENAME=str(file),
        _ARGCOMPLETE_IFS="\n",
        _ARGCOMPLETE_COMP_WORDBREAKS=" ",
        COMP_LINE=line,
        COMP_POINT=str(len(line)),
        COMP_TYPE="9",
    )
    assert done.stderr == ""
    return {each.strip() for each in file.read_text().split("\n") if each}


@pytest.mark.parametrize(
    ("line", "some"),
    [
        ("softsim re", {"record", "replay", "report"}),
        ("softsim up tripod_m", {"tripod_mid"}),
        ("softsim up --hea", {"--headless"}),
        ("softsim run tel", {"teleop"}),
        ("softsim demo ", {"grasp", "pick_and_place"}),
        ("softsim completion ", {"bash", "zsh", "fish"}),
    ],
)
@pytest.mark.slow
def test_tab_completes_commands_options_and_names(line: str, some: set[str], tmp_path: Path) -> None:
    pytest.importorskip("argcomplete")
    found = candidates(line, tmp_path)
    assert some <= found
    assert all(each.startswith(line.split(" ")[-1]) for each in found), found


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_code_for_a_shell_is_accepted_by_it(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("argcomplete")
    assert main(["completion", shell]) == 0
    code = capsys.readouterr().out
    assert "softsim" in code
    if program := shutil.which(shell):
        subprocess.run([program, "-n"], input=code, text=True, check=True, timeout=60)


def test_bash_completes_with_it(tmp_path: Path) -> None:
    pytest.importorskip("argcomplete")
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash")
    program = tmp_path / "softsim"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m softsim_ros.cli "$@"\n')
    program.chmod(0o755)
    script = (
        'eval "$(softsim completion bash)"\n'
        "COMP_LINE='softsim rep'; COMP_POINT=11; COMP_TYPE=9; COMP_WORDS=(softsim rep); COMP_CWORD=1\n"
        '_python_argcomplete softsim rep softsim; echo "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        [bash, "-c", script],
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.split() == ["replay", "report"]


def test_without_argcomplete_a_sentence_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "argcomplete.shell_integration", None)
    assert main(["completion", "bash"]) == 1
    assert install_command("completion") in capsys.readouterr().err


def test_wrong_choices_of_numbers_are_refused_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="softsim mesh")
    parser.add_argument("--order", type=int, choices=(1, 2))
    with pytest.raises(SystemExit):
        parser.parse_args(["--order", "3"])
    assert "argument --order: 3 is not one of 1, 2" in capsys.readouterr().err
    assert parser.parse_args(["--order", "2"]) == argparse.Namespace(order=2)
