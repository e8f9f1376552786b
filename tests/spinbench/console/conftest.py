"""A browser without a window, and consoles that it looks at."""

import pytest

from tests.browser import installed
from tests.console_lab import PATIENT_MS, consoles


@pytest.fixture(scope="module")
def chromium():
    path = installed()
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as made:
        browser = made.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def start_console():
    with consoles() as start:
        yield start


@pytest.fixture
def window(chromium):
    """Opens windows, each with a storage of its own as another person's has; a page's own errors fail the test."""
    errors, contexts = [], []

    def opened(address):
        context = chromium.new_context(viewport={"width": 1200, "height": 1000})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENT_MS)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if "Content Security Policy" in said.text else None)
        page.goto(address)
        page.wait_for_selector("body:not(.is-lost)")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert errors == []
