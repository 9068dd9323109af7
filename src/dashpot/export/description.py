"""``modelDescription.xml`` and ``buildDescription.xml`` of an exported FMU, FMI 3.0 and 2.0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from dashpot import __version__
from dashpot.export.c import Export

Version = Literal[2, 3]
UNITS = {
    "s": {"s": 1},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
}
MODES = ("off", "bypass", "active")
STATES = ("track", "torque_brake", "encoder_brake", "safe")
JOINTS = 16  # value references of FMI 2.0 leave room for so many


@dataclass(frozen=True)
class Group:
    """A variable of the FMU with one value per joint, or one for the arm.

    Attributes:
        number: Its place in ``fmi/model.h``.
        name: In the model description.
        kind: Float64, Int32, Boolean, or the name of an enumeration.
        unit: Or None.
        words: Description.
        start: Start value of an input; None: an output.
        single: One for the arm.
    """

    number: int
    name: str
    kind: str
    unit: str | None
    words: str
    start: str | None
    single: bool = False


INPUTS = (
    Group(0, "torque", "Float64", "N.m", "sensed joint torque, rotor to link", "0"),
    Group(1, "position", "Float64", "rad", "joint angle", "0"),
    Group(2, "velocity", "Float64", "rad/s", "joint velocity", "0"),
    Group(3, "position_ref", "Float64", "rad", "reference of the joint angle", "0"),
    Group(4, "velocity_ref", "Float64", "rad/s", "reference of the joint velocity", "0"),
    Group(5, "acceleration_ref", "Float64", "rad/s2", "reference of the joint acceleration", "0"),
    Group(6, "torque_ref", "Float64", "N.m", "torque added to the position loop's", "0"),
)
FREE = (
    Group(7, "mode", "Mode", None, "off: no torque; bypass: position loop alone; active: the law", "2"),
    Group(8, "position_loop", "Boolean", None, "false: the encoder is not read at all", "true"),
    Group(
        9,
        "warm_start",
        "Boolean",
        None,
        "where it becomes true, the brake starts from the input velocity",
        "false",
    ),
)
SUPERVISED = (
    Group(10, "torque_age", "Int32", None, "ticks since the last fresh torque sample, 0: fresh", "0"),
    Group(11, "encoder_age", "Int32", None, "ticks since the last fresh encoder sample, 0: fresh", "0"),
    Group(12, "stop", "Boolean", None, "true asks for a stop", "false", True),
)
OUTPUTS = (
    Group(13, "command", "Float64", "N.m", "motor torque to command", None),
    Group(14, "status", "Int32", None, "1 torque limit, 2 rate limit, 4 not finite, 8 blending; or-ed", None),
)
WATCHED = (
    Group(15, "state", "State", None, "of the supervisor; each is worse than the one before", None, True),
    Group(16, "apply_brake", "Boolean", None, "true: the mechanical brake must close", None, True),
)


def groups(export: Export) -> tuple[Group, ...]:
    """The variables an FMU of this controller has."""
    if export.settings is None:
        return (*INPUTS, *FREE, *OUTPUTS)
    return (*INPUTS, *SUPERVISED, *OUTPUTS, *WATCHED)


def model_description(export: Export, version: Version, token: str) -> bytes:
    """Text of ``modelDescription.xml``."""
    about = {
        "modelName": export.name,
        "description": f"Joint controller of {export.robot.name}; certificate: documentation/index.html",
        "generationTool": f"dashpot {__version__}",
    }
    step = repr(export.config.period)
    can = {"modelIdentifier": export.name, "canHandleVariableCommunicationStepSize": "true"}
    if version == 3:
        root = ElementTree.Element(
            "fmiModelDescription", {"fmiVersion": "3.0", **about, "instantiationToken": token}
        )
        can |= {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true", "fixedInternalStepSize": step}
        ElementTree.SubElement(root, "CoSimulation", can)
    else:
        naming = {"guid": token, "variableNamingConvention": "structured", "numberOfEventIndicators": "0"}
        root = ElementTree.Element("fmiModelDescription", {"fmiVersion": "2.0", **about, **naming})
        can |= {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
        can |= {"canNotUseMemoryManagementFunctions": "true"}
        files = ElementTree.SubElement(ElementTree.SubElement(root, "CoSimulation", can), "SourceFiles")
        for name in (f"{export.name}.c", "fmi2.c"):
            ElementTree.SubElement(files, "File", name=name)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for name, exponents in UNITS.items():
        unit = ElementTree.SubElement(units, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents.items()})
    _types(root, export, version)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=step)
    variables = ElementTree.SubElement(root, "ModelVariables")
    outputs = list((_variables_3 if version == 3 else _variables_2)(variables, export))
    structure = ElementTree.SubElement(root, "ModelStructure")
    if version == 3:
        for element in ("Output", "InitialUnknown"):
            for reference in outputs:
                ElementTree.SubElement(structure, element, valueReference=str(reference))
    else:
        for element in ("Outputs", "InitialUnknowns"):
            part = ElementTree.SubElement(structure, element)
            for reference in outputs:
                ElementTree.SubElement(part, "Unknown", index=str(reference))
    return _text(root)


def build_description(export: Export) -> bytes:
    """Text of ``sources/buildDescription.xml``, FMI 3.0."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=export.name)
    files = ElementTree.SubElement(build, "SourceFileSet", language="C99")
    for name in (f"{export.name}.c", "fmi3.c"):
        ElementTree.SubElement(files, "SourceFile", name=name)
    return _text(root)


