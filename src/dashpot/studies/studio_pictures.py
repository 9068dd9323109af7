"""Pictures of the studio as it is, one per tab and a guided scene, in a headless Chromium of 1280 x 800."""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable
from pathlib import Path

from PIL import Image

from dashpot.studies.visitor import Visitor, chromium, until
from dashpot.studio.page import Page, open_page
from dashpot.studio.scenes import SCENES

SETTLE = 3.0  # [s] for the browser to draw what it was told


def _tab(visitor: Visitor, name: str) -> None:
    visitor.click(name, "[role=tab]")
    visitor.page.mouse.move(640, 790)


def _guide(page: Page, visitor: Visitor) -> None:
    _tab(visitor, "Guide")
    visitor.click(SCENES[1].title, "button")
    until(lambda: page.session.rival_name == "law bypassed", "the scene")
    page.session.pause()
    page.session.step(4.4 - page.session.time)
    visitor.page.mouse.move(640, 790)


def _arm(page: Page, visitor: Visitor) -> None:
    page.session.move(0.3)
    page.session.step(6.0)
    _tab(visitor, "Arm")


def _controller(page: Page, visitor: Visitor) -> None:
    page.session.move(0.3)
    page.session.step(6.0)
    page.session.edit("all", R=1.0, D=2.5)
    page.session.edit("joint6", R=12.0, D=8.0)
    page.session.show("joint6")
    _tab(visitor, "Controller")
    certifier = page.session.certifier
    assert certifier is not None
    until(lambda: not certifier.busy, "proofs and map", 120.0)
    page.redraw()


def _faults(page: Page, visitor: Visitor) -> None:
    _tab(visitor, "Faults")
    page.session.move(0.3)
    page.session.step(5.0)
    page.session.fail("encoder_lost", "joint7")
    page.session.step(3.0)


def _record(page: Page, visitor: Visitor) -> None:
    page.session.move(0.3)
    page.session.step(6.0)
    _tab(visitor, "Record")


SHOTS: dict[str, Callable[[Page, Visitor], None]] = {
    "scene": _guide,
    "arm": _arm,
    "controller": _controller,
    "faults": _faults,
    "record": _record,
}
"""What is done before each picture, in this order."""


def pictures(out: Path, names: list[str]) -> list[Path]:
    """Writes studio-NAME.png files.

    Raises:
        DashpotError: There is no browser.
    """
    out.mkdir(parents=True, exist_ok=True)
    written = []
    with chromium() as browser:
        page = open_page("k807", "k807-wrist", None, host="127.0.0.1", port=8370, supervise=True, seed=0)
        page.wakes = False  # time goes on by hand: the same picture every time
        try:
            visitor = Visitor(browser, page.url)
            until(lambda: visitor.has("#dp-state"), "the page")
            for name, prepare in SHOTS.items():
                if name != "scene":
                    page.begin(lambda session: session.load("k807", "k807-wrist"), "k807", "k807-wrist")
                prepare(page, visitor)
                visitor.page.evaluate(  # viser's words on the machine that draws this
                    "document.querySelector('#webgl-software-rendering button')?.click()"
                )
                time.sleep(SETTLE)
                if name in names:
                    written.append(out / f"studio-{name}.png")
                    picture = Image.open(io.BytesIO(visitor.page.screenshot())).convert("RGB")
                    picture.point(lambda v: 5 * round(v / 5)).save(
                        written[-1], optimize=True
                    )  # half as large
        finally:
            page.close()
            page.session.close()
    return written


def main() -> int:
    """``python -m dashpot.studies.studio_pictures``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--only", nargs="+", choices=SHOTS, default=list(SHOTS))
    options = parser.parse_args()
    for path in pictures(options.out, options.only):
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
