"""A headless browser in which a page must neither complain nor ask for anything."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

_PATIENCE_MS = 120_000  # of a busy machine


@contextmanager
def headless_browser() -> Iterator[Browser]:
    """Run a browser; a machine without one skips the test."""
    chromium = shutil.which('chromium') or shutil.which('google-chrome')
    if chromium is None:
        pytest.skip('no chromium on this machine: apt install chromium')
    with sync_playwright() as driver:
        running = driver.chromium.launch(
            executable_path=chromium, args=['--no-sandbox'], timeout=_PATIENCE_MS
        )
        yield running
        running.close()


@contextmanager
def shown_on_a_phone(browser: Browser, url: str) -> Iterator[Page]:
    """Show a page with no network; in the end it must have said and asked for nothing."""
    context = browser.new_context(viewport={'width': 390, 'height': 844}, offline=True)
    shown = context.new_page()
    shown.set_default_timeout(_PATIENCE_MS)
    said: list[str] = []
    shown.on('console', lambda message: said.append(message.text))
    shown.on('pageerror', lambda error: said.append(str(error)))
    shown.on('request', lambda request: said.extend([request.url] * (request.url != url)))
    shown.goto(url)
    yield shown
    context.close()
    assert [line for line in said if not line.startswith('data:')] == []
