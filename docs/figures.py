"""The figures of a gallery script, which are made without pyplot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def scrape_figures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figures that a gallery script has made since its last block, and return their RST."""
    seen = block_vars.setdefault("_seen_figures", set())
    made = [value for value in block_vars["example_globals"].values() if isinstance(value, Figure)]
    paths = []
    for figure in dict.fromkeys(made):
        if id(figure) in seen:
            continue
        seen.add(id(figure))
        path = Path(next(block_vars["image_path_iterator"]))
        figure.savefig(path, dpi=150)
        paths.append(str(path))
    return str(figure_rst(paths, gallery_conf["src_dir"]))
