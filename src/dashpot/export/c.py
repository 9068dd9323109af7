"""A controller as one pair of C99 files: ``name.c`` and ``name.h``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import Certificate
from dashpot.control.controller import Controller, ControllerConfig
from dashpot.control.sampled import NX
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.control.thresholds import rules_record, watch_records
from dashpot.export.selfcheck import CONTROLLER, STIMULUS, SUPERVISOR, TICKS, controller_hash, supervisor_hash
from dashpot.export.source import core_texts, renamed, supervisor_texts
from dashpot.export.summary import lines, plain
from dashpot.export.tables import UNLIMITED, c_record

GUARDS = f"""#include <float.h>
#include <stdint.h>

/* Every operation rounds: results must not depend on the machine. dp_check tells whether they do. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math takes the checks for NaN away"
#endif
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0
#error "registers wider than a double: on x86 compile with -msse2 -mfpmath=sse"
#endif
#if DBL_MANT_DIG != 53
#error "needs doubles of 64 bits"
#endif

#if defined(__GNUC__)
#define {UNLIMITED} __builtin_inf()
#else
#include <math.h>
#define {UNLIMITED} INFINITY
#endif
"""

CHECKS = """/* 0 where this build computes what dashpot did when it wrote this file, -1 where a bit differs.
 * Takes {ticks} ticks; leaves *c{too} as after init. */
