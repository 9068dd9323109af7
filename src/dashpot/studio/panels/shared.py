"""What the panels share: fields on a log scale, and errors said beside the field they belong to."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import viser

from dashpot.errors import DashpotError
from dashpot.studio.markup import remark, trouble

RECENT = 1.0  # [s] for which a field is in the user's hand after a change
STEPS = 200  # of a log slider per range
TYPING = 0.6  # [s] after the last key that a number counts as typed


class Beside:
    """A place for messages beside fields.

    Attributes:
        failed: Whether the last thing that was tried went wrong.
    """

    def __init__(self, gui: viser.GuiApi, *, put: bool = True) -> None:
        """Puts the place here, or where `put` is called."""
        self._gui, self.failed = gui, False
        if put:
            self.put()

    def put(self) -> None:
        """Puts the place below what has been added by now."""
        self._place = self._gui.add_html("")

    @contextmanager
    def explained(self) -> Iterator[None]:
        """Says what is wrong where an error is the user's; clears it where nothing is."""
        self.failed = False
        try:
            yield
        except (DashpotError, OSError) as error:
            self.failed = True
            self.say(str(error))
        else:
            self.say("")

    def say(self, text: str) -> None:
        """Shows what is wrong, or nothing."""
        self._show(trouble(text))

    def remark(self, text: str) -> None:
        """Shows what is to be known of something that was taken."""
        self._show(remark(text))

    def _show(self, content: str) -> None:
        if self._place.content != content:
            self._place.content = content


class Settled:
    """Calls a function with the last of several values, once no newer one has come for a while.

    A number that is typed is on its way: 500 Hz begins as 5 Hz.
    """

    def __init__(self, act: Callable[[Any], object], wait: float = TYPING) -> None:
        """Calls `act` after `wait` [s]."""
        self._act, self._wait = act, wait
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()

    def __call__(self, value: Any) -> None:
        """Takes a value."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = threading.Timer(self._wait, self._act, (value,))
            self._timer.daemon = True
            self._timer.start()

    def forget(self) -> None:
        """Takes back what has not been called yet."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()


class NumberField:
    """A number to be typed. What is refused stays there to be mended; what is set elsewhere is shown.

    It is a field of text: a browser's field of numbers drops what it cannot read, and 1e9 becomes 19.

    Attributes:
        handle: viser's.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        value: float,
        changed: Callable[[float], object],
        beside: Beside,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        hint: str | None = None,
    ) -> None:
        """Adds it.

        Args:
            gui: Where.
            label: With the unit in brackets.
            value: To begin with.
            changed: Called with what the user has typed, if it is a number in range.
            beside: Where to say that it is not.
            low: Least valid value, in the field's unit.
            high: Largest.
            hint: Shown when pointed at.
        """
        self.handle: Any = gui.add_text(label, initial_value=_text(value), hint=hint)
        self._label, self._beside, self._changed = label, beside, changed
        self._low, self._high = low, high
        self._settled = Settled(lambda _: self._typed())
        self._shown: tuple[float, str] = (value, "")
        by_hand(self.handle, self._settled)

    def read(self) -> float:
        """What stands there.

        Raises:
            DashpotError: It is no number, or out of range.
        """
        text = str(self.handle.value).strip()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value) and self._low <= value <= self._high:
            return value
        rule = "must be a number"
        if math.isfinite(self._low) and math.isfinite(self._high):
            rule = f"must be {self._low:.4g} to {self._high:.4g}"
        elif math.isfinite(self._low):
            rule = f"must be at least {self._low:.4g}"
        raise DashpotError(f"{self._label} = {text}: {rule}" if text else f"{self._label}: {rule}")

    def show(self, value: float, of: str = "") -> None:
        """Shows a number if it is another than the last one, or of something else."""
        if (value, of) != self._shown:
            self._shown = value, of
            self._settled.forget()
            with suppress(ValueError):
                if float(self.handle.value) == value:
                    return
            self.handle.value = _text(value)

    def _typed(self) -> None:
        with self._beside.explained():
            value = self.read()
        if self._beside.failed:
            return
        self._changed(value)
        if not self._beside.failed:  # nothing new to be shown, and what is typed next stays
            self._shown = value, self._shown[1]


def _text(value: float) -> str:
    return f"{value:.6g}"


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
        changed: Callable[[float], bool],
        beside: Beside,
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
            changed: Called with what the user has set, in order of time; says whether it was taken.
            beside: Where to say what cannot be read.
            zero: Whether the slider's left end means 0.
            hint: Shown when pointed at.
        """
        self.low, self.high, self._zero, self._changed = low, high, zero, changed
        self._lock = threading.RLock()
        self._value, self._of = float(value), ""
        self._number = NumberField(gui, label, float(value), self._typed, beside, hint=hint or None)
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
        by_hand(self._slider, self._slid)

    def show(self, value: float, of: str = "") -> None:
        """Shows a number that was set elsewhere; `of` says whose it is."""
        with self._lock:
            self._value = float(value)
            if of == self._of and in_hand(self._slider):
                return
            self._of = of
            self._number.show(self._value, of)
            if abs(self._place(value) - self._slider.value) > 1e-9:
                self._slider.value = self._place(value)

    def enable(self, on: bool) -> None:
        """Whether it can be used."""
        if self._number.handle.disabled == on:
            self._number.handle.disabled = self._slider.disabled = not on

    def _place(self, value: float) -> float:
        ends = math.log10(self.low), math.log10(self.high)
        if value <= 0 or not math.isfinite(value):
            return ends[0]
        step = (ends[1] - ends[0]) / STEPS
        place = ends[0] + step * round((math.log10(value) - ends[0]) / step)
        return min(max(place, ends[0]), ends[1])

    def _slid(self, place: float) -> None:
        with self._lock:
            value = float(f"{10**place:.3g}")
            if self._zero and place <= math.log10(self.low) + 1e-9:
                value = 0.0
            if self._changed(value):
                self._value = value
                self._number.show(value, self._of)
            else:  # back to where it was
                self._slider.value = self._place(self._value)

    def _typed(self, value: float) -> None:
        with self._lock:
            if self._changed(float(value)):
                self._slider.value = self._place(value)


_touched: dict[int, float] = {}  # id of a handle -> when; handles have no hash, and live as long as a page


def by_hand(handle: Any, act: Callable[[Any], None]) -> None:
    """Calls a function with a field's newest value when a user, not the program, has changed it."""
    lock = threading.Lock()  # viser calls from many threads: the newest value has to be the last one

    def changed(event: Any) -> None:
        if event.client is not None:
            _touched[id(handle)] = time.monotonic()
            with lock:
                act(handle.value)

    handle.on_update(changed)


def in_hand(handle: Any) -> bool:
    """Whether a user has changed a field just now: an older value must not push it back."""
    return time.monotonic() - _touched.get(id(handle), -math.inf) < RECENT


def set_quietly(handle: Any, value: Any) -> None:
    """Shows a value that was set elsewhere; nothing is sent where it is there already."""
    if handle.value != value and not in_hand(handle):
        with suppress(ValueError):
            handle.value = value
