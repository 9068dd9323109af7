"""What the commands of `dashpot.cli` do; imported only when one runs."""

from __future__ import annotations

NATIVE_LOOP = "dashpot native loop"
"""Name of a thread that may still be in native code when the command is stopped."""


def quiet_engine() -> None:
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT into the current folder; a divergence is reported anyway."""
    import mujoco

    mujoco.set_mju_user_warning(lambda _: None)
