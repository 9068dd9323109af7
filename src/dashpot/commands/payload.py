"""The payload that is typed: ``--payload`` and ``--offset``."""

from __future__ import annotations

import warnings

from dashpot.arm.payload import Payload
from dashpot.commands.shared import of_flags
from dashpot.errors import InputError, InputWarning


def payload_offset(values: tuple[float, ...]) -> float | tuple[float, float, float]:
    """What follows ``--offset``, as `Payload` takes it [m].

    Raises:
        InputError: Neither one number nor three.
    """
    match values:
        case (x,):
            return x
        case (x, y, z):
            return x, y, z
    raise InputError("must be one number or three", quantity="--offset [m]", value=values)


def payload_of(mass: float, offset: tuple[float, ...], flag: str = "--payload") -> Payload:
    """The payload of ``--payload`` and ``--offset``.

    Raises:
        InputError: It cannot be; names the flag.

    Warns:
        InputWarning: The mass is unusual; likewise.
    """
    place = payload_offset(offset)
    names = {"mass [kg]": f"{flag} [kg]", "payload offset [m]": "--offset [m]"}
    with warnings.catch_warnings(record=True) as caught, of_flags(names):
        warnings.simplefilter("always", InputWarning)
        payload = Payload(mass, place)
    for warning in caught:
        text = str(warning.message).replace("mass [kg]", names["mass [kg]"], 1)
        warnings.warn(text, InputWarning, stacklevel=2)
    return payload
