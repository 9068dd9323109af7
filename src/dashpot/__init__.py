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
    "Controller": "controller",
    "ControllerConfig": "controller",
    "JointGains": "controller",
    "load_controller": "controller",
    "Drive": "drive",
    "DashpotError": "errors",
    "InputError": "errors",
    "InputWarning": "errors",
    "ModelError": "errors",
    "Spec": "design.spec",
    "design_arm": "design.design",
    "identify_joint": "identify",
    "Fault": "faults",
    "TorqueFeedbackLaw": "law",
    "LAWS": "laws",
    "Law": "jointlaw",
    "VirtualNetwork": "network",
    "Payload": "payload",
    "Plant": "plant",
    "build": "plant",
    "Recording": "recording",
    "Robot": "robot",
    "Event": "simulate",
    "PayloadChange": "simulate",
    "Scenario": "simulate",
    "run": "simulate",
    "run_many": "simulate",
    "Trajectory": "trajectory",
    "hold": "trajectory",
    "multisine": "trajectory",
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