def _types(root: ElementTree.Element, export: Export, version: Version) -> None:
    types = ElementTree.SubElement(root, "TypeDefinitions")
    name, items = ("Mode", MODES) if export.settings is None else ("State", STATES)
    if version == 3:
        listed = ElementTree.SubElement(types, "EnumerationType", name=name)
    else:
        listed = ElementTree.SubElement(ElementTree.SubElement(types, "SimpleType", name=name), "Enumeration")
    for value, item in enumerate(items):
        ElementTree.SubElement(listed, "Item", name=item, value=str(value))


def _variables_3(variables: ElementTree.Element, export: Export) -> Iterator[int]:
    """Arrays over the joints; gives the outputs' value references."""
    count, joints = len(export.blocks), ", ".join(export.controller.joints)
    time = {"name": "time", "valueReference": "0", "description": "simulation time", "unit": "s"}
    time |= {"causality": "independent", "variability": "continuous"}
    ElementTree.SubElement(variables, "Float64", time)
    for group in groups(export):
        words = group.words if group.single else f"{group.words}; {joints}"
        given = {"name": group.name, "valueReference": str(group.number + 1), "description": words}
        given |= _role(group)
        if group.start is not None:
            given["start"] = " ".join([group.start] * (1 if group.single else count))
        enumerated = group.kind in ("Mode", "State")
        given |= {"declaredType": group.kind} if enumerated else {}
        given |= {"unit": group.unit} if group.unit else {}
        element = ElementTree.SubElement(variables, "Enumeration" if enumerated else group.kind, given)
        if not group.single:
            ElementTree.SubElement(element, "Dimension", start=str(count))
        if group.start is None:
            yield group.number + 1


def _variables_2(variables: ElementTree.Element, export: Export) -> Iterator[int]:
    """One scalar per joint, counted from 1; gives the outputs' indices."""
    index = 0
    for group in groups(export):
        for j, joint in enumerate(export.controller.joints[: 1 if group.single else None]):
            index += 1
            given = {
                "name": group.name if group.single else f"{group.name}[{j + 1}]",
                "valueReference": str(JOINTS * group.number + j),
                "description": group.words if group.single else f"{joint}: {group.words}",
            }
            scalar = ElementTree.SubElement(variables, "ScalarVariable", given | _role(group))
            kind = {"Float64": "Real", "Int32": "Integer", "Boolean": "Boolean"}.get(
                group.kind, "Enumeration"
            )
            value = {"unit": group.unit} if group.unit else {}
            value |= {"declaredType": group.kind} if kind == "Enumeration" else {}
            value |= {"start": group.start} if group.start is not None else {}
            ElementTree.SubElement(scalar, kind, value)
            if group.start is None:
                yield index


def _role(group: Group) -> dict[str, str]:
    if group.start is not None:
        # Sampled at the ticks; yet "continuous", so that any continuous output may be connected.
        return {"causality": "input", "variability": "continuous" if group.kind == "Float64" else "discrete"}
    return {"causality": "output", "variability": "discrete", "initial": "calculated"}


def _text(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
