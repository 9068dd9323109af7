"""The panels of the page, without a browser: what is typed, pressed and loaded, and what is then said."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")

from dashpot.arm.payload import Payload
from dashpot.certify.certificate import STATEMENT
from dashpot.errors import InputError
from dashpot.studio import markup
from dashpot.studio.charts import CHARTS, least_span
from dashpot.studio.choices import HEAVIEST, POUND
from dashpot.studio.page import Page, open_page
from dashpot.studio.panels.faults import HEAL_FIRST
from dashpot.studio.scenes import SCENES
from dashpot.studio.session import Session


@pytest.fixture(scope="module")
def opened() -> Iterator[Page]:
    found = open_page("k807", "k807-wrist", None, host="127.0.0.1", port=8380, supervise=True, seed=0)
    found.wakes = False
    yield found
    found.close()
    found.session.close()


@pytest.fixture
def page(opened: Page) -> Page:
    opened.load("k807", "k807-wrist")
    opened._show_fields()  # what was there before is gone from the fields, too
    return opened


def by_user(handle: Any, value: Any) -> None:
    """What the browser does: a value, and everybody who listens is told."""
    handle.value = value
    for heard in handle._impl.update_cb:
        heard(SimpleNamespace(client=object(), client_id=0, target=handle))


def until(what: Any) -> None:
    end = time.monotonic() + 10.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_another_robot_comes_with_its_controller(page: Page) -> None:
    panel = page.arm_panel
    panel._robot.value = "fr3"
    panel._loaded()
    assert (page.robot_name, page.controller_name) == ("fr3", "fr3")
    assert panel._controller.value == "fr3"
    page._show_text()
    assert "fr3 under fr3" in page.status.content


def test_a_refused_load_says_what_was_tried_and_shows_what_runs(page: Page) -> None:
    panel, arm = page.arm_panel, page.session.arm
    panel._robot.value, panel._controller.value = "fr3", "k807-resonant"
    panel._loaded()
    assert "fr3 under k807-resonant: " in panel._beside._place.content
    assert (panel._robot.value, panel._controller.value) == ("k807", "k807-wrist")
    assert page.session.arm is arm


def test_only_a_robot_that_can_carry_itself_is_asked(page: Page) -> None:
    panel = page.arm_panel
    panel.refresh()
    assert not panel._carried.visible
    page.load("fr3", "fr3")
    panel.refresh()
    assert panel._carried.visible
    by_user(panel._carried, False)
    assert not page.session.arm.carried
    by_user(panel._carried, True)
    assert page.session.arm.carried


def test_a_scene_s_words_go_with_it(page: Page) -> None:
    page.guide._begin(SCENES[2])
    assert "not certified" in page.guide._words.content
    assert "No supervisor" in page.guide._words.content
    page.load("k807", "k807-wrist")
    assert page.guide._words.content == ""
    assert page.session.supervised


@pytest.mark.parametrize(
    ("field", "typed", "words"),
    [
        ("_kilograms", "1e9", f"mass [kg] = 1e9: must be 0 to {HEAVIEST:g}"),
        ("_pounds", "60", f"mass [lb] = 60: must be 0 to {HEAVIEST / POUND:.4g}"),
    ],
)
def test_a_mass_is_refused_in_its_own_unit(page: Page, field: str, typed: str, words: str) -> None:
    panel = page.arm_panel
    by_user(getattr(panel, field).handle, typed)
    until(lambda: words in panel._beside_load._place.content)
    assert page.session.payload.mass == 0.0


def test_the_offset_is_read_and_bounded(page: Page) -> None:
    panel = page.arm_panel
    by_user(panel._pounds.handle, "10")
    until(lambda: page.session.payload.mass > 0)
    assert page.session.payload.mass == pytest.approx(10 * POUND)
    for typed, wanted in (("0 0 0.1", [0.0, 0.0, 0.1]), ("0.2", [0.2, 0.0, 0.0])):
        by_user(panel._offset, typed)
        until(lambda wanted=wanted: np.array_equal(page.session.payload.position, wanted))
    for typed, words in (("9", "must be -2 to 2 m"), ("1 2", "must be three numbers")):
        by_user(panel._offset, typed)
        until(lambda words=words: words in panel._beside_load._place.content)
    assert page.session.payload.position[0] == 0.2


def test_no_payload_gets_past_the_bound(page: Page) -> None:
    with pytest.raises(InputError, match="0 to 20 kg"):
        page.load("k807", "k807-wrist", Payload(HEAVIEST + 1))
    with pytest.raises(InputError, match="0 to 20 kg"):
        page.session.set_payload(HEAVIEST + 1)


def test_an_amplitude_out_of_range_moves_nothing(page: Page) -> None:
    panel, reference = page.arm_panel, page.session.arm.reference
    panel._amplitude.handle.value = "5"
    panel._do(lambda: page.session.move(panel._amplitude.read()))
    assert "amplitude [rad] = 5: must be 0.01 to 1" in panel._beside_motion._place.content
    assert page.session.arm.reference is reference


def test_an_unusual_number_is_taken_and_remarked(page: Page) -> None:
    panel = page.controller
    by_user(panel._joint, "joint7")
    assert panel._edit("R", 900.0)
    assert page.session.config.joints[-1].R == 900.0  # type: ignore[attr-defined]
    assert "R [-] = 900.0: is unusual (typical: 0.01 to 200);" in panel._beside._place.content
    assert panel._edit("R", 9.0)
    assert panel._beside._place.content == ""
    assert not panel._edit("R", -1.0)
    assert "and at most 10000<" in panel._beside._place.content  # no unit where there is none


def test_the_verdict_has_its_caveat_and_the_strip_a_torque_limit(page: Page) -> None:
    page._show_fields()
    caveat = page.controller._margins.content
    assert markup.ASSUMED in caveat
    assert markup.ASSUMED in STATEMENT
    session = page.session
    session.step(0.6)
    page._show_text()
    assert "at its torque limit" not in page.status.content
    session.set_payload(HEAVIEST, (0.5, 0.0, 0.0))
    session.step(0.6)
    page._show_text()
    assert "at its torque limit" in page.status.content


def test_resume_while_a_fault_acts_is_warned_of(page: Page) -> None:
    session, panel = page.session, page.faults
    session.fail("encoder_lost", "joint6")
    session.step(0.5)
    panel.tell()
    assert HEAL_FIRST in panel._warning.content
    session.resume()
    session.step(0.5)
    assert session.arm.state != "track"
    session.heal()
    panel.tell()
    assert panel._warning.content == ""


def test_gains_are_looked_at_then_taken_then_given_back(page: Page) -> None:
    folder, session = page.controller.design, page.session
    before = session.config
    by_user(page.controller._joint, "joint7")
    folder._pressed()
    time.sleep(1.2)
    folder.refresh()
    assert "joint7: 1 s" in folder._said.content or not folder.designer.busy
    end = time.monotonic() + 120.0
    while folder.designer.busy and time.monotonic() < end:
        time.sleep(0.1)
    assert "stop time" in folder._said.content
    assert session.config == before
    assert folder._take.visible
    folder.take()
    assert session.config != before
    folder.undo()
    assert session.config == before


def test_the_damping_chart_marks_the_present_load(page: Page) -> None:
    session = page.session
    alone = session.inertia("joint6")
    session.set_payload(5.0, (0.0, 0.0, 0.1))
    session.step(0.05)
    assert session.inertia("joint6") > alone + 0.04
    certifier = session.certifier
    assert certifier is not None
    shown = certifier.plane(session.config.joints[-1], session.config)
    assert 'id="dp-inertia"' in markup.plane(shown, "joint7", now=0.5)
    assert 'id="dp-inertia"' not in markup.plane(shown, "joint7", now=1e9)


def test_an_axis_never_shrinks_below_what_its_numbers_can_tell() -> None:
    for _, _, _, least in CHARTS:
        assert least >= 0.01  # a fifth of it still has its three decimals
        for lines in (np.full((2, 50), 3.0), np.random.default_rng(0).normal(size=(2, 50))):
            line = least_span(lines, least)
            assert np.ptp(line) == pytest.approx(max(least, np.ptp(lines)))
            assert line.min() <= lines.min() + 1e-12
            assert line.max() >= lines.max() - 1e-12


def test_a_payload_from_the_command_line_is_bounded_too() -> None:
    with pytest.raises(InputError, match="0 to 20 kg"):
        Session("k807", "k807-wrist", payload=Payload(50.0), certify=False)
