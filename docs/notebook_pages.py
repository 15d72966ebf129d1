"""Notebooks as pages of the site: run in a kernel, then Markdown with what the cells gave.

They are stored without outputs; a cell that fails ends the build.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

LONGEST_S = 600
"""A cell may take so long on a busy machine."""


def page(file: Path) -> tuple[str, dict[str, bytes]]:
    """Markdown of a notebook that was run, and its pictures by name.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell failed.
    """
    notebook = nbformat.read(file, as_version=4)
    NotebookClient(notebook, timeout=LONGEST_S, resources={"metadata": {"path": str(file.parent)}}).execute()
    pictures: dict[str, bytes] = {}
    blocks = list(_blocks(notebook, file.stem, pictures))
    note = f"*A notebook: [download {file.name}]({file.name}). Run when this page was built.*"
    blocks.insert(1, note)
    return "\n\n".join(blocks) + "\n", pictures


def _blocks(notebook: Any, name: str, pictures: dict[str, bytes]) -> Iterator[str]:
    """The title, then each cell with its outputs."""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            title, _, rest = cell.source.partition("\n")
            yield from filter(None, (title, rest.strip())) if title.startswith("# ") else (cell.source,)
            continue
        yield f"```python\n{cell.source}\n```"
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{name}_{len(pictures)}.png"
                pictures[picture] = base64.b64decode(data["image/png"])
                yield f"![What the cell draws]({picture})"
            elif output.get("text") or "text/plain" in data:
                text = output.get("text") or data["text/plain"]
                yield f"```text\n{text.rstrip()}\n```"
