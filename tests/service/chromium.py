"""Debian's Chromium for tests of the page; they skip with the reason if Chromium or Playwright is absent."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.patience import PATIENCE

CHROMIUM = shutil.which("chromium")
AXE = Path(__file__).parent / "vendor" / "axe.min.js"


@contextmanager
def chromium() -> Iterator[Any]:
    """Start the browser, once for a file of tests."""
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine: make service-tools installs it")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def tab(browser: Any, width: int = 1280, height: int = 800, theme: str = "light") -> Iterator[Any]:
    """Open a page in its own session; check at the end that it had no error and no violation of its policy.

    The policy is the page's Content-Security-Policy.
    """
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme)
    page = context.new_page()
    page.set_default_timeout(1000 * PATIENCE)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if "Content Security" in message.text else None)
    try:
        yield page
        assert problems == []
    finally:
        context.close()


def violations(page: Any) -> list[str]:
    """Return the violations that axe-core finds on the shown page."""
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")["violations"]
    return [f"{one['id']}: {json.dumps([node['target'] for node in one['nodes'][:3]])}" for one in found]


def until(page: Any, expression: str, seconds: float = PATIENCE) -> bool:
    """Return whether the expression becomes true in time; poll from outside, because the page's policy forbids code
    from text.
    """
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if page.evaluate(expression):
            return True
        page.wait_for_timeout(50)
    return False
