"""Build backend: setuptools with reproducible archives, which have the same bytes after every build.

Times are those of the environment variable SOURCE_DATE_EPOCH, else of 1980, where ZIP begins.
"""

from __future__ import annotations

import gzip
import io
import os
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403  (the other hooks)

EPOCH = os.environ.setdefault("SOURCE_DATE_EPOCH", "315532800")


def build_sdist(sdist_directory: str, config_settings: Mapping[str, Any] | None = None) -> str:
    """Write the source archive and return its name."""
    name = str(build_meta.build_sdist(sdist_directory, config_settings))
    normalise(Path(sdist_directory) / name, int(EPOCH))
    return name


def normalise(archive: Path, time_s: int) -> None:
    """Rewrite a .tar.gz: sort its members, and set one time in [s] since 1970, plain modes and no owner."""
    packed = io.BytesIO()
    with tarfile.open(archive) as source, tarfile.open(fileobj=packed, mode="w") as target:
        for member in sorted(source.getmembers(), key=lambda each: each.name):
            member.mtime, member.uid, member.gid, member.uname, member.gname = time_s, 0, 0, "", ""
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            member.pax_headers = {}
            target.addfile(member, source.extractfile(member) if member.isfile() else None)
    with archive.open("wb") as file, gzip.GzipFile("", "wb", fileobj=file, mtime=time_s) as zipped:
        zipped.write(packed.getvalue())
