"""A joint that is released, and what a sampled joint shows at its port: two figures of docs/vpc.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.certify.exact import at_rest
from dashpot.certify.index import passivity_index, settled
from dashpot.certify.joint import Scales, sampled_joint
from dashpot.certify.plots import damping_ratio
from dashpot.control.controller import ControllerConfig, JointGains, joint_block
from dashpot.control.energy import EnergyMeter
from dashpot.paper.setup import AMPLITUDE, PERIOD, RELEASE, setup
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trajectory import multisine
from dashpot.support.arrays import Floats
from dashpot.support.plots import BLACK, BLUE, GREEN, GREY, VERMILLION, Figure, new_figure

JOINT, LOAD = "joint7", 10  # lb
SHOWN = (-0.1, 0.5)  # [s] around the release

DRIVE = Drive(
    "joint",
    rotor_inertia=0.05,
    viscous_friction=0.6,
    stiffness=6e3,
    damping=0.7,
    torque_limit=40.0,
)
"""A wrist drive as in the paper's arm, about."""
CASES = (
    ("R = 3, D = 3, explicit", 3.0, 3.0, "explicit", "-", GREEN),
    ("R = 10, D = 3, explicit", 10.0, 3.0, "explicit", "--", VERMILLION),
    ("R = 10, D = 3, implicit", 10.0, 3.0, "implicit", "-.", BLUE),
)
SPRING = 1.0  # [N m/rad], K
INERTIAS = np.geomspace(7e-3, 10.0, 300)  # [kg m^2]


@dataclass(frozen=True)
class Release:
    """Joint 7 from shortly before its position offset is removed.

    Attributes:
        time: After the release, (k,) [s].
        angle: Of the link, moved since then, with the law, (k,) [rad].
        free: The same without the law, (k,) [rad].
        sensed: Torque samples, (k,) [N m].
        motor: Torque in effect, (k,) [N m].
        given: Energy that has come in through the flange since then, (k,) [J].
        taken: Energy that the motor has taken out, (k,) [J].
        rubbed: Energy that the rotor's friction has taken, (k,) [J].
    """

    time: Floats
    angle: Floats
    free: Floats
    sensed: Floats
    motor: Floats
    given: Floats
    taken: Floats
    rubbed: Floats


def release() -> Release:
    """Simulates the paper's experiment with 10 lb, seed 0, with and without the law on joint 7."""
    s = setup()
    j = s.robot.index(JOINT)
    path = multisine(s.robot.home, RELEASE + 1.0, PERIOD, 0, amplitude=AMPLITUDE, peak_speed_at={j: RELEASE})
    cut = Event(RELEASE, JOINT, "position_loop", False)
    bypass = Event(path.start, JOINT, "mode", "bypass")
    found = run(Scenario(s.plants[LOAD], s.controller(), path, [cut]))
    without = run(Scenario(s.plants[LOAD], s.controller(), path, [bypass, cut]))
    meter = EnergyMeter(s.robot.drives, s.config)
    before = np.vstack([np.zeros_like(found.in_effect[:1]), found.in_effect[:-1]])
    energy = meter.update(found.sample, found.position, found.velocity, before)
    at = int(np.searchsorted(found.time, RELEASE - 1e-9))
    chosen = slice(at + round(SHOWN[0] / PERIOD), at + round(SHOWN[1] / PERIOD) + 1)

    def since(values: Floats) -> Floats:
        return np.asarray(values[chosen, j] - values[at, j])

    return Release(
        found.time[chosen] - RELEASE,
        since(found.link_position),
        since(without.link_position),
        found.sample[chosen, j],
        before[chosen, j],
        -since(energy["energy_port"]),
        -since(energy["energy_motor"]),
        since(energy["energy_dissipated"]),
    )


