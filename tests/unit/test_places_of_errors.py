"""A refusal of a scene's file names the line and the column, the key, and what may have been meant."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from softsim_core import load_scene
from softsim_core.base import ConfigError

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
FILES = sorted([*(CONFIGS / "robots").glob("*.yaml"), *(CONFIGS / "scenes").glob("*.yaml")])
FREE = ("keys", "poses", "arm")
"""Sections in which some keys are names that a user gives."""


def typos(file: Path, count: int) -> list[tuple[int, int, str, str]]:
    """Keys of a file at random: line, column, name, and the name with two letters exchanged or one lost."""
    chosen = random.Random(file.name)
    found = []
    section = ""
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1):
        if top := re.match(r"(\w+):", line):
            section = top[1]
        for key in re.finditer(r"(?<![\w.])([a-z_]{4,}): ", line.split("#")[0] + " "):
            if (section not in FREE or top) and key[1] not in ("name", "kind"):  # they choose the item
                found.append((number, key.start(1) + 1, key[1]))
    if not found:
        return []
    wrong = []
    for number, column, key in chosen.sample(found, min(count, len(found))):
        at = chosen.randrange(len(key) - 1)
        swapped = key[:at] + key[at + 1] + key[at] + key[at + 2 :]
        wrong.append((number, column, key, swapped if swapped != key else key[:-1]))
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_misspelt_key_is_named_with_its_line_and_column(file: Path, tmp_path: Path) -> None:
    for folder in CONFIGS.iterdir():
        (tmp_path / folder.name).mkdir() if folder == file.parent else (tmp_path / folder.name).symlink_to(
            folder
        )
    for other in file.parent.iterdir():
        if other != file:
            (tmp_path / file.parent.name / other.name).symlink_to(other)
    copy = tmp_path / file.parent.name / file.name
    lines = file.read_text(encoding="utf-8").splitlines()
    for number, column, key, typo in typos(file, 6):
        changed = lines[:]
        line = changed[number - 1]
        changed[number - 1] = line[: column - 1] + typo + line[column - 1 + len(key) :]
        copy.write_text("\n".join(changed) + "\n", encoding="utf-8")
        with pytest.raises(ConfigError) as caught:
            load_scene(copy)
        error = caught.value
        assert error.file == str(copy), (typo, str(error))
        assert error.place == (number, column), (typo, str(error))
        assert f"line {number}, column {column}: " in str(error)
        assert typo in error.key, (typo, str(error))
        assert "\n" not in str(error)


def refusal(folder: Path, text: str) -> ConfigError:
    file = folder / "scene.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_scene(file)
    return caught.value


TRIPOD = f"extends: {CONFIGS / 'robots' / 'tripod.yaml'}\n"


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("name: x\nextensd: tripod.yaml\n", (2, 1), "did you mean extends? known keys: name, dt, gravity"),
        ("name: x\nextends: nowhere.yaml\n", (2, 1), "no such file"),
        (TRIPOD + "dt: fast\n", (2, 1), "dt: must be a number"),
        (TRIPOD + "keys:\n  pluss: {help: up, joints: [servo_0]}\n", (3, 3), "did you mean plus?"),
        (TRIPOD + "poses:\n  far: [0.0, 0.0]\n", None, "pose far has 2 values for 3 joints"),
        (
            TRIPOD
            + "bodies:\n  - name: silicone\n    material: {preste: Ecoflex 00-30, stiffness_factor: 2.0}\n",
            (4, 16),
            "preste: unknown key; did you mean preset?",
        ),
        (TRIPOD + "bodies:\n  - {name: silicone, colour: [1, 1]}\n", (3, 22), "must be a list of 4 numbers"),
        (TRIPOD + "bodies:\n  - {mane: silicone, colour: [1, 1, 1, 1]}\n", (3, 6), "item 0 has no `name`"),
        (
            TRIPOD + "bodies:\n  - name: silicone\n  - name: silicone\n",
            (4, 5),
            "a second item is named silicone",
        ),
        (TRIPOD + "joints:\n  - name: servo_1\n    limits:\n      lower: low\n", (5, 7), "must be a number"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(
    tmp_path: Path, text: str, place: tuple[int, int] | None, words: str
) -> None:
    error = refusal(tmp_path, text)
    assert error.place == place, str(error)
    assert words in str(error)


def test_a_value_of_the_file_below_is_named_there(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text(TRIPOD + "dt: fast\n", encoding="utf-8")
    error = refusal(tmp_path, "extends: base.yaml\nname: above\n")
    assert (error.file, error.place) == (str(tmp_path / "base.yaml"), (2, 1))


def test_a_chain_of_files_ends_in_one_message(tmp_path: Path) -> None:
    for number in range(1500):
        (tmp_path / f"{number}.yaml").write_text(f"extends: {number + 1}.yaml\n", encoding="utf-8")
    (tmp_path / "1500.yaml").write_text("name: x\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="extends: more than 32 files extend each other"):
        load_scene(tmp_path / "0.yaml")


@pytest.mark.parametrize(
    "text",
    [
        'name: x\n"\\e[31mred\\u202e": 1\n',
        'name: "\\e[2J"\n',
        'name: x\nbodies:\n  - {name: a, material: {"\\e[2Jx": 3}}\n',
        TRIPOD + 'poses:\n  "\\e]0;title\\a": [0.0]\n',
        'extends: "\\e[31m.yaml"\n',
    ],
)
def test_no_terminal_obeys_what_a_file_holds(tmp_path: Path, text: str) -> None:
    error = refusal(tmp_path, text)
    assert str(error).isprintable()
    assert "\\x1b" in str(error)
