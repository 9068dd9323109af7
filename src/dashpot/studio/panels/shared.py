"""What the panels share: fields on a log scale, and errors said beside the field they belong to."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import viser

from dashpot.errors import DashpotError
from dashpot.studio.markup import trouble

STEPS = 200  # of a log slider per range
STYLE = """<style>
.mantine-Slider-root + .mantine-InputWrapper-root, .mantine-Slider-root + .mantine-NumberInput-root
{display:none} *:focus-visible {outline:2px solid #0072B2 !important; outline-offset:1px}
</style>"""
"""Sliders without viser's own number box, whose number would be a logarithm; and a focus that is seen."""


class Beside:
    """A place for messages beside fields."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._place = gui.add_html("")

    @contextmanager
    def explained(self) -> Iterator[None]:
        """Says what is wrong where an error is the user's; clears it where nothing is."""
        try:
            yield
        except (DashpotError, OSError) as error:
            self.say(str(error))
        else:
            self.say("")

    def say(self, text: str) -> None:
        """Shows a message, or none."""
        if self._place.content != trouble(text):
            self._place.content = trouble(text)


class LogField:
    """A number with a slider over its logarithm below it: type it, drag it, or step it with the arrow keys.

    Attributes:
        low, high: Ends of the slider; more can be typed.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        low: float,
        high: float,
        value: float,
        changed: Callable[[float], None],
        *,
        zero: bool = False,
        hint: str = "",
    ) -> None:
        """Adds the two.

        Args:
            gui: Where.
            label: With the unit in brackets.
            low: Positive.
            high: Above it.
            value: To begin with.
            changed: Called with what the user has set, in order of time.
            zero: Whether the slider's left end means 0.
            hint: Shown when pointed at.
        """
        self.low, self.high, self._zero, self._changed = low, high, zero, changed
        self._lock = threading.RLock()
        self._number: Any = gui.add_number(label, initial_value=float(value), step=0.001, hint=hint or None)
        decades = [10.0**k for k in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)]
        while len(decades) > 5:
            decades = decades[::2]
        marks = [(math.log10(v), f"{v:g}") for v in decades]
        if zero:
            marks = [(math.log10(low), "0"), *(m for m in marks if m[0] > math.log10(low) + 0.3)]
        ends = math.log10(low), math.log10(high)
        self._slider: Any = gui.add_slider(
            "",
            min=ends[0],
            max=ends[1],
            step=(ends[1] - ends[0]) / STEPS,
            initial_value=self._place(value),
            marks=tuple(marks),
        )
        self._slider.on_update(self._slid)
        self._number.on_update(self._typed)

    @property
    def value(self) -> float:
        """The number."""
        return float(self._number.value)

    def show(self, value: float) -> None:
        """Shows a number that was set elsewhere."""
        with self._lock:
            if value != self._number.value:
                self._number.value = float(value)
            if abs(self._place(value) - self._slider.value) > 1e-9:
                self._slider.value = self._place(value)

    def enable(self, on: bool) -> None:
        """Whether it can be used."""
        if self._number.disabled == on:
            self._number.disabled = self._slider.disabled = not on

    def _place(self, value: float) -> float:
        ends = math.log10(self.low), math.log10(self.high)
        if value <= 0 or not math.isfinite(value):
            return ends[0]
        step = (ends[1] - ends[0]) / STEPS
        place = ends[0] + step * round((math.log10(value) - ends[0]) / step)
        return min(max(place, ends[0]), ends[1])

    def _slid(self, event: Any) -> None:
        if event.client is None:  # set by us
            return
        with self._lock:
            place = float(self._slider.value)
            value = float(f"{10**place:.3g}")
            if self._zero and place <= math.log10(self.low) + 1e-9:
                value = 0.0
            self._number.value = value
            self._changed(value)

    def _typed(self, event: Any) -> None:
        if event.client is None:
            return
        with self._lock:
            value = float(self._number.value)
            self._slider.value = self._place(value)
            self._changed(value)


def by_hand(handle: Any, act: Callable[[Any], None]) -> None:
    """Calls a function with a field's value when a user, not the program, has changed it."""

    def changed(event: Any) -> None:
        if event.client is not None:
            act(event.target.value)

    handle.on_update(changed)


def set_quietly(handle: Any, value: Any) -> None:
    """Shows a value that was set elsewhere; nothing is sent where it is there already."""
    if handle.value != value:
        with suppress(ValueError):
            handle.value = value
