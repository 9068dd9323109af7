"""Drives: ranges and units of every quantity, from a table and in Python."""

from __future__ import annotations

import dataclasses
import math
import warnings

import pytest

from dashpot.arm.drive import UNCERTAIN, Drive, InnerLoop, Servo
from dashpot.errors import InputError, InputWarning, written
from dashpot.support.tables import Range

GOOD = {"name": "j1", "rotor_inertia": 0.2, "viscous_friction": 0.5, "stiffness": 1e4, "torque_limit": 40.0}
NUMBERS = [(f.name, f.metadata["range"]) for f in dataclasses.fields(Drive) if "range" in f.metadata]


def load(**changes):
    return Drive.from_table({**GOOD, **changes}, file="arm.toml")


def test_from_table_and_in_python_are_the_same():
    assert load() == Drive(**GOOD)
    full = load(
        inner_loop={"gain": 3, "period": 1e-4}, servo={"kp": 1, "kd": 2}, uncertainty={"damping": 0.5}
    )
    assert full.inner_loop == InnerLoop(gain=3, period=1e-4)
    assert full.inner_loop.bandwidth == math.inf
    assert full.servo == Servo(kp=1, kd=2, ki=0)
    assert full.uncertainty == {"damping": 0.5}
    assert load(torque_rate_limit=math.inf) == load()
    assert isinstance(load(stiffness=10_000).stiffness, float)


@pytest.mark.parametrize("key", sorted(GOOD.keys() - {"name"}))
def test_missing_key(key):
    table = {k: v for k, v in GOOD.items() if k != key}
    with pytest.raises(InputError, match=rf"^arm.toml: joint 'j1': missing key: {key}$"):
        Drive.from_table(table, file="arm.toml")


@pytest.mark.parametrize("name", [..., "", 3, ["j1"], True])
def test_name_is_needed(name):
    table = {k: v for k, v in {**GOOD, "name": name}.items() if v is not ...}
    with pytest.raises(InputError, match=r"^arm.toml: name: every \[\[joint\]\] needs a name"):
        Drive.from_table(table, file="arm.toml")


@pytest.mark.parametrize(("key", "limits"), NUMBERS)
def test_every_number_is_checked(key, limits):
    bad = ["1", [1.0], {"a": 1}, True, math.nan, -math.inf, math.inf, 10**400]
    bad += [limits.low - 1.0, limits.low if limits.open_low else limits.low - 1e-6, limits.high * 1.001 + 1]
    for value in bad:
        if isinstance(value, float | int) and value == math.inf == limits.high:
            continue
        if value == 10**400 and math.isinf(limits.high):
            continue
        for build, file in ((load, "arm.toml: "), (lambda **c: Drive(**{**GOOD, **c}), "")):
            with pytest.raises(InputError) as caught:
                build(**{key: value})
            message = str(caught.value)
            assert message.startswith(f"{file}joint 'j1': {key} [{limits.unit}] = ")
            assert "must be" in message or "must not be" in message
            assert message.isprintable()


@pytest.mark.parametrize(("key", "limits"), [(k, r) for k, r in NUMBERS if r.typical])
def test_wrong_unit_warns_or_is_refused_once(key, limits):
    for value in (limits.typical[0] / 1000.0, limits.typical[1] * 1000.0):
        said = []
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                load(**{key: value})
            except InputError as error:
                said = [str(error)]
        legal = limits.low <= value <= limits.high
        assert [w.category for w in caught] == [InputWarning] * legal
        (message,) = said or [str(w.message) for w in caught]
        assert ("check the unit" in message) == legal
        assert message.startswith(f"arm.toml: joint 'j1': {key} [{limits.unit}] = {written(value)}: ")
        assert limits.unit in message.split(": ", 3)[3]


