"""A controller as an FMU for co-simulation, FMI 3.0 or 2.0, with its sources and the binary of this machine.

The FMU runs the exported C (`dashpot.export.c`) at start + k period, whatever the communication steps: a tick
reads the inputs set before the step in which it falls, and its torques can be read after that step.
"""

from __future__ import annotations

import hashlib
import html
import uuid
import zipfile
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

from dashpot.export.c import Export
from dashpot.export.compiler import build_library, platform_tuple
from dashpot.export.description import Version, build_description, model_description
from dashpot.export.summary import lines

DATE = (1980, 1, 1, 0, 0, 0)  # the same bytes every time


def fmu_files(export: Export, version: Version) -> dict[str, bytes]:
    """What is in the FMU but for its binary, path -> bytes."""
    name, layer = export.name, f"fmi{version}.c"
    sources = {f"{name}.c": export.source(), f"{name}.h": export.header()}
    for file in (layer, "fmi.h", "model.h"):
        sources[file] = (files("dashpot") / "export" / "fmi" / file).read_text(encoding="utf-8")
    content = hashlib.sha256("".join(sources.values()).encode()).hexdigest()
    token = f"{{{uuid.UUID(content[:32])}}}"
    sources["config.h"] = _config(export, token)
    found = {f"sources/{file}": text.encode() for file, text in sources.items()}
    found["modelDescription.xml"] = model_description(export, version, token)
    if version == 3:
        found["sources/buildDescription.xml"] = build_description(export)
    found["documentation/index.html"] = _documentation(export).encode()
    return dict(sorted(found.items(), key=lambda item: (item[0] != "modelDescription.xml", item[0])))


def write_fmu(export: Export, path: Path, version: Version = 3, *, binary: bool = True) -> str | None:
    """Writes the FMU.

    Args:
        export: What goes in.
        path: Of the file.
        version: Of FMI: 2 or 3.
        binary: Whether to compile for this machine; without, the importing tool must compile the sources.

    Returns:
        The platform compiled for, as the FMU names it, or None: sources alone.

    Raises:
        InputError: There is no C compiler, or it fails.
    """
    content, place = fmu_files(export, version), _place(version)
    compiled = None
    if binary and place is not None:
        with TemporaryDirectory() as folder:
            for name, text in content.items():
                if name.startswith("sources/"):
                    (Path(folder) / Path(name).name).write_bytes(text)
            library = Path(folder) / f"library.{place[1]}"
            build_library([Path(folder) / f"{export.name}.c", Path(folder) / f"fmi{version}.c"], library)
            content[f"binaries/{place[0]}/{export.name}.{place[1]}"] = library.read_bytes()
        compiled = place[0]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, data)
    return compiled


def _place(version: Version) -> tuple[str, str] | None:
    """Folder of this machine's binary, and its ending."""
    known = platform_tuple()
    if known is None:
        return None
    folder = known[0] if version == 3 else known[1]
    return None if folder is None else (folder, known[2])


def _config(export: Export, token: str) -> str:
    upper = export.name.upper()
    supervised = f"#define SUPERVISED\n#define WHY_OPERATOR {upper}_WHY_OPERATOR\n" if export.settings else ""
    return (
        f"/* What makes the FMU one of {export.name}. */\n"
        f'#include "{export.name}.h"\n\n'
        f'#define FMU_TOKEN "{token}"\n'
        f"#define F(name) {export.name}_##name\n"
        f"#define N {upper}_JOINTS\n#define PERIOD {upper}_PERIOD\n{supervised}"
    )


def _documentation(export: Export) -> str:
    said = "\n".join(lines(export.robot, export.config, export.controller, export.certificate))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n'
        f'<head><meta charset="utf-8"><title>{export.name}</title></head>\n'
        f"<body>\n<pre>\n{html.escape(said)}\n</pre>\n"
        f"<p>Ticks are at start + k {export.config.period!r} s, whatever the communication steps. A tick "
        "reads the inputs set before the step in which it falls; its torques can be read after that step. "
        "Steps of a part of the period keep that delay small.</p>\n</body>\n</html>\n"
    )
