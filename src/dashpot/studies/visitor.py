"""A visitor to the studio: a headless Chromium with mouse and keyboard, for tests, pictures and the soak."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from dashpot.errors import DashpotError

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
PATIENCE = 40.0  # [s]; the picture is drawn by the processor
COARSE = "/?fixedDpr=0.25"  # fewer pixels to draw


class NoBrowserError(DashpotError):
    """There is no Chromium to look with."""


@contextmanager
def chromium() -> Iterator[Any]:
    """The system's browser, else the one playwright has installed.

    Raises:
        NoBrowserError: There is neither, or no playwright.
    """
    help_ = "apt-get install chromium, or python -m playwright install chromium"
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        raise NoBrowserError("needs playwright and Chromium: pip install playwright; " + help_) from None
    with sync_playwright() as started:
        path = next(filter(None, map(shutil.which, NAMES)), None)
        try:
            browser = started.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        except Error as error:
            raise NoBrowserError(f"no Chromium: {str(error).strip().splitlines()[0]}; {help_}") from None
        try:
            yield browser
        finally:
            browser.close()


def until(true: Callable[[], Any], what: str, seconds: float = PATIENCE) -> Any:
    """Waits until something is true, and returns it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = true()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds:g} s: {what}")


class Visitor:
    """Somebody who looks at the studio and uses mouse and keyboard.

    Attributes:
        page: playwright's.
        requests: Addresses asked for.
        errors: Of the page.
    """

    def __init__(self, browser: Any, url: str, width: int = 1280, height: int = 800) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": height}, accept_downloads=True)
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(url, wait_until="commit")

    def has(self, selector: str) -> bool:
        """Whether the page has an element."""
        return bool(self.page.evaluate("s => !!document.querySelector(s)", selector))

    def text(self, selector: str) -> str:
        """Text of an element, "" where there is none."""
        return str(self.page.evaluate("s => document.querySelector(s)?.textContent ?? ''", selector))

    def click(self, text: str, tag: str = "*") -> None:
        """Clicks what has this text, with the mouse; brings it into view before."""
        script = """([t, tag]) => {
            const all = [...document.querySelectorAll(tag)]
                .filter(e => e.textContent.trim() === t && e.offsetParent);
            const e = all[all.length - 1];
            if (!e) return null;
            e.scrollIntoView({block: 'center'});
            const b = e.getBoundingClientRect();
            return [b.x + b.width / 2, b.y + b.height / 2];
        }"""
        x, y = until(lambda: self.page.evaluate(script, [text, tag]), f"{text!r} on the page")
        self.page.mouse.click(x, y)

    def focus(self, label: str, kind: str) -> None:
        """Puts the keyboard's focus on the field of a label: kind "input" or '[role=slider]'."""
        script = """([t, kind]) => {
            const label = [...document.querySelectorAll('label')].find(e => e.textContent.trim() === t);
            if (!label) return false;
            let box = label;
            while (box && !box.querySelector(kind)) box = box.parentElement;
            const e = box?.querySelector(kind);
            e?.focus();
            return !!e && document.activeElement === e;
        }"""
        until(lambda: self.page.evaluate(script, [label, kind]), f"a field {label!r}")

    def choose(self, label: str, entry: str) -> None:
        """Chooses an entry of the list with this label."""
        self.focus(label, "input")
        self.page.keyboard.press("Enter")
        self.click(entry, "[role=option]")
