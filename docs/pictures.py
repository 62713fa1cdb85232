"""Draw pages of the built site with Chromium: `python -m docs.pictures FOLDER OUT`."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

PAGES = [
    "index",
    "start/your_log",
    "howto/status",
    "howto/status/dead_time",
    "explanation/method",
    "reference/commands",
]
PAGES += ["reference/api", "reference/axis_toml", "gallery/index", "gallery/mass_step", "results", "coming_from"]
SIZES = {"wide": (1280, 900), "phone": (390, 844)}


def draw_pages(folder: Path, out: Path, pages: list[str]) -> None:
    """Write a picture of each page for each size and colour scheme, and fail if a page is wider than its window."""
    out.mkdir(parents=True, exist_ok=True)
    wide = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for size, (width, height) in SIZES.items():
            for scheme in ("light", "dark"):
                tab = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
                for page in pages:
                    tab.goto((folder / f"{page}.html").resolve().as_uri())
                    tab.screenshot(path=out / f"{page.replace('/', '_')}-{size}-{scheme}.png", full_page=True)
                    if tab.evaluate("document.documentElement.scrollWidth") > width:
                        wide.append(f"{page} at {width} pixels")
                tab.close()
    if wide:
        sys.exit("wider than the window: " + ", ".join(wide))


if __name__ == "__main__":
    draw_pages(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:] or PAGES)
