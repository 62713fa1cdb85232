"""The command line of a study that writes one page."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable
from pathlib import Path


def write_page(page: Callable[..., str], description: str | None) -> None:
    """Write the page to the file of --out; each parameter of `page` is an option with the type of its default."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, required=True, help="Markdown page to write")
    for name, parameter in inspect.signature(page).parameters.items():
        default = parameter.default
        parser.add_argument(f"--{name}", type=type(default), default=default, help="(default: %(default)s)")
    options = vars(parser.parse_args())
    out = options.pop("out")
    out.write_text(page(**options), encoding="utf-8")
