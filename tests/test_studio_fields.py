"""Fields of the studio between a user's hand and what is set elsewhere, without a browser."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")

from dashpot.errors import DashpotError
from dashpot.studio.choices import POUND
from dashpot.studio.panels import shared
from dashpot.studio.panels.shared import Beside, LogField, NumberField, Settled


class Handle:
    """A field of viser's."""

    def __init__(self, value: Any) -> None:
        self.value, self.disabled, self._heard = value, False, []

    def on_update(self, heard: Any) -> None:
        self._heard.append(heard)

    def by_user(self, value: Any) -> None:
        self.value = value
        for heard in self._heard:
            heard(SimpleNamespace(client=object(), target=self))


class Gui:
    def __init__(self) -> None:
        self.added: list[Handle] = []

    def add_text(self, label: str, initial_value: Any, **options: Any) -> Any:
        self.added.append(Handle(initial_value))
        return self.added[-1]

    def add_slider(self, label: str, *, initial_value: float, **options: Any) -> Any:
        return self.add_text(label, initial_value)

    def add_html(self, content: str) -> Any:
        return SimpleNamespace(content=content)


def test_a_number_counts_once_it_is_typed() -> None:
    """500 Hz is never 5 Hz on its way."""
    seen: list[float] = []
    typed = Settled(seen.append, wait=0.5)
    for value in (5.0, 50.0, 500.0):
        typed(value)
        time.sleep(0.01)
    assert seen == []
    time.sleep(1.0)
    assert seen == [500.0]


def test_what_is_refused_stays_until_something_else_is_set() -> None:
    field, _, _ = number()
    field.handle.by_user("-3")
    for _ in range(3):
        field.show(3.0)
    assert field.handle.value == "-3"
    field.show(4.0)
    assert field.handle.value == "4"
    field.handle.by_user("-3")
    field.show(4.0, "joint2")  # the same number of another joint
    assert field.handle.value == "4"


@pytest.mark.parametrize(
    ("typed", "rule"),
    [
        ("1e9", "mass [lb] = 1e9: must be 0 to 44.09"),
        ("-1", "mass [lb] = -1: must be 0 to 44.09"),
        ("1x", "mass [lb] = 1x: must be 0 to 44.09"),
        ("nan", "mass [lb] = nan: must be 0 to 44.09"),
        ("", "mass [lb]: must be 0 to 44.09"),
    ],
)
def test_what_cannot_be_taken_is_said_in_the_unit_of_the_field(typed: str, rule: str) -> None:
    field, said, taken = number()
    field.handle.by_user(typed)
    until(lambda: rule in said())
    assert taken == []
    assert field.handle.value == typed
    with pytest.raises(DashpotError, match=r"must be 0 to 44\.09"):
        field.read()
    field.handle.by_user("1.5e1")
    until(lambda: taken)
    assert taken == [15.0]
    assert said() == ""


def number() -> tuple[NumberField, Any, list[float]]:
    """A field, what is said beside it, and what it has taken."""
    gui, taken = Gui(), []
    beside = Beside(gui)  # type: ignore[arg-type]
    field = NumberField(gui, "mass [lb]", 3.0, taken.append, beside, low=0.0, high=20 / POUND)  # type: ignore[arg-type]
    return field, lambda: beside._place.content, taken


def until(what: Any) -> None:
    end = time.monotonic() + 10.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_an_older_value_does_not_push_the_slider_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared, "RECENT", 0.5)
    gui, taken = Gui(), []
    field = LogField(gui, "R", 0.1, 100.0, 10.0, lambda v: taken.append(v) or True, Beside(gui))  # type: ignore[arg-type,func-returns-value]
    typed, slider = gui.added
    field.show(10.0, "joint1")
    slider.by_user(0.0)
    field.show(10.0, "joint1")  # read before the slider moved
    assert taken == [1.0]
    assert (typed.value, slider.value) == ("1", 0.0)
    time.sleep(0.6)
    field.show(10.0, "joint1")  # set elsewhere
    assert typed.value == "10"
    assert slider.value == pytest.approx(1.0, abs=0.01)


def test_a_refused_slider_goes_back() -> None:
    gui = Gui()
    field = LogField(gui, "R", 0.1, 100.0, 10.0, lambda value: False, Beside(gui))  # type: ignore[arg-type]
    typed, slider = gui.added
    field.show(10.0, "joint1")
    slider.by_user(0.0)
    assert slider.value == pytest.approx(1.0, abs=0.01)
    assert typed.value == "10"
