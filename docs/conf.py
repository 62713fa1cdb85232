"""The configuration of Sphinx; `python -m docs.stage` prepares the pages that it reads."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import pmfid  # noqa: E402

project = "pmfid"
author = "the authors of pmfid"
release = version = pmfid.__version__
copyright = author
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
autosummary_generate = True
autodoc_typehints = "none"
# Members of Python's own classes are not explained again.
autodoc_default_options = {"members": True, "inherited-members": "IntFlag,int,Exception,Mapping,Sequence"}
napoleon_use_ivar = True
highlight_language = "text"
smartquotes = False
# A name in backticks of a docstring becomes a link where it is unique; the word "names" of a type is not.
default_role = "py:obj"
suppress_warnings = ["ref.python"]
templates_path = [str(ROOT / "docs" / "_templates")]
exclude_patterns = ["gallery/*.ipynb", "sg_execution_times.rst", "gallery/sg_execution_times.rst"]
# `python -m docs.links` checks the links inside the site. A build asks nothing of the net.

html_theme = "pydata_sphinx_theme"
html_title = "pmfid"
html_static_path = ["_static"]
html_css_files = ["pmfid.css"]
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "mathml"
html_context = {"default_mode": "auto"}
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": False,
    "header_links_before_dropdown": 6,
    "navigation_with_keys": False,
}
html_sidebars = {"results": [], "paper": [], "glossary": [], "coming_from": []}


sphinx_gallery_conf: dict[str, Any] = {
    "examples_dirs": [str(ROOT / "examples" / "gallery")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",
    "image_scrapers": ["docs.figures.scrape_figures"],
    "reset_modules": (),
    "capture_repr": (),
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 1000,
    "notebook_images": False,
}


def write_inline(translator: Any, node: nodes.math) -> None:
    """Write a formula as MathML, which browsers show without a script or a network."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def write_display(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed formula as MathML."""
    translator.body.append(f'<div class="formula">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def escape_bars(app: Any, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Escape the bars of absolute values, which RST takes for substitutions."""
    lines[:] = [line if line.lstrip().startswith(">>>") else re.sub(r"(?<!`)\|(?!`)", r"\\|", line) for line in lines]


def setup(app: Any) -> None:
    """Register the renderer of formulas, and the correction of docstrings."""
    app.connect("autodoc-process-docstring", escape_bars)
    app.add_html_math_renderer("mathml", (write_inline, None), (write_display, None))
