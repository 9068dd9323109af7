"""The native controller core: against a reference in Python, its limits, its faults, and from plain C."""

from __future__ import annotations

import math
import subprocess
from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot import _native
from dashpot.arm.records import DRIVE_DTYPE
from dashpot.control.controller import BLENDING, NOT_FINITE, RATE_LIMITED, TORQUE_LIMITED, Controller
from dashpot.control.sampled import (
    BLOCK_DTYPE,
    NW,
    VirtualPassive,
    add_position_loop,
    empty_block,
    pd_block,
    virtual_passive_block,
)
from dashpot.errors import InputError
from dashpot.simulation.prepare import EVENT_DTYPE

NATIVE = Path(__file__).parent.parent / "native"
H = 1e-3
LAW = VirtualPassive(R=8.0, D=6.0, K=0.0, m=0.2, v=1.0)
SPRUNG = VirtualPassive(R=8.0, D=6.0, K=3.0, m=0.2, v=1.0)
seeds = st.integers(0, 2**32 - 1)
awkward = st.floats() | st.sampled_from([1e300, -1e300, 1.7e308, math.inf, -math.inf, math.nan, 5e-324, 0.0])


def controller(*blocks):
    return Controller(np.array(blocks), [f"j{i}" for i in range(len(blocks))], H)


def make(law=LAW, form="implicit", kp=0.0, kd=0.0, **values):
    block = add_position_loop(virtual_passive_block(law, H, form), kp, kd)
    for key, value in values.items():
        block[key] = value
    return block


def run(c, torque):
    """Commands for a sequence of torques (ticks,) or (ticks, n), other inputs as they are."""
    out, rows = np.zeros(len(c.joints)), []
    for row in torque:
        c.inputs.torque[:] = row
        c.step(out)
        rows.append(out.copy())
    return np.array(rows)


def random_block(rng):
    block = empty_block()
    for key in ("A", "B", "C", "D", "E", "bypass", "warm"):
        block[key] = rng.normal(size=block[key].shape) * 0.4
    for key in ("torque_limit", "rate_limit"):
        block[key] = rng.choice([np.inf, rng.uniform(0.2, 3)])
    block["blend"] = rng.choice([0.0, rng.uniform(0, 0.99)])
    block["nx"], block["latency"] = rng.integers(5), rng.integers(17)
    return block


def clip(x, limit):
    return limit if x > limit else -limit if x < -limit else x


class Reference:
    """One joint of the core in plain Python; sums in the same order, so equal to the last bit."""

    def __init__(self, block):
        self.b = {key: block[key].tolist() for key in BLOCK_DTYPE.names}
        self.x, self.offset, self.mode, self.loop, self.changed = [0.0] * 4, 0.0, 2, True, False
        self.sent = deque([0.0] * (self.b["latency"] + 1), self.b["latency"] + 1)  # oldest: in effect

    def set_mode(self, mode):
        if mode != self.mode:
            self.mode, self.changed, self.x = mode, True, [0.0] * 4

    def dot(self, a, b, n=NW):
        """Summed as a tree, as the core does."""
        terms = [a[i] * b[i] if i < n else 0.0 for i in range(NW if n == NW else 4)]
        while len(terms) > 1:
            terms = [p + q for p, q in zip(terms[::2], terms[1::2], strict=True)]
        return terms[0]

    def output(self, w):
        if self.mode == 2:
            return self.dot(self.b["C"], self.x, self.b["nx"]) + self.dot(self.b["D"], w)
        return self.dot(self.b["bypass"], w) if self.mode == 1 else 0.0

    def step(self, inputs):
        b, n = self.b, self.b["nx"] if self.mode == 2 else 0
        w = [inputs[0], self.sent[0], *(inputs[1:] if self.loop else [0.0] * 6)]
        u = self.output(w)
        if not math.isfinite(u):
            used = {0: lambda i: False, 1: lambda i: b["bypass"][i] != 0, 2: self.uses}[self.mode]
            w = [x if math.isfinite(x) or used(i) else 0.0 for i, x in enumerate(w)]
            u = self.output(w)
        last, status = self.sent[-1], 0
        if not math.isfinite(u):
            self.sent.append(last)
            return last, NOT_FINITE
        offset = last - u if self.changed and b["blend"] > 0 else self.offset * b["blend"]
        offset = 0.0 if abs(offset) < 1e-9 else offset
        status |= BLENDING * (offset != 0)
        wanted = u + offset
        issued = clip(wanted, b["torque_limit"])
        status |= TORQUE_LIMITED * (issued != wanted)
        if abs(issued - last) > b["rate_limit"]:
            issued, status = last + clip(issued - last, b["rate_limit"]), status | RATE_LIMITED
        x = [
            self.dot(b["A"][i], self.x, n) + self.dot(b["B"][i], w) + b["E"][i] * (issued - u)
            for i in range(n)
        ]
        if not all(map(math.isfinite, [issued, *x])):
            self.sent.append(last)
            return last, NOT_FINITE
        self.x[:n], self.offset, self.changed = x, offset, False
        self.sent.append(issued)
        return issued, status

    def uses(self, i):
        return self.b["D"][i] != 0 or any(row[i] != 0 for row in self.b["B"][: self.b["nx"]])


