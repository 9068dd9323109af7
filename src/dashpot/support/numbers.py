"""Numbers as people read them."""

from __future__ import annotations

import math


def significant(value: float, digits: int = 3) -> str:
    """A number for people: three digits, no exponent between 1e-4 and 1e6; "-": none."""
    if not math.isfinite(value):
        return "-"
    if abs(value) < 1e-9:  # rounding
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(places, 6)}f}"
