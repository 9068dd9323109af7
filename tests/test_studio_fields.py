"""Fields of the studio between a user's hand and what is set elsewhere, without a browser."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")

from dashpot.studio.panels import shared
from dashpot.studio.panels.shared import LogField, NumberField, Settled


class Handle:
    """A field of viser's."""

    def __init__(self, value: float) -> None:
        self.value, self.disabled, self._heard = value, False, []

    def on_update(self, heard: Any) -> None:
        self._heard.append(heard)

    def by_user(self, value: float) -> None:
        self.value = value
        for heard in self._heard:
            heard(SimpleNamespace(client=object(), target=self))


class Gui:
    def __init__(self) -> None:
        self.added: list[Handle] = []

    def add_number(self, label: str, initial_value: float, **options: Any) -> Handle:
        self.added.append(Handle(initial_value))
        return self.added[-1]

    def add_slider(self, label: str, *, initial_value: float, **options: Any) -> Handle:
        return self.add_number(label, initial_value)


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
    gui = Gui()
    field = NumberField(gui, "R", 3.0, lambda value: None)  # type: ignore[arg-type]
    field.handle.by_user(-3.0)
    for _ in range(3):
        field.show(3.0)
    assert field.handle.value == -3.0
    field.show(4.0)
    assert field.handle.value == 4.0
    field.handle.by_user(-3.0)
    field.show(4.0, "joint2")  # the same number of another joint
    assert field.handle.value == 4.0


def test_an_older_value_does_not_push_the_slider_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared, "RECENT", 0.5)
    gui, taken = Gui(), []
    field = LogField(gui, "R", 0.1, 100.0, 10.0, lambda v: taken.append(v) or True)  # type: ignore[arg-type,func-returns-value]
    number, slider = gui.added
    field.show(10.0, "joint1")
    slider.by_user(0.0)
    field.show(10.0, "joint1")  # read before the slider moved
    assert taken == [1.0]
    assert (number.value, slider.value) == (1.0, 0.0)
    time.sleep(0.6)
    field.show(10.0, "joint1")  # set elsewhere
    assert number.value == 10.0
    assert slider.value == pytest.approx(1.0, abs=0.01)


def test_a_refused_slider_goes_back() -> None:
    gui = Gui()
    field = LogField(gui, "R", 0.1, 100.0, 10.0, lambda value: False)  # type: ignore[arg-type]
    number, slider = gui.added
    field.show(10.0, "joint1")
    slider.by_user(0.0)
    assert slider.value == pytest.approx(1.0, abs=0.01)
    assert number.value == 10.0
