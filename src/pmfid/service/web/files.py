"""The files of the page, by their names: read once, so that no request is ever a path."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

__all__ = ["PageFile", "page_files"]

KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}


@dataclass(frozen=True)
class PageFile:
    """content, its media type, and the tag by which a browser knows that it has it already."""

    content: bytes
    kind: str
    tag: str


def page_files() -> dict[str, PageFile]:
    """Name, as "/style.css", -> file; "/" is the page. Links that lead out of the folder are left out."""
    root = (Path(__file__).parent / "static").resolve()
    found = {}
    for path in sorted(root.rglob("*")):
        inside = path.resolve().is_relative_to(root) and path.is_file()
        if inside and path.suffix in KINDS:
            content = path.read_bytes()
            tag = f'"{sha256(content).hexdigest()[:16]}"'
            found["/" + path.relative_to(root).as_posix()] = PageFile(content, KINDS[path.suffix], tag)
    if "/index.html" in found:
        found["/"] = found["/index.html"]
    return found
