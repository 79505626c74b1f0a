"""A headless browser in which a page must log no error and request no other file."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

_LIMIT_MS = 120_000  # enough for a busy machine


@contextmanager
def headless_browser() -> Iterator[Browser]:
    """Run a browser, or skip the test where none is installed."""
    chromium = shutil.which('chromium') or shutil.which('google-chrome')
    if chromium is None:
        pytest.skip('no chromium on this machine: apt install chromium')
    with sync_playwright() as driver:
        running = driver.chromium.launch(
            executable_path=chromium, args=['--no-sandbox'], timeout=_LIMIT_MS
        )
        yield running
        running.close()


@contextmanager
def shown_on_a_phone(browser: Browser, url: str) -> Iterator[Page]:
    """Show a page offline on a small screen; check that it logs and requests nothing."""
    context = browser.new_context(viewport={'width': 390, 'height': 844}, offline=True)
    shown = context.new_page()
    shown.set_default_timeout(_LIMIT_MS)
    logged: list[str] = []
    shown.on('console', lambda message: logged.append(message.text))
    shown.on('pageerror', lambda error: logged.append(str(error)))
    shown.on('request', lambda request: logged.extend([request.url] * (request.url != url)))
    shown.goto(url)
    yield shown
    context.close()
    assert [line for line in logged if not line.startswith('data:')] == []