def test_known_mistakes_of_units():
    with pytest.raises(InputError, match="rotor_inertia"):
        load(rotor_inertia=2000.0)  # kg cm^2
    with pytest.warns(InputWarning, match="stiffness"):
        load(stiffness=1e4 * 1e3)  # N mm/rad
    with pytest.raises(
        InputError, match=r"position_resolution \[rad\] = 0.35: must be at least 0 and at most 0.1 rad"
    ):
        load(position_resolution=0.35)  # degrees
    with pytest.raises(InputError, match="torque_gain_error"):
        load(torque_gain_error=1.0)  # per cent
    with pytest.raises(InputError, match="torque_latency"):
        load(torque_latency=2.0)  # milliseconds


def test_misspelt_key():
    with pytest.raises(
        InputError, match=r"^arm.toml: joint 'j1': stifness: unknown key; did you mean 'stiffness'\?$"
    ):
        load(stifness=1.0)
    with pytest.raises(InputError, match=r"joint 'j1.servo': kP: unknown key; did you mean"):
        load(servo={"kP": 1, "kd": 1})


@pytest.mark.parametrize("key", ["inner_loop", "servo", "uncertainty"])
@pytest.mark.parametrize("value", [1.0, "x", [1], True])
def test_sub_tables_must_be_tables(key, value):
    with pytest.raises(InputError, match=rf"^arm.toml: joint 'j1': {key} = .*must be a table"):
        load(**{key: value})


def test_sub_tables_are_checked():
    with pytest.raises(InputError, match=r"^arm.toml: joint 'j1.inner_loop': missing key: period$"):
        load(inner_loop={"gain": 3.0})
    with pytest.raises(InputError, match=r"^arm.toml: joint 'j1.servo': kp \[N m/rad\] = -1.0: must be"):
        load(servo={"kp": -1, "kd": 1})
    with pytest.raises(InputError, match=r"^kd \[N m s/rad\] = nan: must be finite"):
        Servo(kp=1.0, kd=math.nan)
    with pytest.raises(InputError, match=r"^period \[s\] = 0.0: must be"):
        InnerLoop(gain=1.0, period=0.0)


@pytest.mark.parametrize("value", [-0.1, 1.0, 15, math.nan, math.inf, "0.1", True, [0.1], {}, 10**400])
def test_uncertainty_is_relative(value):
    for key in UNCERTAIN:
        with pytest.raises(InputError, match=rf"joint 'j1': uncertainty.{key} = .*\(0.15 means 15 %\)$"):
            load(uncertainty={key: value})
    with pytest.raises(InputError, match="joint 'j1': stifness: unknown key; did you mean 'stiffness'"):
        load(uncertainty={"stifness": 0.1})


@pytest.mark.parametrize("value", [0, 3, -1, 1.0, 2.5, math.nan, True, False, "2", [2], {}, 10**400])
def test_sensor_order_is_one_or_two(value):
    for build, file in ((load, "arm.toml: "), (lambda **c: Drive(**{**GOOD, **c}), "")):
        with pytest.raises(InputError) as caught:
            build(sensor_order=value)
        assert str(caught.value).startswith(f"{file}joint 'j1': sensor_order = ")
        assert str(caught.value).endswith(": must be 1 or 2")
    assert [load(sensor_order=order).sensor_order for order in (1, 2)] == [1, 2]
    assert load().sensor_order == 2


@pytest.mark.parametrize("key", ["link_inertia", "link_friction"])
def test_what_is_vouched_for_of_the_link_is_not_negative(key):
    with pytest.raises(
        InputError, match=rf"^arm.toml: joint 'j1': {key} \[.*\] = -0.001: must be at least 0"
    ):
        load(**{key: -1e-3})
    assert getattr(load(), key) == 0
    assert getattr(load(**{key: 2}), key) == 2.0


def test_rules_in_words():
    assert Range("s", 0, math.inf).rule == "must not be negative"
    assert Range("s", 0, math.inf, open_low=True).rule == "must be positive"
    assert Range("s", 0, 2, open_low=True).rule == "must be above 0 and at most 2"
    assert Range("s", 1, 2).rule == "must be at least 1 and at most 2"
