"""What the site has beside the pages of docs/: the library's names, notebooks, files that pages link to.

mkdocs calls these functions while it builds (`hooks` of mkdocs.yml).
"""

from __future__ import annotations

import importlib.util
import posixpath
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

FOLDER = Path(__file__).resolve().parent
REPOSITORY = FOLDER.parent
FRONT = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "CODE_OF_CONDUCT.md")
"""Pages of the repository's root that the site has, too; the first one is its home."""
LANGUAGES = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".json": "json", ".c": "c"}
PICTURES = (".gif", ".png", ".svg", ".webp")
LISTED = "| `{name}` |"

_FENCE = re.compile(r"^( *)```.*?^\1```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r'(?<=\]\()[^)\s#:]+(?=[)#])|(?<=\b(?:src|ref)=")[^"#:]+')


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add to the pages of docs/ those that are made."""
    for notebook in sorted((FOLDER / "notebooks").glob("*.ipynb")):
        text, pictures = _beside("notebook_pages").page(notebook)
        files.append(File.generated(config, f"notebooks/{notebook.stem}.md", content=text))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    for group, names in _beside("library").GROUPS.items():
        if names == "__version__":
            continue
        files.append(File.generated(config, library_page(group), content=_described(group, names.split())))
    waiting = [
        f"docs/{file.src_uri}" for file in files.documentation_pages() if file.abs_src_path
    ]  # not what was made above
    waiting += FRONT
    while waiting:
        path = waiting.pop()
        if path.endswith(PICTURES):
            files.append(File.generated(config, site_path(path), abs_src_path=str(REPOSITORY / path)))
            continue
        text = _text(path)
        if files.get_file_from_path(site_path(path)) is None:
            files.append(File.generated(config, site_path(path), content=_shown(path, text)))
        if path.endswith(".md") or (REPOSITORY / path).is_dir():
            found = {_target(path, link) for link in links(text)}
            waiting += [
                each
                for each in sorted(found)
                if not _in_docs(each) and files.get_file_from_path(site_path(each)) is None
            ]
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links lead to where the site has what they name."""
    place = page.file.src_uri
    if place == "library.md":
        for group, names in _beside("library").GROUPS.items():
            for name in names.replace("__version__", "").split():
                link = f"[`{name}`]({library_page(group)}#softsim_core.{name})"
                markdown = markdown.replace(LISTED.format(name=name), f"| {link} |")
    path = repository_path(place)

    def moved(link: str) -> str:
        if link.endswith(".ipynb") and place.startswith("notebooks/"):
            return link  # the notebook itself
        there = site_path(_target(path, link))
        return posixpath.relpath(there, posixpath.dirname(place) or ".")

    return _each_link(markdown, moved)


def links(text: str) -> list[str]:
    """Relative links and pictures outside of code blocks, without what stands behind `#`."""
    return _LINK.findall(_FENCE.sub("", text))


def site_path(path: str) -> str:
    """Where the site has a file of the repository, from the folder docs/."""
    if path == FRONT[0]:
        return "index.md"
    if path in FRONT:
        return f"developers/{path.lower()}"
    if _in_docs(path):
        return path.removeprefix("docs/").replace(".ipynb", ".md")
    return f"source/{path}" if path.endswith((".md", *PICTURES)) else f"source/{path}.md"


def _in_docs(path: str) -> bool:
    """Whether mkdocs finds a file by itself: programs of docs/ are shown as others of the repository are."""
    return path.startswith("docs/") and not path.endswith(".py")


def repository_path(place: str) -> str:
    """The file of the repository that a page of the site shows."""
    for path in FRONT:
        if site_path(path) == place:
            return path
    if place.startswith("source/"):
        path = place.removeprefix("source/")
        return path if (REPOSITORY / path).is_file() else path.removesuffix(".md")
    return f"docs/{place}"


def library_page(group: str) -> str:
    """The page of a group of the library's names."""
    return f"library/{re.sub(r'[^a-z]+', '_', group.lower())}.md"


def _beside(name: str) -> ModuleType:
    """A program of this folder, as a module."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _described(group: str, names: list[str]) -> str:
    """A page with all that the docstrings of these names say."""
    return "\n\n".join(
        [f"# {group}", *(f"::: softsim_core.{name}" for name in names if name != "__version__")]
    )


def _text(path: str) -> str:
    """What a file of the repository holds; of a folder, links to its files."""
    there = REPOSITORY / path
    if not there.is_dir():
        return there.read_text(encoding="utf-8")
    names = sorted(each.name for each in there.iterdir() if each.suffix in LANGUAGES)
    return "\n".join([f"# {path}", "", *(f"- [{name}]({there.name}/{name})" for name in names)])


def _shown(path: str, text: str) -> str:
    """A file or folder of the repository as a page."""
    if path.endswith(".md") or (REPOSITORY / path).is_dir():
        return text
    language = LANGUAGES.get(Path(path).suffix, "text")
    return f"---\nsearch: {{exclude: true}}\n---\n# {path}\n\n````{language}\n{text}\n````\n"


def _target(path: str, link: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(path), link))


def _each_link(text: str, change: Callable[[str], str]) -> str:
    """The text with every link outside of code blocks changed."""
    pieces, end = [], 0
    for fence in _FENCE.finditer(text):
        pieces += [_LINK.sub(lambda link: change(link[0]), text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*pieces, _LINK.sub(lambda link: change(link[0]), text[end:])])