int dp_{what}check({arguments});
"""


@dataclass(frozen=True)
class Export:
    """A controller of an arm, ready to be written as C.

    Attributes:
        name: Prefix of everything defined; a C identifier.
        robot: The arm.
        config: The controller's file.
        certificate: Of exactly this controller on this arm, or None.
        settings: Of the supervisor that goes along, or None.
        limits: Joint -> range of its angle [rad], for the supervisor.
    """

    name: str
    robot: Robot
    config: ControllerConfig
    certificate: Certificate | None = None
    settings: SupervisorSettings | None = None
    limits: dict[str, tuple[float, float]] | None = None

    @cached_property
    def controller(self) -> Controller:
        """The controller that runs in Python: the exported one is equal to it, bit for bit."""
        return Controller.from_config(self.config, self.robot.drives)

    @cached_property
    def blocks(self) -> NDArray[np.void]:
        """The coefficients as the native code uses them: zeros beyond the states of a block."""
        blocks = self.controller.blocks.copy()
        for block in blocks:
            n = int(block["nx"])
            block["C"][n:] = 0.0
            block["A"][:, n:] = 0.0
        return blocks

    @cached_property
    def rules(self) -> NDArray[np.void] | None:
        """The supervisor's rules, a record of `RULES_DTYPE`."""
        return None if self.settings is None else rules_record(self.settings, self.config.period)

    @cached_property
    def watch(self) -> NDArray[np.void] | None:
        """The supervisor's thresholds, (n,) records of `WATCH_DTYPE`."""
        if self.settings is None:
            return None
        return watch_records(self.controller, self.robot.drives, self.settings, self.limits)

    @property
    def state_bytes(self) -> int:
        """Memory the controller needs besides its constants, where doubles are aligned to 8 bytes [bytes]."""
        return len(self.blocks) * (8 * (NX + 3 + self.latency) + 24)

    @property
    def latency(self) -> int:
        """Places in a joint's delay line, at least one."""
        return max(1, int(self.blocks["latency"].max()))

    def header(self) -> str:
        """Text of ``name.h``."""
        core, guard = core_texts(len(self.blocks), self.latency), f"{self.name.upper()}_H"
        parts = [_comment(lines(self.robot, self.config, self.controller, self.certificate)), self._use()]
        parts.append(f'#ifndef {guard}\n#define {guard}\n\n#ifdef __cplusplus\nextern "C" {{\n#endif\n')
        period = f"#define DP_PERIOD {self.config.period!r} /* [s] between two ticks */\n"
        parts += [
            period,
            core.header,
            CHECKS.format(ticks=TICKS, too="", what="", arguments="dp_controller *c"),
        ]
        if self.settings is not None:
            means = {
                "too": " and *s",
                "what": "supervisor_",
                "arguments": "dp_supervisor *s, dp_controller *c",
            }
            parts += ["/* ---- supervisor ---- */\n", supervisor_texts().header]
            parts.append(CHECKS.format(ticks=TICKS, **means))
        parts.append("#ifdef __cplusplus\n}\n#endif\n#endif\n")
        return renamed("\n".join(part.strip("\n") + "\n" for part in parts), self.name)

    def source(self) -> str:
        """Text of ``name.c``."""
        core = core_texts(len(self.blocks), self.latency)
        parts = [f'#include "{self.name}.h"\n', GUARDS, core.records, self._blocks()]
        if self.settings is None:
            parts += [core.code, *self._checks()]
        else:
            texts = supervisor_texts()
            parts += [texts.records, self._thresholds(), core.code, texts.code, *self._checks()]
        return renamed("\n".join(part.strip("\n") + "\n" for part in parts), self.name)

    def _use(self) -> str:
        supervised = self.settings is not None
        call = (
            "dp_supervise(&s, &c, in, torque_age, encoder_age, out)" if supervised else "dp_step(&c, in, out)"
        )
        init = "dp_init(&c); dp_supervisor_init(&s);" if supervised else "dp_init(&c);"
        state = "dp_controller c; dp_supervisor s;" if supervised else "dp_controller c;"
        return _comment(
            [
                f"Once:        {state} {init}",
                f"Every tick:  status = {call};",
                "in[i * DP_JOINTS + j] is input i of joint j, out[j] the torque to command now [N m].",
                "Before the first use on a new target or with a new compiler: dp_check(&c) == 0.",
                "",
                "C99, freestanding: no allocation, no library (a compiler may call memcpy and memset), no",
                "variables but those you pass; the structs are plain data: copy or save them as they are.",
            ]
        )

    def _blocks(self) -> str:
        comment = (
            "/* Coefficients, exact to the bit; in order of the joints. What is left out is zero. Torque\n"
            " * limits in N m, rate limits in N m per tick. */\n"
        )
        return f"{comment}static const dp_block BLOCKS[DP_JOINTS] = {{\n{self._records(self.blocks)}}};\n"

    def _thresholds(self) -> str:
        assert self.rules is not None
        assert self.watch is not None
        return (
            f"static const dp_rules RULES = {{\n{c_record(self.rules)}\n}};\n\n"
            f"static const dp_watch WATCH[DP_JOINTS] = {{\n{self._records(self.watch)}}};\n"
        )

    def _records(self, records: NDArray[np.void]) -> str:
        return "".join(
            f"    {{ /* {j}: {text} */\n{c_record(record, indent=' ' * 8)}\n    }},\n"
            for j, (text, record) in enumerate(zip(self._joints(), records, strict=True))
        )

    def _joints(self) -> list[str]:
        named = zip(self.controller.joints, self.config.joints, strict=True)
        return [f"{plain(name)}: {plain(law.text)}" for name, law in named]

    def _checks(self) -> list[str]:
        ticks = {"@TICKS@": str(TICKS)}
        texts = [STIMULUS, _filled(CONTROLLER, ticks | {"@HASH@": str(controller_hash(self.blocks))})]
        if self.rules is not None and self.watch is not None:
            expected = supervisor_hash(self.blocks, self.rules, self.watch)
            texts.append(_filled(SUPERVISOR, ticks | {"@HASH@": str(expected)}))
        return texts


def _comment(text: Iterable[str]) -> str:
    body = [f" * {line}".rstrip() for line in text]
    return "\n".join(["/*" + body[0][2:], *body[1:], " */"])


def _filled(text: str, values: dict[str, str]) -> str:
    for key, value in values.items():
        text = text.replace(key, value)
    return text