# --- against the reference -------------------------------


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_step_equals_the_reference_to_the_last_bit(seed, faults):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    blocks = [random_block(rng) for _ in range(n)]
    c, twins, out = controller(*blocks), [Reference(b) for b in blocks], np.zeros(n)
    special = [np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324, 0.0, 1.7e308]
    for _ in range(100):
        inputs = rng.normal(size=(7, n))
        if faults and rng.random() < 0.2:
            inputs[rng.integers(7), rng.integers(n)] = rng.choice(special)
        j = int(rng.integers(n))
        match rng.integers(20):
            case 0:
                mode = int(rng.integers(3))
                c.set_mode(c.joints[j], ("off", "bypass", "active")[mode])
                twins[j].set_mode(mode)
            case 1:
                twins[j].loop = not twins[j].loop
                c.set_position_loop(c.joints[j], twins[j].loop)
            case 2:
                velocity, nx = rng.normal(), twins[j].b["nx"]
                c.warm_start(c.joints[j], velocity)
                twins[j].x[:nx] = [wi * velocity for wi in twins[j].b["warm"][:nx]]
                twins[j].offset, twins[j].changed = 0.0, False
        status = c.step(inputs, out)
        expected = [twin.step(inputs[:, i].tolist()) for i, twin in enumerate(twins)]
        assert out.tolist() == [u for u, _ in expected]
        assert status == np.bitwise_or.reduce([s for _, s in expected])
        for twin, name in zip(twins, c.joints, strict=True):
            assert c.state(name)["x"] == tuple(twin.x)
            assert c.state(name)["in_effect"] == twin.sent[0]


@pytest.mark.parametrize("latency", [0, 1, 3, 16])
def test_torque_in_effect_is_the_command_of_latency_plus_one_ticks_ago(latency):
    block = empty_block()
    block["D"][0], block["latency"] = 1.0, latency
    c = controller(block)
    sent = [0.0] * (latency + 1)
    for k in range(60):
        assert c.state("j0")["in_effect"] == sent[k]
        sent.append(run(c, [k + 1.0]).item())


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_bypass_is_the_position_loop_alone(seed):
    rng = np.random.default_rng(seed)
    kp, kd = rng.uniform(0, 100, 2)
    c, alone, out, pd = controller(make(kp=kp, kd=kd)), controller(pd_block(kp, kd)), np.zeros(1), np.zeros(1)
    c.set_mode("j0", "bypass")
    for inputs in rng.normal(size=(30, 7, 1)):
        c.step(inputs, out)
        alone.step(inputs, pd)
        assert out == pd


def test_modes_are_per_joint():
    blocks = [make(kp=30.0, kd=1.0) for _ in range(3)]
    c, single, out, one = controller(*blocks), controller(blocks[0]), np.zeros(3), np.zeros(1)
    c.set_mode("j1", "bypass")
    c.set_mode("j2", "off")
    for inputs in np.random.default_rng(0).normal(size=(30, 7, 1)):
        c.step(np.repeat(inputs, 3, axis=1), out)
        single.step(inputs, one)
        assert out[0] == one[0]
        assert out[1] == pytest.approx(
            30 * (inputs[3, 0] - inputs[1, 0]) + (inputs[4, 0] - inputs[2, 0]) + inputs[6, 0]
        )
        assert out[2] == 0


