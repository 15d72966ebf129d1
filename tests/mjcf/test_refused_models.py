"""MuJoCo models that are broken, hostile or too large: each refused in one sentence."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from softsim_core import load_scene
from softsim_core.base import MjcfError, SoftSimError
from softsim_core.mjcf import import_mjcf, look_at, read_source, source, write_imported
from softsim_core.scene.io import config_file

BODY = '<worldbody><geom type="plane" size="1 1 1"/>{}</worldbody>'
FLEX = (
    '<flexcomp name="f" type="grid" dim="3" count="{}" spacing="{}" mass="1" radius="0.001">'
    '<elasticity young="{}" poisson="0.3"/></flexcomp>'
)


def written(folder: Path, text: str | bytes, name: str = "model.xml") -> Path:
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def model(inside: str = "", beside: str = "") -> str:
    return f"<mujoco>{beside}{BODY.format(inside)}</mujoco>"


SEEN_BY_US = {
    "nothing": ("", "well-formed"),
    "binary": (bytes(range(256)), "well-formed"),
    "cut off": ("<mujoco><worldbody>", "well-formed"),
    "a web page": ("<html><body/></html>", "<html>, not <mujoco>"),
    "a URDF": ('<robot name="r"/>', "URDF"),
    "an entity bomb": (
        '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><mujoco model="&b;"/>',
        "declares a document type",
    ),
    "a length that is none": (model('<geom size="nan" pos="0 0 1"/>'), "geom: size is 'nan'"),
    "a place that is none": (model('<body name="b" pos="0 -inf 1"/>'), "body b: pos is '0 -inf 1'"),
    "a grid of 10^9": (model(FLEX.format("1000 1000 1000", "1 1 1", 1e5)), "1000000000 vertices"),
    "a file above": (model(beside='<include file="../other.xml"/>'), "outside the model's folder"),
    "an absolute file": (model(beside='<include file="/etc/passwd"/>'), "outside the model's folder"),
    "a mesh above": (
        model(beside='<asset><mesh name="m" file="../../m.stl"/></asset>'),
        "mesh m: file names '../../m.stl', which lies outside",
    ),
    "a folder of meshes above": (
        model(beside='<compiler meshdir="/usr/share"/>'),
        "meshdir names '/usr/share'",
    ),
    "an address": (model(beside='<asset><mesh file="http://a.b/c.stl"/></asset>'), "is no path of a file"),
    "a file that is missing": (
        model(beside='<include file="other.xml"/>'),
        "other.xml, which does not exist",
    ),
    "itself": (model(beside='<include file="model.xml"/>'), "twice or in a circle"),
}


@pytest.mark.parametrize("what", SEEN_BY_US)
def test_what_we_refuse_ourselves(what: str, tmp_path: Path) -> None:
    text, said = SEEN_BY_US[what]
    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "other.xml").write_text("<mujoco/>")
    with pytest.raises(MjcfError) as refusal:
        read_source(written(folder, text))
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_link_out_of_the_folder_is_outside(tmp_path: Path) -> None:
    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    (folder / "innocent.xml").symlink_to(tmp_path / "secret.xml")
    with pytest.raises(MjcfError, match="outside the model's folder"):
        read_source(written(folder, model(beside='<include file="innocent.xml"/>')))


@pytest.mark.parametrize(
    ("name", "most", "said"),
    [
        ("MOST_BYTES", 50, "longer than 50 bytes"),
        ("MOST_FILES", 1, "more than 1 files"),
        ("MOST_MESH_BYTES", 3, "4 bytes"),
    ],
)
def test_budgets(name: str, most: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, "<mujoco/>", "a.xml")
    written(tmp_path, b"1234", "m.stl")
    file = written(tmp_path, model(beside='<include file="a.xml"/><asset><mesh file="m.stl"/></asset>'))
    read_source(file)
    monkeypatch.setattr(source, name, most)
    with pytest.raises(MjcfError, match=said):
        read_source(file)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.xml", tmp_path):
        with pytest.raises(MjcfError, match="does not exist"):
            read_source(path)


def test_without_mujoco_it_is_said_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(MjcfError, match=r"pip install .*\[mujoco\]'"):
        import_mjcf(written(tmp_path, model()))


SEEN_BY_MUJOCO = {
    "an unknown element": model("<geometry/>"),
    "an unknown attribute": model('<geom size="1" colour="red"/>'),
    "words for numbers": model('<geom size="large"/>'),
    "no volume": model('<body><freejoint/><geom size="0"/></body>'),
    "no mass": model("<body><freejoint/></body>"),
    "a grid without width": model(FLEX.format("3 3 3", "0 0 0", 1e5)),
    "a grid of nothing": model(FLEX.format("0 0 0", "0.1 0.1 0.1", 1e5)),
    "a mesh that is missing": model(beside='<asset><mesh name="m" file="m.stl"/></asset>'),
    "a damaged mesh": model(beside='<asset><mesh name="m" file="damaged.stl"/></asset>'),
    "a damaged surface": model(beside='<asset><mesh name="m" file="damaged.obj"/></asset>'),
    "damaged tetrahedra": model(
        '<flexcomp name="f" type="gmsh" dim="3" file="damaged.msh"><elasticity young="1e5"/></flexcomp>'
    ),
    "an unknown plugin": model(beside='<extension><plugin plugin="no.such"/></extension>'),
    "a joint in the world": '<mujoco><worldbody><joint type="hinge"/></worldbody></mujoco>',
    "two of one name": model('<geom name="a" size="1"/><geom name="a" size="1"/>'),
    "nesting": "<mujoco><worldbody>" + "<body>" * 20000 + "</body>" * 20000 + "</worldbody></mujoco>",
    "nothing soft or solid": "<mujoco><worldbody/></mujoco>",
    "a time step of zero": model(beside='<option timestep="0"/>'),
    "a cloth alone": "<mujoco><worldbody><flexcomp name='f' dim='2' count='3 3 1' spacing='1 1 1'/>"
    "</worldbody></mujoco>",
}


@pytest.mark.parametrize("what", SEEN_BY_MUJOCO)
@pytest.mark.slow
def test_what_mujoco_refuses_is_one_sentence(what: str, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    for name in ("damaged.stl", "damaged.obj", "damaged.msh"):
        written(tmp_path, b"v nan 1 2\nf 1 2 99999999\n$MeshFormat\n\xff\x00" * 20, name)
    with pytest.raises(MjcfError) as refusal:
        import_mjcf(written(tmp_path, SEEN_BY_MUJOCO[what]))
    assert str(refusal.value).startswith(str(tmp_path / "model.xml"))
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 600


def test_what_takes_too_long_is_stopped(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(MjcfError, match=r"stopped after 0\.01 s"):
        look_at(written(tmp_path, model()), time_limit=0.01)


def test_more_vertices_than_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a file of tetrahedra, too, whose size no grid tells."""
    pytest.importorskip("mujoco")
    from softsim_core.mjcf import reading

    monkeypatch.setattr(reading, "MOST_VERTICES", 26)
    with pytest.raises(MjcfError, match="has 27 vertices in its flexes, more than 26"):
        import_mjcf(written(tmp_path, model(FLEX.format("3 3 3", "0.1 0.1 0.1", 1e5))))


