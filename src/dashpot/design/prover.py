"""The certificate as a search asks for it: thousands of quick no's, and a few proofs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dashpot.certify.box import CONTINUOUS, Box, BoxCertificate, StandIn, at, certify_box
from dashpot.certify.exact import holds
from dashpot.certify.index import NO_DAMPING, SPEED_IN_SAMPLE, passivity_index
from dashpot.certify.joint import sampled_joint
from dashpot.control.sampled import empty_block
from dashpot.design.candidates import Duty

Depth = Literal["quick", "proof", "all"]
Refusal = tuple[str, Mapping[str, float]]
Ask = Callable[[NDArray[np.void], bool], bool]
Test = tuple[str, Mapping[str, float], Ask]
NO_FRICTION = (
    "the drive alone has no damping to spare: give `viscous_friction` in the robot file; a low guess is the "
    "safe one"
)
ROUNDED = 1e-3  # of the margin: how far the index of a result may fall short by rounding


class Prover:
    """Asks whether blocks of one kind, with or without position loop, are certified with a margin.

    A block must pass the exact test at the corners of the box, once with the index the margin demands and
    once with the stand-in that proves the interior (`dashpot.certify.box`). Whatever refused a block is asked
    first from then on, so that a no mostly costs one test.

    Attributes:
        bare: Index of the drive without controller [N m s/rad].
        margin: Index asked for over `bare` [-].
        hopeless: Why no gains can pass, in words; empty where some may.
        asked: Exact tests so far.
    """

    def __init__(self, duty: Duty, like: NDArray[np.void], margin: float) -> None:
        self.duty, self.margin, self.asked = duty, margin, 0
        drive, sampling, period = duty.drive, duty.sampling, duty.period
        self.bare = passivity_index(drive, empty_block(), sampling, period).value
        box = Box.of(drive, like, duty.latency_max)
        self.hopeless = ""
        if not box.ranges["damping"][0] > 0:
            self.hopeless = NO_DAMPING
        elif not self.bare > 0:
            self.hopeless = NO_FRICTION
        elif sampled_joint(drive, like, sampling, period).speed_in_sample:
            self.hopeless = SPEED_IN_SAMPLE
        self._tests: list[Test] = []
        self._hot = 1
        if self.hopeless:
            return
        stand_in = StandIn.of(box, drive)
        for corner in box.proof_corners():
            self._tests.append(("proof", corner, self._proof(stand_in, corner)))
        for corner in box.corners((*CONTINUOUS, "latency")):
            self._tests.append(("margin", corner, self._level(corner)))
        # Too much feedback on a light rotor is what fails first, nearly always.
        self._tests.sort(key=lambda t: (t[0] != "proof", t[1]["rotor_inertia"], -t[1]["torque_gain"]))

    def _proof(self, stand_in: StandIn, corner: Mapping[str, float]) -> Ask:
        means = self.duty.sampling, self.duty.period
        return lambda block, stored: stand_in.holds(corner, block, *means, stored=stored)

    def _level(self, point: Mapping[str, float]) -> Ask:
        drive, scales = at(self.duty.drive, point)
        level = self.margin * self.bare - drive.link_friction

        def test(block: NDArray[np.void], stored: bool) -> bool:
            joint = sampled_joint(drive, block, self.duty.sampling, self.duty.period, scales)
            return not joint.speed_in_sample and holds(joint, level)

        return test

    def passes(self, block: NDArray[np.void], depth: Depth = "all") -> bool:
        """Whether a block passes the tests that have refused one so far ("quick"), these and all that prove
        passivity over the box ("proof"), or the margin at the corners as well ("all").
        """
        if self.hopeless:
            return False
        for i in range(self._hot if depth == "quick" else len(self._tests)):
            if depth == "proof" and i >= self._hot and self._tests[i][0] == "margin":
                continue
            self.asked += 1
            if not self._tests[i][2](block, depth != "quick"):
                self._hot += i >= self._hot
                self._tests.insert(0, self._tests.pop(i))
                return False
        return True

    def certificate(self, block: NDArray[np.void]) -> tuple[bool, BoxCertificate]:
        """The verdict as `dashpot certify` gives it, and whether its worst index keeps the margin.

        Where it does not, the worst point joins the tests.
        """
        duty = self.duty
        found = certify_box(duty.drive, block, duty.sampling, duty.period, duty.latency_max)
        enough = found.worst.value >= self.margin * self.bare * (1 - ROUNDED)
        if not enough and not self.hopeless:
            self._tests.insert(0, ("margin", found.point, self._level(found.point)))
            self._hot += 1
        return found.proven and enough, found

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """Kind and point of the tests that have refused a block so far, the last one first."""
        return tuple(test[:2] for test in self._tests[: self._hot])

    def expect(self, refusals: Sequence[Refusal]) -> None:
        """Asks what refused blocks elsewhere first."""
        known = [test for test in self._tests if test[:2] in refusals]
        self._tests = known + [test for test in self._tests if test[:2] not in refusals]
        self._hot = max(1, len(known))

    @property
    def last_refusal(self) -> Refusal | None:
        """Kind and point of the test that refused a block last."""
        return self._tests[0][:2] if self._tests else None
