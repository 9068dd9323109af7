"""The quantities of a design in words: names, units for people, and what they mean."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dashpot.design.design import JointDesign
from dashpot.design.search import SAME
from dashpot.design.wishes import AT_LEAST, UNITS
from dashpot.support.numbers import significant

GAINS = {"R": "-", "D": "N m s/rad", "K": "N m/rad", "kp": "N m/rad", "kd": "N m s/rad"}
"""Units of the gains."""
DEGREES = 180 / math.pi


@dataclass(frozen=True)
class Quantity:
    """How one quantity is shown.

    Attributes:
        label: Its name in a sentence.
        head: Above a column.
        unit: In which people read it.
        factor: From SI to it.
        meaning: What it is and how it is computed.
    """

    label: str
    head: str
    unit: str
    factor: float
    meaning: str

    def shown(self, value: float) -> str:
        """A value without its unit; "-" where there is none."""
        return significant(value * self.factor)

    def text(self, value: float) -> str:
        """A value with its unit."""
        return f"{self.shown(value)} {self.unit}".rstrip()


QUANTITIES = {
    "stop_time": Quantity(
        "stop time",
        "stop",
        "ms",
        1e3,
        "Time from losing the encoder until the loaded link stays below the residual speed. Two times stand "
        "where it hangs on a swing that nearly reaches that speed. The brake starts with the last speed "
        "known; friction counts, gravity does not.",
    ),
    "travel": Quantity(
        "travel",
        "travel",
        "deg",
        DEGREES,
        "How far the loaded link gets in the 5 s after its encoder is lost, the payload pulling on. It is "
        "the path of the first second, forth and back, and four seconds of creep.",
    ),
    "hold": Quantity(
        "hold",
        "holds",
        "N m",
        1.0,
        "Largest load that the released joint's friction holds, (1 + g) tau_c. Torque feedback makes the "
        "joint 1 + g times as rough: g = R a/D with a = R v + D, or g = R where K > 0.",
    ),
    "creep": Quantity(
        "creep",
        "creep",
        "deg/s",
        DEGREES,
        "Speed at which the payload moves the released joint in the long run, (tau_g/(1 + g) - tau_c)/v. It "
        "is zero where friction holds the load.",
    ),
    "load_error": Quantity(
        "load error",
        "error",
        "deg",
        DEGREES,
        "Largest position error of the rotor at rest under the payload, with the position loop, friction "
        "holding it on the wrong side: (tau_g + (1 + g) tau_c)/(g kp).",
    ),
    "error_ratio": Quantity(
        "error ratio",
        "ratio",
        "",
        1.0,
        "How far the load moves the joint, over how far it would with the same position loop and no torque "
        "feedback, 1/g. At 0.2 the joint yields a fifth as much.",
    ),
    "noise": Quantity(
        "noise",
        "noise",
        "% of limit",
        100.0,
        "RMS of the torque command that comes from noise of the torque sensor and from the steps of the "
        "encoder, over the torque limit. White noise is assumed, and the joint's own answer to it left out.",
    ),
    "authority": Quantity(
        "authority",
        "authority",
        "% of limit",
        100.0,
        "Largest share of the torque limit that is asked for. The largest of: first torque of a stop, (R v + "
        "D) times the speed; answer of kp to a position error and of kd to a speed error; the load itself.",
    ),
    "damping_ratio": Quantity(
        "damping ratio",
        "damping",
        "",
        1.0,
        "Least damping ratio of the slow modes of the position loop, with and without payload, on a stiff "
        "transmission. 1 and more, or no entry, means that it settles without swinging.",
    ),
    "margin": Quantity(
        "margin",
        "margin",
        "",
        1.0,
        "Least passivity index over the whole box of the drive's uncertainty, with the position loop and as "
        "brake, over the index of the drive alone. Zero is the edge of the certificate.",
    ),
}


def predicted_text(joint: JointDesign, name: str) -> str:
    """A prediction without its unit; two stop times where a swing decides between them."""
    quantity, value = QUANTITIES[name], joint.predicted[name]
    if name == "stop_time" and joint.stop_late > SAME * value:
        return f"{quantity.shown(value)} or {quantity.shown(joint.stop_late)}"
    return quantity.shown(value)


def limit_text(name: str, value: float) -> str:
    """A limit as a rule, in the units of people and of files: ``travel at most 2 deg (0.0349 rad)``."""
    quantity = QUANTITIES[name]
    sense = "at least" if name in AT_LEAST else "at most"
    return f"{quantity.label} {sense} {value * quantity.factor:.3g} {quantity.unit}".rstrip() + in_si(
        name, value
    )


def in_si(name: str, value: float) -> str:
    """The same value as it stands in a specification, in brackets, where people read it in degrees."""
    return f" ({value:.3g} {UNITS[name]})" if QUANTITIES[name].factor == DEGREES and value else ""


def binding_text(name: str, limits: dict[str, float], margin: float) -> str:
    """What refuses better gains, shortly: ``authority 90 % of limit``."""
    if name == "certificate":
        return f"certificate (margin {margin:g})"
    quantity = QUANTITIES[name]
    return f"{quantity.label} {limits[name] * quantity.factor:.3g} {quantity.unit}".rstrip()
