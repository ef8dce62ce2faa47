"""A headless Chromium for the tests of reports; whoever has none skips them."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def chromium() -> str:
    """Where it is: $CHROMIUM, or under one of its names on the path."""
    names = (os.environ.get("CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome")
    found = next((path for name in names if name and (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("no Chromium installed: apt install chromium, or name one by CHROMIUM=…")
    return found


class Opened:
    """A report in a browser, and what the browser said and asked for."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.said: list[str] = []
        self.asked: list[str] = []
        page.on("console", lambda message: self.said.append(message.text))
        page.on("pageerror", lambda error: self.said.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))

    def open(self, path: Path) -> float:
        """Open a report and wait until it is drawn; how long that took [ms]."""
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready]", timeout=60_000)
        return float(self.page.evaluate("Number(document.documentElement.dataset.ready)"))

    def shown(self) -> tuple[int, int]:
        """How many rows are left, and how many of them keep every limit."""
        words = self.page.inner_text("#shown").split()
        return int(words[0]), int(words[5])


@contextmanager
def opened(profile: Path) -> Iterator[Opened]:
    """An empty page of a fresh browser."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright installed")
    with sync_api.sync_playwright() as started:
        context = started.chromium.launch_persistent_context(
            profile,
            executable_path=chromium(),
            headless=True,
            args=list(OPTIONS),
            viewport={"width": 1400, "height": 900},
            accept_downloads=True,
        )
        try:
            yield Opened(context.new_page())
        finally:
            context.close()