def draw_release() -> Figure:
    """Angle, torques and energy around the release."""
    found = release()
    figure, axes = new_figure(1, 3, 11.0, 3.5)
    left, middle, right = axes[0]
    left.plot(found.time, np.degrees(found.angle), color=BLUE, lw=2, label="with the law")
    left.plot(found.time, np.degrees(found.free), "--", color=VERMILLION, label="without: it falls")
    left.set_ylabel("joint 7, moved since then [deg]")
    left.set_title("It stops")
    middle.plot(found.time, found.sensed, color=VERMILLION, label=r"sensed torque $\tau_s$")
    middle.plot(found.time, found.motor, "--", color=BLUE, lw=1.8, label="motor torque $u$")
    middle.set_ylabel("torque [N m]")
    middle.set_title("The motor answers the sensor")
    after = found.time >= 0
    time = found.time[after]
    right.plot(time, found.given[after], color=BLACK, label="came in through the flange")
    right.plot(time, found.taken[after], "--", color=BLUE, lw=2, label="taken out by the motor")
    right.plot(time, found.rubbed[after], "-.", color=GREEN, label="taken by the rotor's friction")
    right.set_ylabel("energy since then [J]")
    right.set_title("It takes the energy out")
    for axis in axes[0]:
        axis.axvline(0, color=GREY, lw=0.8)
        axis.set_xlabel("time after the release [s]")
        axis.set_xlim(*SHOWN)
        axis.legend(fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    figure.suptitle("Joint 7 of the k807 with 10 lb at 0.23 m: its position loop is cut at 0 s")
    return figure


def _config(form: str) -> ControllerConfig:
    gains = JointGains("joint", R=3.0, D=3.0, K=SPRING, kp=0.0, kd=0.0)
    return ControllerConfig((gains,), period=PERIOD, sampling="average", form=form)  # type: ignore[arg-type]


def draw_port() -> Figure:
    """Damping at the port over frequency, and the damping of a free load over its inertia."""
    figure, axes = new_figure(1, 2, 11.0, 4.0)
    left, right = axes[0]
    angles = np.linspace(1e-2, np.pi, 400)
    for label, R, D, form, dash, color in CASES:
        config = _config(form)
        block = joint_block(JointGains("joint", R=R, D=D, K=SPRING, kp=0.0, kd=0.0), DRIVE, config)
        joint = sampled_joint(DRIVE, block, "average", PERIOD, Scales())
        damping = settled(joint, at_rest(joint), 16).least_damping(angles)
        index = passivity_index(DRIVE, block, "average", PERIOD).value
        said = f"{label}: index {index:.2g}"
        left.plot(angles / (2 * np.pi * PERIOD), damping, dash, color=color, lw=2, label=said)
        ratio, _ = damping_ratio(DRIVE, block, config, INERTIAS, Scales())
        right.plot(INERTIAS, ratio, dash, color=color, lw=2, label=label)
    for axis, words, low, high in (
        (left, "gives out energy", -0.65, 0.85),
        (right, "oscillates", -0.035, 0.25),
    ):
        axis.axhspan(low, 0, color=VERMILLION, alpha=0.12, lw=0)
        axis.axhline(0, color=BLACK, lw=0.8)
        axis.set_ylim(low, high)
        axis.text(0.02, 0.02, words, transform=axis.transAxes, color=VERMILLION, va="bottom")
        axis.legend(fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    left.set(xlabel="frequency of the motion at the port [Hz]", ylabel="damping at the port [N m s/rad]")
    left.set_xlim(0, 0.5 / PERIOD)
    left.set_title("The sampled joint by itself")
    right.set(xlabel=r"inertia on the joint [kg m$^2$]", ylabel="damping ratio [-]")
    right.set_xscale("log")
    right.set_xlim(INERTIAS[0], INERTIAS[-1])
    right.set_title("With a free load: least damped oscillation")
    figure.suptitle("One joint at 200 Hz, m = 0.05 kg m$^2$, v = 0.6 N m s/rad, K = 1 N m/rad")
    return figure
