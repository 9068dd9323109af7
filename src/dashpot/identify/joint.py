"""One joint's drive from a log: checks, the two equations, estimates and refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.errors import InputError
from dashpot.identify import refusals as rules
from dashpot.identify.channels import channels_of, hopeless, no_windows
from dashpot.identify.estimate import UNITS, DriveEstimate, Estimate, Fit, Refusal
from dashpot.identify.quantities import NOT_NEGATIVE, curve_shown, estimate, quantities, widths
from dashpot.identify.regression import RANK
from dashpot.identify.rotor import Rotor, RotorFit, Unknowns
from dashpot.identify.spring import TRANSMISSION, add_transmission
from dashpot.identify.weak import SHORTEST_KERNEL
from dashpot.identify.windows import Channels, Windows
from dashpot.logs.log import Log

KERNELS = (1.0, 1.6, 2.6)  # tried, times the shortest
SHORTEST_TIME = 5e-3  # [s], standard deviation of the shortest kernel: passes what moves an arm
LARGEST_SCALE = 0.5  # [-], as in `Drive.torque_scale_error`
EARLY = 0.5  # [periods] by which a torque may seem to act before its command: stamps are no better
UNSEEN = 10.0  # times the torque's standard deviation: how far an unseen direction may be off


def identify_joint(log: Log, joint: str, drive: Drive, *, scale: float | None = None) -> DriveEstimate:
    """Identifies one joint's drive from a log.

    Of the drive only the sensor model (latency, low-pass) and the torque limit are used; the command is the
    reference of all torques. Angles are preferred to velocities where the log has both.

    Args:
        log: Torques and motion.
        joint: One of its joints.
        drive: Of that joint; its values to be identified are not looked at.
        scale: Relative error of the torque sensor's scale [-] where it is known; None: to be identified.

    Raises:
        InputError: The log has no such joint or no motion of it, or values that cannot be.
    """
    if scale is not None and not (math.isfinite(scale) and abs(scale) <= LARGEST_SCALE):
        raise InputError("must be between -0.5 and 0.5", joint=joint, quantity="scale [-]", value=scale)
    channels = channels_of(log, joint)
    asked = tuple(name for name in rules.ALL if scale is None or name != "torque_scale_error")
    if all(c.link is not None for c in channels):
        asked += TRANSMISSION
    why = hopeless(channels, log.period)
    if why:
        return DriveEstimate(joint, {}, (Refusal(asked, *why),), None)
    with np.errstate(all="ignore"):  # what is not finite is refused below
        try:
            return _solve(log, joint, asked, channels, drive, scale)
        except (np.linalg.LinAlgError, FloatingPointError):
            reason = "the equations of this motion cannot be solved"
            return DriveEstimate(joint, {}, (Refusal(asked, reason, rules.GENERAL),), None)


def _solve(
    log: Log, joint: str, asked: tuple[str, ...], channels: list[Channels], drive: Drive, scale: float | None
) -> DriveEstimate:
    """Tries kernels, takes the one with the most certain inertia and friction, and concludes."""
    shortest = max(SHORTEST_KERNEL * log.period, SHORTEST_TIME)
    windows = Windows(channels, log.period, shortest, drive, log.sampling)
    reason = no_windows(windows, channels)
    if reason:
        return DriveEstimate(joint, {}, (Refusal(asked, *reason),), None)
    solved = []
    for factor in KERNELS:
        if factor > 1:
            windows = Windows(channels, log.period, factor * shortest, drive, log.sampling)
        if windows.independent < rules.FEWEST:
            continue
        rotor = Rotor(windows, scale, channels[0].rate)
        fit = rotor.solve(Unknowns(rotor.latency_guess()))
        solved.append((_spread(fit), rotor, fit))
    _, rotor, fit = min(solved, key=lambda item: item[0])
    return _conclude(joint, asked, rotor.with_stribeck(fit), channels, scale)


def _spread(fit: RotorFit) -> float:
    """How uncertain inertia and friction are, as if the residual were white: sum of logarithms."""
    X = fit.columns
    scale = np.sqrt((X * X).mean(0))
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv((X / scale).T @ (X / scale), rcond=RANK**2, hermitian=True)
    indices = [fit.column(name) for name in ("rotor_inertia", "viscous_friction", "coulomb_friction")]
    variance = np.diag(inverse)[indices] / scale[indices] ** 2
    # Residuals of neighbouring windows are correlated: windows of a longer kernel count for more.
    noise = float(np.mean(fit.regression.residual**2)) * len(X) / max(fit.windows.independent, 1.0)
    return float(np.sum(np.log(np.maximum(variance * noise, 1e-300))))


def _seen(fit: RotorFit, channels: list[Channels]) -> rules.Seen:
    w = fit.windows
    speed = w.speed[w.used]
    return rules.Seen(
        float(np.std(speed)),
        float(np.quantile(np.abs(speed), 0.05)),
        float(np.quantile(np.abs(speed), 0.95)),
        float(np.std(fit.columns[:, fit.column("rotor_inertia")])),
        w.noise / w.kernel * (math.sqrt(0.5) if channels[0].rate else math.sqrt(1.5)),
        float((speed > 0).mean()),
        float(np.std(w.torque()[w.used])),
        w.count * w.stride * w.period,
    )


def _conclude(
    joint: str, asked: tuple[str, ...], fit: RotorFit, channels: list[Channels], scale: float | None
) -> DriveEstimate:
    w, regression = fit.windows, fit.regression
    command = fit.all_command + (0.0 if scale is None else w.torque() / (1 + scale))
    predicted = command - (fit.all_command - fit.all_columns @ regression.theta)
    picture = Fit(
        w.time,
        command,
        predicted,
        command - predicted,
        w.used,
        float(np.std(regression.residual)),
        w.count * w.stride,
        w.kernel,
    )
    size = float(np.std(fit.all_command[w.used]))
    seen = _seen(fit, channels)
    left = picture.residual_std / size if size > 0 else math.inf
    if not (fit.converged and np.isfinite(regression.cov).all()):
        return DriveEstimate(joint, {}, (rules.misaligned(asked, seen),), picture)
    if not left <= rules.MISFIT:
        reason = f"the rotor's equation leaves {min(left, 1.0):.0%} of the torque unexplained"
        motion = "less noise, or a larger motion; a robot that adds torques of its own cannot be identified"
        return DriveEstimate(joint, {}, (Refusal(asked, reason, motion),), picture)
    q = quantities(fit)
    cov = q.jacobian @ regression.cov @ q.jacobian.T
    # A model error of this size, at its worst, moves the coefficients within this ellipsoid.
    scales = np.sqrt((fit.columns**2).mean(0))
    scales[scales == 0] = 1.0
    gram = (fit.columns / scales).T @ (fit.columns / scales) / len(fit.columns)
    value, axes = np.linalg.eigh(gram)
    shift = (axes / np.maximum(value, RANK * value[-1])) @ axes.T / np.outer(scales, scales)
    shift = q.jacobian @ shift @ q.jacobian.T * size**2
    cov = cov + rules.TRUST**2 * shift
    unseen = q.jacobian @ regression.unseen * UNSEEN * size
    half = regression.quantile**2 * cov + rules.MODEL_ERROR**2 * shift + unseen @ unseen.T
    allowed = widths(q, fit, size)
    core = [i for i, name in enumerate(q.names) if not name.startswith("stribeck")]
    names = [q.names[i] for i in core]
    refused = [
        rules.explain(*found, seen) for found in rules.directions(names, allowed, half[np.ix_(core, core)])
    ]
    out = {name for refusal in refused for name in refusal.quantities}
    core_out = out & set(rules.CORE)
    if len(core_out) > 1:
        first = next(refusal for refusal in refused if core_out & set(refusal.quantities))
        return DriveEstimate(joint, {}, (replace(first, quantities=asked),), picture)
    values: dict[str, Estimate] = {}
    for i, name in enumerate(q.names):
        if name in out:
            continue
        width = regression.quantile * math.sqrt(max(cov[i, i], 0.0))
        if name.startswith("stribeck") and ("coulomb_friction" in out or not curve_shown(q, cov, fit)):
            continue
        values[name] = estimate(name, float(q.value[i]), width)
    alpha = fit.value("alpha") if scale is None else 1.0
    if "torque_scale_error" in values and not 1 / (1 + LARGEST_SCALE) <= alpha <= 1 / (1 - LARGEST_SCALE):
        reason = f"the sensed torque would have to be multiplied by {alpha:.3g} to fit the command"
        motion = (
            "check sign and unit: tau is positive as in u = m q'' + v q' + friction + tau, link side, N m"
        )
        return DriveEstimate(joint, {}, (Refusal(asked, reason, motion),), picture)
    refused += _impossible(values)
    late = values.get("latency")
    if late is not None and late.high < -EARLY * fit.windows.period:
        del values["latency"]
        reason = f"comes out negative: {late.value:.2g} s"
        refused.append(Refusal(("latency",), reason, "check the time stamps and the sensor's delays"))
    if "stiffness" in asked:
        add_transmission(values, refused, fit, scale)
        refused += _impossible(values)
    return DriveEstimate(
        joint, {name: values[name] for name in UNITS if name in values}, tuple(refused), picture
    )


def _impossible(values: dict[str, Estimate]) -> list[Refusal]:
    """Takes out values that cannot be, and says so."""
    found = []
    for name in ("rotor_inertia", *NOT_NEGATIVE, "stiffness"):
        estimate = values.get(name)
        if estimate is not None and (estimate.high <= 0 or (name == "rotor_inertia" and estimate.low <= 0)):
            del values[name]
            found.append(
                Refusal(
                    (name,),
                    "comes out negative",
                    "check the signs of torque and motion, and whether the robot compensates friction itself",
                )
            )
    return found