def test_reset_forgets_everything_but_the_modes():
    block = make(SPRUNG, "explicit", kp=5.0, latency=3, blend=0.9, rate_limit=0.5)
    c, fresh = controller(block, block), controller(block, block)
    for k in (c, fresh):
        k.set_mode("j1", "bypass")
        k.set_position_loop("j0", False)
    rng = np.random.default_rng(1)
    run(c, rng.normal(size=(20, 2)))
    c.reset()
    fresh.reset()
    assert c.state("j0") == fresh.state("j0")
    assert (c.state("j1")["mode"], c.state("j0")["position_loop"]) == ("bypass", False)
    for k in (c, fresh):
        k.inputs.position[:] = 0.3
    torque = rng.normal(size=(50, 2))
    assert run(c, torque).tolist() == run(fresh, torque).tolist()


# --- limits ----------------------------------------------


@settings(max_examples=100, deadline=None)
@given(
    seeds,
    st.lists(st.lists(awkward, min_size=7, max_size=7), min_size=1, max_size=12),
    st.lists(st.sampled_from(["off", "bypass", "active", None]), min_size=1, max_size=5),
)
def test_torque_is_finite_and_within_its_limits_whatever_comes_in(seed, inputs, modes):
    rng = np.random.default_rng(seed)
    block = random_block(rng)
    if rng.random() < 0.5:
        block = make(SPRUNG, rng.choice(["explicit", "implicit"]), 1e4, 1e2, torque_limit=20, rate_limit=3)
    c, out, last = controller(block), np.zeros(1), 0.0
    for k, row in enumerate(inputs * 3):
        if mode := modes[k % len(modes)]:
            c.set_mode("j0", mode)
        c.step(np.array(row)[:, None], out)
        assert np.isfinite(out[0])
        assert abs(out[0]) <= block["torque_limit"]
        # one rounding of last + rate_limit
        assert abs(float(out[0]) - last) <= block["rate_limit"] * (1 + 1e-12) + np.spacing(abs(last))
        assert np.isfinite(c.state("j0")["x"]).all()
        last = float(out[0])


def test_unlimited_torque_that_overflows_while_fading_is_held():
    block = pd_block(1.0, 0.0)
    block["blend"] = 0.9
    c, out = controller(block), np.zeros(1)
    c.inputs.position_ref[:] = 1.7e308
    c.step(out)
    c.set_mode("j0", "bypass")
    c.inputs.position_ref[:] = -1.7e308
    for _ in range(3):
        assert c.step(out) == NOT_FINITE
        assert out == 1.7e308


@pytest.mark.parametrize("form", ["explicit", "implicit"])
@pytest.mark.parametrize("law", [LAW, SPRUNG], ids=["K=0", "K>0"])
def test_no_wind_up(law, form):
    """The state follows the motion alone: limits cut the command and leave no trace.

    Along a given motion the sensor reads the torque in effect less the rotor's share, so the command of a
    limited joint must be the clipped command of an unlimited one, at every tick and from the first tick
    after a long saturation on.
    """
    limit, ticks, latency = 2.0, 3000, 2 if form == "explicit" else 0
    share = np.where(np.arange(ticks) < 2000, 40.0, 0.0) * np.sin(np.arange(ticks) / 400) ** 2
    block = make(law, form, latency=latency)
    n = int(block["nx"])
    if form == "explicit":  # tau_s - u' = -share, whatever u' is
        free = np.zeros(ticks)
        x = np.zeros(n)
        for k in range(ticks):
            free[k] = block["C"][:n] @ x - block["D"][0] * share[k]
            x = block["A"][:n, :n] @ x - block["B"][:n, 0] * share[k]
    else:  # the same with u' = u: undo the elimination
        loop = 1 / (1 - block["D"][0])
        C, both = block["C"][:n] * loop, block["B"][:n, 0] * loop
        phi = block["A"][:n, :n] + np.outer(both, C) / loop
        x, free = np.zeros(n), np.zeros(ticks)
        for k in range(ticks):
            free[k] = C @ x - (loop - 1) * share[k]
            x = phi @ x - both * share[k]
    expected = np.clip(free, -limit, limit)
    assert np.abs(free[:1000]).max() > 3 * limit

    def play(block, in_effect_is_right=True):
        c, out, commands = controller(block), np.zeros(1), []
        for k in range(ticks):
            applied = c.state("j0")["in_effect"] if form == "explicit" else expected[k]
            c.inputs.torque[:] = applied - share[k]
            if not in_effect_is_right:  # the law believes the unlimited torque took effect
                c.inputs.torque[:] += applied - (free[k - 1 - latency] if k > latency else 0.0)
            c.step(out)
            commands.append(out[0])
        return np.array(commands)

    np.testing.assert_allclose(
        play(make(law, form, latency=latency, torque_limit=limit)), expected, atol=1e-8
    )
    wrong = make(law, form, latency=latency, torque_limit=limit)
    if form == "implicit":
        wrong["E"] = 0.0
    astray = np.abs(play(wrong, form == "implicit") - expected)
    assert astray[2000:].max() > 0.03 * limit  # still wrong after the saturation is over


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("torque_limit", math.nan),
        ("torque_limit", -1.0),
        ("rate_limit", math.nan),
        ("rate_limit", -1e-3),
        ("blend", 1.0),
        ("blend", -0.1),
        ("blend", math.nan),
        ("nx", 5),
        ("nx", -1),
        ("latency", 17),
        ("latency", -1),
        ("A", math.nan),
        ("D", math.inf),
    ],
)
def test_bad_coefficients_are_refused(key, value):
    block = make()
    block[key] = value
    with pytest.raises(InputError, match=f"^joint 'j0'.*{key}"):
        controller(block)
    if key not in "AD":  # whoever comes past Python is refused as well
        with pytest.raises(ValueError, match="out of range"):
            _native.Core(np.array([block]).view(np.uint8))


