"""The studio in a real browser: every step asserted on the simulation behind the page."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlparse

import numpy as np
import pytest

from dashpot.studies.visitor import COARSE, NoBrowserError, Visitor, chromium, until

pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")


# Time from a key to the map that shows it [ms], for every key.
MOVES = """() => {
    window.dpMoves = [];
    const at = () => document.querySelector('#dp-now')?.getAttribute('cx');
    let pressed = null, was = at();
    document.addEventListener('keydown', () => { pressed = performance.now(); }, true);
    new MutationObserver(() => {
        if (at() === was) return;
        was = at();
        if (pressed !== null) window.dpMoves.push(performance.now() - pressed);
        pressed = null;
    }).observe(document.body, {subtree: true, childList: true, attributes: true, characterData: true});
}"""


@pytest.fixture(scope="module")
def visit() -> Iterator[tuple[Visitor, object, object]]:
    from dashpot.studio.page import open_page

    page = open_page("k807", "k807-wrist", None, host="127.0.0.1", port=8360, supervise=True, seed=0)
    page.wakes = False  # the tests run it by hand: nothing is drawn while nobody needs it
    try:
        with chromium() as browser:
            yield Visitor(browser, page.url + COARSE), page, browser
    except NoBrowserError as missing:
        pytest.skip(str(missing))
    finally:
        page.close()
        page.session.close()


@pytest.mark.alone
def test_a_visit(visit, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Load, slider, certificate, fault, push, guided scene, replay, a second tab: as a newcomer would."""
    visitor, page, browser = visit
    session = page.session
    until(lambda: visitor.has("#dp-state"), "the page")
    session.step(0.2)

    # The certificate turns as R goes down, by keyboard; the proof follows the guess.
    visitor.click("Controller", "[role=tab]")
    until(lambda: visitor.has("tr[data-joint=joint7]"), "the margins")
    assert session.certifier.margins()[-1].verdict == "not certified"
    visitor.focus("D [N m s/rad]", "input")
    visitor.page.keyboard.press("Control+a")
    visitor.page.keyboard.type("2.5")
    until(lambda: session.config.joints[-1].D == 2.5, "D = 2.5")
    until(lambda: visitor.has("#dp-now"), "the map")
    visitor.focus("R [-]", "[role=slider]")
    visitor.page.evaluate(MOVES)
    for _ in range(88):
        visitor.page.keyboard.press("ArrowLeft")
        visitor.page.wait_for_timeout(120)  # the browser sends what comes faster as one
    until(lambda: session.config.joints[-1].R < 1.1, "a smaller R")
    until(lambda: session.certifier.margins()[-1].verdict == "certified", "the proof")
    until(lambda: visitor.has('tr[data-joint=joint7][data-verdict="certified"]'), "it on the page")
    judged, seen = list(page.controller.judged), visitor.page.evaluate("window.dpMoves")
    print(f"slider to margin: {1e3 * np.median(judged):.0f} ms, to the picture {np.median(seen):.0f} ms")
    assert len(judged) >= 50
    assert np.quantile(judged, 0.25) < 0.05  # other tests and the browser itself want the same cores
    assert visitor.page.evaluate("document.querySelector('#dp-map').dataset.inside") == "certified"

    # Bad input is explained beside the field and changes nothing.
    kept = session.config
    visitor.focus("R [-]", "input")
    visitor.page.keyboard.press("Control+a")
    visitor.page.keyboard.type("-3")
    until(lambda: "R [-] = -3" in visitor.text(".dp-trouble"), "the explanation")
    assert session.config == kept
    time.sleep(0.7)  # the page has shown all fields anew: what was typed is still there to be mended
    assert visitor.page.evaluate("document.activeElement.value") == "-3"

    # What a browser's field of numbers would have made 19 is refused as it was typed.
    visitor.click("Arm", "[role=tab]")
    visitor.focus("mass [kg]", "input")
    visitor.page.keyboard.press("Control+a")
    visitor.page.keyboard.type("1e9", delay=300)  # slowly: no half of it counts
    until(lambda: "mass [kg] = 1e9: must be 0 to 20" in visitor.text(".dp-trouble"), "the range")
    assert session.payload.mass == 0.0

    # The encoder is lost: the arm brakes.
    session.restart()
    session.move(0.3)
    session.step(4.0)
    visitor.click("Faults", "[role=tab]")
    visitor.click("encoder lost", "label")
    until(lambda: session.faults, "the fault")
    session.step(2.0)
    assert session.arm.state == "torque_brake"
    assert np.abs(session.snapshot().velocity).max() < 0.05
    until(
        lambda: visitor.page.evaluate("document.querySelector('#dp-state').dataset.state") == "torque_brake",
        "it",
    )
    visitor.click("Heal everything", "button")
    until(lambda: not session.faults, "healing")
    visitor.click("Resume tracking", "button")
    until(lambda: session.arm.state == "track", "tracking")

    # A link is pushed with the mouse.
    session.restart()
    session.step(0.2)
    felt = session.snapshot().torque
    visitor.page.keyboard.down("Control")
    _grasp(visitor, page)
    session.step(0.5)
    push = session.snapshot().push
    assert push is not None
    assert np.linalg.norm(push[0]) > 3.0
    # The torque sensors balance the hand, but for 0.05 N m of noise and the arm's slow yielding.
    arm = session.arm
    given = arm.push.torque(arm.model, arm.data)[arm.plant.rotor_dof]
    lost = np.abs(session.snapshot().torque - felt + given).max()
    assert lost < 0.3 + 0.25 * np.abs(given).max()
    assert np.abs(given).max() > 1.0
    visitor.page.mouse.up()
    visitor.page.keyboard.up("Control")
    until(lambda: session.arm.push is None, "letting go")

    # A guided scene.
    visitor.click("Guide", "[role=tab]")
    visitor.click("2 · Braking without an encoder (Fig. 5)", "button")
    until(lambda: session.rival_name == "law bypassed", "the scene")
    session.pause()
    session.step(6.0 - session.time)
    j = session.robot.index("joint7")
    mine, other = (session.past(rival=rival).channel("link_position")[:, j] for rival in (False, True))
    assert abs(np.degrees(mine[-1] - mine[int(3.3 / 0.005)])) < 3.0
    assert np.degrees(other[-1] - other[int(3.0 / 0.005)]) > 60.0

    # The replay, opened from a file without a server.
    visitor.click("Record", "[role=tab]")
    with visitor.page.expect_download() as download:
        visitor.click("3D replay as one HTML file", "button")
    file = tmp_path / "replay.html"
    download.value.save_as(file)
    offline = browser.new_context(offline=True)
    film = offline.new_page()
    film.goto(file.as_uri(), wait_until="commit")
    until(lambda: film.evaluate("!!document.querySelector('canvas')"), "the replay")
    offline.close()

    # Nothing left the machine, and nothing broke.
    hosts = {urlparse(url).hostname for url in visitor.requests if not url.startswith(("blob:", "data:"))}
    assert hosts <= {"127.0.0.1"}
    assert visitor.errors == []

    # A second tab comes and goes; the last one leaves, and time stands still.
    page.wakes = True
    second = Visitor(browser, page.url + COARSE, 640, 480)
    until(lambda: second.has("#dp-state"), "the second tab")
    session.start()
    second.page.close()
    until(lambda: page.visitors == 1, "one visitor")
    assert session.running
    visitor.page.close()
    until(lambda: not session.running, "standing still")


