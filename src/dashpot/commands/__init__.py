"""What the commands of `dashpot.cli` do; imported only when one runs."""

from __future__ import annotations

NATIVE_LOOP = "dashpot native loop"
"""Name of a thread that may still be in native code when the command is stopped."""
