"""Drives identified from logs of torque and motion: estimates with intervals, or a refusal that says why.

Method, assumptions and evidence: docs/identify.md.
"""

from dashpot.identify.estimate import DriveEstimate, Estimate, Fit, Refusal
from dashpot.identify.joint import identify_joint

__all__ = ["DriveEstimate", "Estimate", "Fit", "Refusal", "identify_joint"]
