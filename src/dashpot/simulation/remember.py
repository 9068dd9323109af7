"""Results that are computed once for several scenarios."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

T = TypeVar("T")


class Remembered:
    """The last few results, by the objects they follow from, which must not be changed, and by values."""

    def __init__(self, size: int = 64) -> None:
        """Keeps so many results, and the objects they follow from."""
        self._size, self._lock = size, Lock()
        self._kept: OrderedDict[Hashable, tuple[tuple[object, ...], Any]] = OrderedDict()

    def of(self, objects: tuple[object, ...], values: Hashable, make: Callable[[], T]) -> T:
        """What `make` gives: computed, or remembered for the very same objects and equal values."""
        key = (tuple(map(id, objects)), values)  # ids stay theirs: the objects are kept
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][1]  # type: ignore[no-any-return]
        made = make()
        with self._lock:
            self._kept[key] = objects, made
            while len(self._kept) > self._size:
                self._kept.popitem(last=False)
        return made
