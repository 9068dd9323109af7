"""The table of docs/rivals.md: what every law needs, and whether it is certified on one drive.

``python -m dashpot.studies.laws`` prints it. The drive is joint 2 of the bundled fr3 with its stated
uncertainty, at 1 kHz; the virtual passive gains are the bundled controller's, the others' of the same size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import JointCertificate, certify_joint
from dashpot.certify.joint import uses
from dashpot.control.controller import ControllerConfig, Law, joint_block, load_controller
from dashpot.control.laws import law_from_table
from dashpot.control.sampled import POSITION, TORQUE, VELOCITY

JOINT = "joint2"
LOOP = {"kp": 2000.0, "kd": 60.0}
SAMPLES: Sequence[dict[str, object]] = (
    {"law": "off"},
    {"law": "static_feedback", "gain": 0.8},
    {"law": "rotor_observer", "damping": 4.0},
    {"law": "latched_torque"},
    {"law": "encoder_damping", "damping": 40.0},
    {"law": "pd", **LOOP},
    {"law": "pd_scaled", "R": 8.0, "kp": 250.0, "kd": 7.5},
    {"law": "pid", "ki": 4000.0, **LOOP},
    {"law": "pd_gravity", "payload": 2.0, **LOOP},
    {"law": "disturbance_observer", "cutoff": 3.0, **LOOP},
    {"law": "torque_feedback", **LOOP},
    {"law": "torque_feedback", "gain": 0.8, **LOOP},
    {"law": "inertia_shaping", "ratio": 0.25, **LOOP},
    {"law": "inertia_shaping", "ratio": 2.0, **LOOP},
)
HEAD = "| law | reads | model | index | worst | certified | without encoder |"


def samples() -> tuple[Drive, list[tuple[Law, ControllerConfig]]]:
    """The drive, and every law with the controller it is in."""
    bundled = load_controller("fr3")
    ours = next(law for law in bundled.joints if law.name == JOINT)
    laws = [ours, *(law_from_table({"name": JOINT, **table}) for table in SAMPLES)]
    robot = Robot.load("fr3")
    return robot.drives[robot.index(JOINT)], [(law, replace(bundled, joints=(law,))) for law in laws]


def needs(law: Law, drive: Drive, config: ControllerConfig) -> str:
    """The signals a law reads, in words."""
    block = joint_block(law, drive, config)
    read = ["torque"] if uses(block, TORQUE) else []
    read += ["encoder"] if uses(block, POSITION) or uses(block, VELOCITY) else []
    return ", ".join(read) or "nothing"


def rows() -> Iterator[str]:
    """The table, a Markdown row at a time."""
    yield HEAD
    yield "|" + "---|" * (HEAD.count("|") - 1)
    drive, laws = samples()
    for law, config in laws:
        found = certify_joint(drive, law, config)
        keys = {f.name for f in fields(law)}
        model = "rotor" if "rotor_inertia" in keys else "arm, payload" if "payload" in keys else "none"
        yield (
            f"| {_numbers(law)} | {needs(law, drive, config)} | {model} | {found.nominal.value:.3g} | "
            f"{found.box.worst.value:.3g} | {'yes' if found.certified else 'no'} | {_released(law, found)} |"
        )


def _numbers(law: Law) -> str:
    shown = [
        f"{f.name} = {value:g}"
        for f in fields(law)
        if f.name != "name" and (value := getattr(law, f.name)) not in (None, f.default)
    ]
    return f"`{law.law}`" + (f" {', '.join(shown)}" if shown else "")


def _released(law: Law, found: JointCertificate) -> str:
    if law.brake:
        return "keeps it" if law.keeps_encoder else "as it is"
    if found.brake is None:
        return "-"
    if found.brake.proven:
        return f"certified, {found.brake.worst.value:.3g}"
    return "holds its torque" if "constant torque" in found.brake.reason else "no"


if __name__ == "__main__":
    for row in rows():
        print(row)
