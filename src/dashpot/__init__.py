"""dashpot: virtual passive control for torque-sensed robot joints.

The names below are imported on first use, so that ``import dashpot`` and ``dashpot --help`` stay fast. Type
checkers read ``__init__.pyi``, which has the same names. The version is that of the installed package:
pyproject.toml alone states it.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "certify_box": "certify.box",
    "certify_arm": "certify.certificate",
    "certify_joint": "certify.certificate",
    "passivity_index": "certify.index",
    "Controller": "control.controller",
    "ControllerConfig": "control.controller",
    "JointGains": "control.controller",
    "load_controller": "control.controller",
    "Drive": "arm.drive",
    "DashpotError": "errors",
    "InputError": "errors",
    "InputWarning": "errors",
    "ModelError": "errors",
    "Spec": "design.spec",
    "design_arm": "design.design",
    "identify_joint": "identify",
    "Fault": "simulation.faults",
    "TorqueFeedbackLaw": "control.law",
    "LAWS": "control.laws",
    "Law": "control.jointlaw",
    "VirtualNetwork": "control.network",
    "Payload": "arm.payload",
    "Plant": "arm.plant",
    "build": "arm.plant",
    "Recording": "simulation.recording",
    "Robot": "arm.robot",
    "Event": "simulation.simulate",
    "PayloadChange": "simulation.simulate",
    "Scenario": "simulation.simulate",
    "run": "simulation.simulate",
    "run_many": "simulation.simulate",
    "Trajectory": "simulation.trajectory",
    "hold": "simulation.trajectory",
    "multisine": "simulation.trajectory",
}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("dashpot")
    if name not in _HOMES:
        raise AttributeError(f"module 'dashpot' has no attribute {name!r}")
    return getattr(import_module(f"dashpot.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), "__version__", *_HOMES])
