"""A report's page as a browser shows it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDTH, HEIGHT = 1100, 3000  # px
SWITCHES = (
    "--headless --no-sandbox --disable-gpu --hide-scrollbars --disable-background-networking "
    "--disable-component-update --disable-sync --no-first-run"
)

# A word may end a line at its hyphens.
MISFITS = r"""() => {
  const lines = range => new Set([...range.getClientRects()].map(one => Math.round(one.top))).size;
  const found = [];
  for (const place of document.querySelectorAll(".wide"))
    if (place.scrollWidth > place.clientWidth) found.push("wider than its place: " + place.innerText.slice(0, 60));
  for (const cell of document.querySelectorAll("td, th")) {
    const texts = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
    while (texts.nextNode())
      for (const word of texts.currentNode.data.matchAll(/[^\s-]+/g)) {
        const range = document.createRange();
        range.setStart(texts.currentNode, word.index);
        range.setEnd(texts.currentNode, word.index + word[0].length);
        if (lines(range) > 1) found.push("broken: " + word[0]);
      }
  }
  return found;
}"""


def installed() -> str:
    """The browser of this machine; without one the test is skipped."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    return browser


def shown(page: bytes, folder: Path) -> np.ndarray:
    """A picture of the page, shape (HEIGHT, WIDTH, 3), black 0 and white 1; without a browser the test is skipped."""
    browser = installed()
    (folder / "report.html").write_bytes(page)
    picture = folder / "page.png"
    places = [f"--user-data-dir={folder / 'profile'}", f"--screenshot={picture}", f"--window-size={WIDTH},{HEIGHT}"]
    address = (folder / "report.html").as_uri()
    subprocess.run([browser, *SWITCHES.split(), *places, address], check=True, capture_output=True, timeout=120)
    seen = imread(picture)[..., :3]
    assert seen.shape[:2] == (HEIGHT, WIDTH)
    return seen


def misfits(page: bytes, folder: Path, width: int) -> list[str]:
    """Tables of the page that are wider than their place at this width [px], and words in them that are broken."""
    path = installed()
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    (folder / "report.html").write_bytes(page)
    with api.sync_playwright() as made:
        browser = made.chromium.launch(executable_path=path, args=["--no-sandbox"])
        window = browser.new_page(viewport={"width": width, "height": 1000})
        window.goto((folder / "report.html").as_uri())
        window.evaluate("document.querySelectorAll('details').forEach(part => part.open = true)")
        assert window.locator(".wide table").count()
        found: list[str] = window.evaluate(MISFITS)
        browser.close()
    return found


def has_print(seen: np.ndarray) -> bool:
    """Whether there is print on many of a picture's lines: it is not a blank page."""
    return bool((seen < 0.5).any(axis=(1, 2)).mean() > 0.3)