def _grasp(visitor: Visitor, page: object) -> None:
    """Takes hold of the forearm with the mouse and pulls; a mouse that misses turns the camera instead."""
    session = page.session  # type: ignore[attr-defined]
    for body in ("link5", "link6", "link5", "link6"):
        middle = _pixel(visitor, page, session.bodies()[0][0][session.arm.model.body(body).id])
        visitor.page.mouse.move(*middle)
        visitor.page.wait_for_timeout(500)
        visitor.page.mouse.down()
        visitor.page.wait_for_timeout(200)
        for k in range(1, 8):
            visitor.page.mouse.move(middle[0], middle[1] - 15 * k)
            visitor.page.wait_for_timeout(60)
        with suppress(AssertionError):
            until(lambda: session.arm.push is not None, "the hand", 5.0)
            if session.arm.model.body(session.arm.push.body).name in ("link4", "link5", "link6", "link7"):
                visitor.page.wait_for_timeout(500)  # what the mouse did last is on its way
                return
        visitor.page.mouse.up()
        visitor.page.wait_for_timeout(1000)
    raise AssertionError("the mouse meets no link")


def _pixel(visitor: Visitor, page: object, point: np.ndarray) -> tuple[float, float]:
    """Where a point of the world [m] is seen by the only visitor."""
    (client,) = page.server.get_clients().values()  # type: ignore[attr-defined]
    camera = client.camera
    eye, target = np.array(camera.position), np.array(camera.look_at)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    seen = point - eye
    canvases = visitor.page.evaluate(
        "() => [...document.querySelectorAll('canvas')].map(c => { const b = c.getBoundingClientRect();"
        " return [b.x, b.y, b.width, b.height]; })"
    )
    box = max(canvases, key=lambda b: b[2] * b[3])
    scale = box[3] / 2 / np.tan(float(camera.fov) / 2)
    depth = seen @ forward
    return (
        float(box[0] + box[2] / 2 + scale * (seen @ right) / depth),
        float(box[1] + box[3] / 2 - scale * (seen @ up) / depth),
    )
