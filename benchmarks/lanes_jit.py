"""Raw ``mj_step`` of the fr3 against MJX and mujoco-warp on the processor, which take minutes to compile.

pip install mujoco-mjx jax mujoco-warp
python benchmarks/lanes_jit.py warp        # or mjx
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot

WORLDS = {"warp": 64, "mjx": 256}
STEPS, ROUNDS = 5, 5


def best(act: Callable[[], object], count: int) -> float:
    """Least CPU seconds of `act` over `count`."""
    act()  # compiles
    taken = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        act()
        taken.append((time.process_time() - begin) / count)
    return min(taken)


def warp(model: Any, worlds: int) -> float:
    import mujoco_warp
    import warp

    warp.set_device("cpu")
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # unknown to it
    there, data = mujoco_warp.put_model(model), mujoco_warp.make_data(model, nworld=worlds)

    def go() -> None:
        for _ in range(STEPS):
            mujoco_warp.step(there, data)
        warp.synchronize()

    return best(go, worlds * STEPS)


def mjx(model: Any, worlds: int) -> float:
    import jax
    from mujoco import mjx

    jax.config.update("jax_enable_x64", True)
    there = mjx.put_model(model)
    start = np.random.default_rng(0).uniform(-0.1, 0.1, (worlds, model.nq))
    data = jax.vmap(lambda q: mjx.make_data(there).replace(qpos=q))(start)
    step = jax.jit(jax.vmap(lambda one: mjx.step(there, one)))
    return best(lambda: step(data).qpos.block_until_ready(), worlds)


def main() -> None:
    which = sys.argv[1] if len(sys.argv) == 2 else ""
    if which not in WORLDS:
        raise SystemExit(__doc__)
    model = build(Robot.load("fr3"), 1e-3, [Payload(1.0, (0.0, 0.0, 0.1))]).model
    data = mujoco.MjData(model)
    raw = best(lambda: mujoco.mj_step(model, data, nstep=5000), 5000)
    other = {"warp": warp, "mjx": mjx}[which](model, WORLDS[which])
    print(
        f"raw mj_step {1e6 * raw:.2f} us, {which} on the processor {1e6 * other:.2f} us: {raw / other:.3f} x"
    )


if __name__ == "__main__":
    main()