@pytest.mark.parametrize("n", [0, 17])
def test_number_of_joints(n):
    with pytest.raises(InputError, match="1 to 16"):
        Controller(np.array([make()] * n, BLOCK_DTYPE), ["j"] * n, H)
    with pytest.raises(InputError, match="names"):
        Controller(np.array([make()]), ["a", "b"], H)


def test_output_that_cannot_be_written_in_place_is_refused():
    """A converted copy would swallow the torques."""
    c = controller(make(), make())
    for out in (np.zeros(2, np.float32), np.zeros(4)[::2], np.zeros(2, int), [0.0, 0.0]):
        with pytest.raises(TypeError):
            c.step(out)
    with pytest.raises(ValueError, match="one element per joint"):
        c.step(np.zeros(3))
    with pytest.raises(ValueError, match=r"\(7, n\)"):
        c.step(np.zeros((6, 2)), np.zeros(2))
    assert c.step(np.zeros((7, 2)), np.zeros(2)) == 0


# --- faults ----------------------------------------------


@pytest.mark.parametrize("form", ["explicit", "implicit"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_broken_torque_sensor_holds_its_joint_and_no_other(form, bad):
    block = make(SPRUNG, form, 20.0, 1.0, torque_limit=30.0, latency=1)
    rng = np.random.default_rng(2)
    torque = rng.normal(size=(400, 3))
    broken = torque.copy()
    broken[100:120, 1] = bad
    sound, c = run(controller(block, block, block), torque), controller(block, block, block)
    out = np.zeros(3)
    for k, row in enumerate(broken):
        c.inputs.torque[:] = row
        before = c.state("j1")
        status = c.step(out)
        assert out[[0, 2]].tolist() == sound[k, [0, 2]].tolist()
        if 100 <= k < 120:
            assert status == c.state("j1")["status"] == NOT_FINITE
            assert c.state("j0")["status"] == 0
            assert out[1] == sound[99, 1]
            assert c.state("j1")["x"] == before["x"]
        else:
            assert status == 0
    late = run(c, np.zeros((4000, 3)))
    assert abs(late[-1, 1] - late[-1, 0]) < 1e-3 * np.abs(sound).max()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_broken_input_that_is_not_used_does_not_matter(bad):
    loop, plain = make(SPRUNG, kp=20.0, kd=1.0), make(SPRUNG)
    torque = np.random.default_rng(3).normal(size=(50, 1))
    free, brake = controller(loop), controller(plain)
    brake.inputs.position[:] = brake.inputs.velocity_ref[:] = bad  # no gain on the encoder at all
    free.set_position_loop("j0", False)
    free.inputs.position[:] = free.inputs.velocity[:] = free.inputs.torque_ref[:] = bad
    expected = run(controller(plain), torque)
    assert run(brake, torque).tolist() == expected.tolist()
    assert run(free, torque).tolist() == expected.tolist()
    assert free.state("j0")["status"] == brake.state("j0")["status"] == 0

    bypassed, pd, out = controller(loop), controller(pd_block(20.0, 1.0)), np.zeros(1)
    bypassed.set_mode("j0", "bypass")
    bypassed.inputs.torque[:] = bypassed.inputs.acceleration_ref[:] = bad
    bypassed.inputs.position[:] = pd.inputs.position[:] = 0.1
    assert bypassed.step(out) == 0
    assert out == -2.0
    bypassed.inputs.position[:] = bad
    assert bypassed.step(out) == NOT_FINITE
    assert out == -2.0
    bypassed.set_mode("j0", "off")
    assert bypassed.step(out) == 0
    assert out == 0


# --- warm start and changes of mode ----------------------


@pytest.mark.parametrize("form", ["explicit", "implicit"])
@pytest.mark.parametrize("law", [LAW, SPRUNG], ids=["K=0", "K>0"])
def test_warm_start_brakes_at_once(law, form):
    """The first torque is -a velocity, less what one period of the law takes off it."""
    block = make(law, form)
    for velocity in (-2.0, 0.5):
        c = controller(block)
        c.warm_start("j0", velocity)
        n = int(block["nx"])
        x = block["warm"][:n] * velocity
        assert c.state("j0")["x"][:n] == tuple(x)
        if form == "explicit":
            assert x[-1] == -velocity
        first = run(c, [0.0]).item()
        assert first == pytest.approx(block["C"][:n] @ x, rel=1e-14)
        decay = H * (law.D / (law.R * law.m) + (law.a / (2 * law.m) if form == "implicit" else 0))
        assert first == pytest.approx(-law.a * velocity, rel=1.5 * decay)
        assert run(controller(block), [0.0]).item() == 0


def test_warm_start_refuses_what_is_not_a_velocity():
    c = controller(make())
    with pytest.raises(InputError, match="velocity"):
        c.warm_start("j0", math.nan)
    with pytest.raises(InputError, match="not controlled here; controlled: j0"):
        c.warm_start("j7", 0.0)
    with pytest.raises(InputError, match="off, bypass, active"):
        c.set_mode("j0", "on")
    with pytest.raises(IndexError):
        c.core.set_mode(1, 0)


@pytest.mark.parametrize("form", ["explicit", "implicit"])
@pytest.mark.parametrize("blend", [0.0, 0.95])
@pytest.mark.parametrize(("before", "after"), [("active", "off"), ("off", "active"), ("bypass", "active")])
def test_change_of_mode(form, blend, before, after):
    block = make(LAW, form, kp=10.0, blend=blend)
    c, abrupt = controller(block), controller(make(LAW, form, kp=10.0))
    for k in (c, abrupt):
        k.set_mode("j0", before)
        k.inputs.position_ref[:] = 0.2
    torque = np.full((3000, 1), 4.0)
    old = run(c, torque)[-1, 0]
    run(abrupt, torque)
    for k in (c, abrupt):
        k.set_mode("j0", after)
    new, plain = run(c, torque)[:, 0], run(abrupt, torque)[:, 0]
    assert abs(plain[0] - old) > 0.1
    if blend == 0:
        assert new == pytest.approx(plain, abs=1e-12)
        return
    assert new[0] == pytest.approx(old, abs=1e-12)  # no step at the tick of the change
    # beyond the law's own movement, a tick moves the torque by the fading of the step and by what the
    # law makes of the step, which it sees as torque in effect: a h/m of it
    step = abs(old - plain[0])
    assert np.abs(np.diff(new)).max() < (1 - blend + LAW.a * H / LAW.m) * step + np.abs(np.diff(plain)).max()
    assert new[-1] == pytest.approx(plain[-1], rel=1e-6, abs=1e-9)
    if after == "off":
        k = np.arange(100)
        assert new[:100] == pytest.approx(old * blend**k, rel=1e-9)
        assert new[-1] == 0  # no denormal tail
        assert c.state("j0")["status"] == 0


# --- plain C ---------------------------------------------


def build(tmp_path, *args):
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2", f"-I{NATIVE}"]
    done = subprocess.run(["cc", *flags, *args], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr


def test_core_needs_nothing_from_outside(tmp_path):
    """No allocation, no library: nothing is undefined in the object file.

    memset and memcpy may appear: compilers emit them for structure copies and clears, even freestanding,
    and every C environment has them. Nothing else may.
    """
    build(tmp_path, "-ffreestanding", "-c", str(NATIVE / "dashpot_core.c"), "-o", "core.o")
    symbols = subprocess.run(["nm", "-u", "core.o"], capture_output=True, text=True, cwd=tmp_path, check=True)
    assert set(symbols.stdout.replace("U ", " ").split()) <= {"memset", "memcpy"}
    text = (NATIVE / "dashpot_core.c").read_text() + (NATIVE / "dashpot_core.h").read_text()
    assert [line for line in text.splitlines() if line.startswith("#include")] == [
        '#include "dashpot_core.h"'
    ]


TWIN = r"""
#include <stdio.h>
#include "dashpot_core.h"
#include "dashpot_runner.h"
int main(int argc, char **argv)
{
    static dp_block blocks[3];
    static dp_controller c;
    double in[DP_NIN * 3], out[3];
    FILE *f = argc > 1 ? fopen(argv[1], "rb") : 0;
    if (!f || fread(blocks, sizeof(dp_block), 3, f) != 3 || dp_init(&c, blocks, 3))
        return 1;
    printf("%d %d %d\n", (int)sizeof(dp_block), (int)sizeof(dp_drive), (int)sizeof(dp_event));
    for (int k = 0; k < 1000; k++) {
        if (fread(in, sizeof in, 1, f) != 1)
            return 2;
        if (k == 100) dp_warm_start(&c, 0, 0.7);
        if (k == 200) dp_set_mode(&c, 1, DP_MODE_BYPASS);
        if (k == 300) dp_set_position_loop(&c, 2, 0);
        if (k == 400) dp_set_mode(&c, 1, DP_MODE_ACTIVE);
        if (k == 900) dp_reset(&c);
        int status = dp_step(&c, in, out);
        printf("%d %a %a %a\n", status, out[0], out[1], out[2]);
    }
    blocks[1].nx = DP_NX + 1;
    return dp_init(&c, blocks, 3) == -1 && dp_init(&c, blocks, 0) == -1 ? 0 : 3;
}
"""


def test_a_plain_c_program_gives_the_same_bits(tmp_path):
    blocks = [
        make(LAW, "explicit", 20.0, 1.0, latency=2, torque_limit=5.0),
        make(SPRUNG, "implicit", 20.0, 1.0, blend=0.97, rate_limit=0.3),
        make(SPRUNG, "explicit", 5.0, 0.1),
    ]
    inputs = np.random.default_rng(5).normal(size=(1000, 7, 3))
    inputs[500:505, 0, 1] = np.nan
    (tmp_path / "data.bin").write_bytes(np.array(blocks).tobytes() + inputs.tobytes())
    (tmp_path / "twin.c").write_text(TWIN)
    build(tmp_path, "twin.c", str(NATIVE / "dashpot_core.c"), "-o", "twin")
    done = subprocess.run(
        ["./twin", "data.bin"], capture_output=True, text=True, cwd=tmp_path, check=False, timeout=20
    )
    assert done.returncode == 0
    sizes, *lines = done.stdout.splitlines()
    expected = [BLOCK_DTYPE.itemsize, DRIVE_DTYPE.itemsize, EVENT_DTYPE.itemsize]
    assert [int(size) for size in sizes.split()] == expected
    assert expected == [_native.BLOCK_SIZE, _native.DRIVE_SIZE, _native.EVENT_SIZE]

    c, out = controller(*blocks), np.zeros(3)
    events = {
        100: lambda: c.warm_start("j0", 0.7),
        200: lambda: c.set_mode("j1", "bypass"),
        300: lambda: c.set_position_loop("j2", False),
        400: lambda: c.set_mode("j1", "active"),
        900: c.reset,
    }
    assert len(lines) == 1000
    for k, line in enumerate(lines):
        events.get(k, lambda: None)()
        status = c.step(inputs[k], out)
        first, *torques = line.split()
        assert int(first) == status
        assert [float.fromhex(u) for u in torques] == out.tolist()