NUMBERS = ("0", "-1", "1e30", "1e-30", "1e308", "99999", "-0.0", "2147483648", "0.5", "x", "")


def mutated(text: str, rng: random.Random) -> str:
    """A model with a number, a line, an attribute or a letter changed."""
    lines, way = text.split("\n"), rng.randrange(5)
    if way == 0:
        at = rng.choice(list(re.finditer(r'(?<=[" ])-?[0-9.]+(e-?\d+)?(?=[" ])', text)))
        return text[: at.start()] + rng.choice(NUMBERS) + text[at.end() :]
    if way == 1:
        at = rng.choice(list(re.finditer(r' [a-z]+="[^"]*"', text)))
        return text[: at.start()] + text[at.end() :]
    if way == 2:
        del lines[rng.randrange(len(lines))]
    elif way == 3:
        lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    else:
        k = rng.randrange(len(text))
        return text[:k] + chr(rng.randrange(1, 300)) + text[k + 1 :]
    return "\n".join(lines)


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(300))
def test_damaged_models_become_a_scene_or_a_sentence(seed: int, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    rng = random.Random(seed)
    texts = [file.read_text() for file in sorted(config_file("mjcf/cantilever.xml").parent.glob("*.xml"))]
    text = rng.choice(texts)
    for _ in range(rng.randint(1, 3)):
        text = mutated(text, rng)
    said = ""
    try:
        made = import_mjcf(written(tmp_path, text))
        load_scene(write_imported(made, tmp_path / "to", "model.xml"))
    except SoftSimError as refusal:
        said = str(refusal)
    assert "\n" not in said
