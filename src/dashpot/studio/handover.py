"""Hands a running joint from one law, load or arm to another without a jump of its torque."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.control.controller import MODES, Controller
from dashpot.control.sampled import IN_EFFECT, NX, POSITION
from dashpot.support.arrays import Floats


def hand_over(
    core: _native.Core, i: int, block: NDArray[np.void], w: Floats, torque: float, loop: bool = True
) -> None:
    """Sets a joint to rest under its present inputs, with a torque in effect.

    Args:
        core: The controller.
        i: Joint of the controller.
        block: Its block.
        w: Inputs of the block, (NW,); the torque in effect is replaced.
        torque: In effect [N m]; kept within the block's limit.
        loop: Whether the position loop is on.
    """
    limit = float(block["torque_limit"])
    w = w.copy()
    w[IN_EFFECT] = torque = min(max(torque, -limit), limit)
    if not loop:
        w[POSITION:] = 0.0
    core.preset(i, equilibrium_state(block, w), torque)


def retuned(old: _native.Core, before: Controller, controller: Controller, inputs: Floats) -> _native.Core:
    """A core with other numbers that goes on where one was; a law whose numbers change is faded in.

    Args:
        old: The core in charge.
        before: Its controller.
        controller: The new one, of the same joints.
        inputs: What each joint's law saw last, (joints, NW).
    """
    new = _native.Core(controller.blocks.view(np.uint8))
    for i, block in enumerate(controller.blocks):
        mode, loop, command, in_effect, _, x = old.joint_state(i)
        changed = block != before.blocks[i]
        if changed:
            new.set_mode(i, MODES.index("bypass" if MODES[mode] != "bypass" else "off"))
        new.set_mode(i, mode)  # what changes is faded in
        new.set_position_loop(i, loop)
        w = inputs[i].copy()
        w[IN_EFFECT] = in_effect
        if not loop:
            w[POSITION:] = 0.0
        limit = float(block["torque_limit"])
        state = equilibrium_state(block, w) if changed else np.array(x)
        new.preset(i, state, min(max(command, -limit), limit))
    return new


def equilibrium_state(block: NDArray[np.void], w: Floats) -> Floats:
    """State of a block (NX,) that stays where it is under constant inputs w (NW,).

    Where the inputs do not determine it, as an integrator's, it is the one whose torque is that in effect.
    """
    n = int(block["nx"])
    state = np.zeros(NX)
    if n == 0:
        return state
    system = np.vstack([np.eye(n) - block["A"][:n, :n], 1e-3 * block["C"][None, :n]])
    wanted = np.append(block["B"][:n] @ w, 1e-3 * (w[IN_EFFECT] - block["D"] @ w))
    if np.linalg.cond(system[:n]) < 1e9:
        system, wanted = system[:n], wanted[:n]
    state[:n] = np.linalg.lstsq(system, wanted, rcond=None)[0]
    return state
