"""The package as a user gets it: what it holds, that it builds and installs with what it declares, its types.

The environments that it is built and installed in hold links to what is installed here, and of that only what
the declared requirements bring along: nothing is fetched, and nothing of the tests is in reach.
"""

from __future__ import annotations

import ast
import email
import fcntl
import importlib.metadata
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import dashpot

ROOT = Path(__file__).parent.parent
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
VERSION = DECLARED["project"]["version"]
LARGEST = 1_000_000  # [bytes] of a source distribution


def needed(wanted: Iterable[str]) -> dict[str, importlib.metadata.Distribution]:
    """What requirements bring along, their own requirements included, as it is installed here."""
    found: dict[str, importlib.metadata.Distribution] = {}
    todo, seen = [(text, "") for text in wanted], set()
    while todo:
        text, extra = todo.pop()
        requirement = Requirement(text)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        distribution = importlib.metadata.distribution(requirement.name)
        found[requirement.name] = distribution
        for asked in {(requirement.name, name) for name in ("", *requirement.extras)} - seen:
            seen.add(asked)
            todo += [(line, asked[1]) for line in distribution.requires or ()]
    return found


def environment(folder: Path, wanted: Iterable[str]) -> Path:
    """Makes a virtual environment that holds what requirements bring along, and returns its interpreter."""
    venv.create(folder, symlinks=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    for distribution in needed(wanted).values():
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            if not (packages / top).exists():
                (packages / top).symlink_to(distribution.locate_file(top))
    return folder / "bin" / "python"


def called(*command: object, cwd: Path) -> str:
    """What a command prints; its complaint is the test's where it fails."""
    surroundings = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    surroundings["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # cmake and ninja
    done = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, check=False, cwd=cwd, env=surroundings
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def make(folder: Path) -> None:
    """Source distribution, the wheel from it, and an environment with the wheel and its requirements."""
    python = environment(folder / "tools", DECLARED["build-system"]["requires"])
    backend = f"import {DECLARED['build-system']['build-backend']} as backend; backend."
    called(python, "-c", f"{backend}build_sdist({str(folder)!r})", cwd=ROOT)
    with tarfile.open(folder / f"dashpot-{VERSION}.tar.gz") as archive:
        archive.extractall(folder, filter="data")
    settings = {"cmake.build-type": "Debug", "build-dir": str(folder / "build")}  # compiles faster,
    settings |= {
        f"cmake.define.CMAKE_{language}_FLAGS_DEBUG": "-O0" for language in ("C", "CXX")
    }  # no -g either
    source = folder / f"dashpot-{VERSION}"
    called(python, "-c", f"{backend}build_wheel({str(folder)!r}, {settings})", cwd=source)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        metadata = email.message_from_bytes(archive.read(f"dashpot-{VERSION}.dist-info/METADATA"))
    user = environment(folder / "user", metadata.get_all("Requires-Dist", []))
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", user)
    called(*pip, "install", "--quiet", "--no-index", "--no-deps", wheel, cwd=folder)
    called(*pip, "check", cwd=folder)


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `make`, made by the first of the processes that run the tests."""
    folder = tmp_path_factory.getbasetemp()
    folder = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "package"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "made").exists():
            make(folder)
            (folder / "made").touch()
    return folder


def files(folder: Path) -> set[str]:
    """Paths below a folder of the repository that are not made by running it."""
    found = {path.relative_to(ROOT).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {path for path in found if "__pycache__" not in path and not path.endswith(".so")}


def test_the_source_distribution_holds_what_builds_and_nothing_else(package):
    folders = set().union(*(files(ROOT / name) for name in ("licenses", "native", "src")))
    single = {"CHANGELOG.md", "CITATION.cff", "CMakeLists.txt", "LICENSE", "README.md", "pyproject.toml"}
    path = package / f"dashpot-{VERSION}.tar.gz"
    with tarfile.open(path) as archive:
        found = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    assert found == folders | single | {"PKG-INFO"}
    assert path.stat().st_size < LARGEST


def test_the_wheel_holds_the_package_one_native_module_and_every_licence(package):
    (path,) = package.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        found = {name: archive.read(name) for name in archive.namelist()}
    info = f"dashpot-{VERSION}.dist-info/"
    native = {name for name in found if name.endswith(".so")}
    assert {f"src/{name}" for name in found.keys() - native if not name.startswith(info)} == files(
        ROOT / "src"
    )
    assert [re.sub(r"\..*", "", name) for name in native] == ["dashpot/_native"]
    stable = sys.version_info >= (3, 12)
    assert ("-cp312-abi3-" in path.name) == stable == native.pop().endswith(".abi3.so")
    metadata = email.message_from_bytes(found[f"{info}METADATA"])
    assert metadata["Version"] == VERSION
    assert metadata["License-Expression"] == "MIT AND BSD-3-Clause"
    licences = ["LICENSE", *sorted(file.relative_to(ROOT).as_posix() for file in ROOT.glob("licenses/*"))]
    assert metadata.get_all("License-File") == licences
    assert all(found[f"{info}licenses/{name}"] == (ROOT / name).read_bytes() for name in licences)


def test_licences_are_those_of_what_is_linked():
    """nanobind is compiled into the native module, and brings a hash map along."""
    nanobind = importlib.metadata.distribution("nanobind")
    read = {str(file): file.locate() for file in nanobind.files or ()}
    (licence,) = (path for name, path in read.items() if name.endswith("dist-info/licenses/LICENSE"))
    assert (ROOT / "licenses" / "nanobind.txt").read_text() == Path(licence).read_text()
    (header,) = (path for name, path in read.items() if name.endswith("/robin_map.h"))
    words = Path(header).read_text().replace("*", " ").split()
    notice = (ROOT / "licenses" / "robin-map.txt").read_text().split()
    assert any(words[i : i + len(notice)] == notice for i in range(10))


def test_an_installation_without_extras_does_what_it_must(package):
    python = package / "user" / "bin" / "python"
    print(called(python, "-I", ROOT / "tests" / "smoke.py", "--bare", cwd=package))


def imported(path: Path) -> set[str]:
    """Top-level names that a module imports, anywhere in it."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.partition(".")[0] for name in names}


def test_what_is_imported_is_declared_and_not_only_brought_along():
    """By the extra that it belongs to, and bounded above; studies may use what the tests have."""
    lists = {"": DECLARED["project"]["dependencies"], **DECLARED["project"]["optional-dependencies"]}
    assert all("<" in line or line.startswith("dashpot[") for lines in lists.values() for line in lines)
    owners = {
        "pinocchio": ["pin"],
        "pylibfranka": ["pylibfranka"],
        **importlib.metadata.packages_distributions(),
    }
    for path in (ROOT / "src" / "dashpot").rglob("*.py"):
        extras = {"", "campaign", "franka", "logs", "studio"} | (
            {"test"} if "studies" in path.parts else set()
        )
        allowed = {canonicalize_name(Requirement(line).name) for extra in extras for line in lists[extra]}
        foreign = imported(path) - set(sys.stdlib_module_names) - {"dashpot"}
        owned = {name: set(map(canonicalize_name, owners.get(name, []))) for name in foreign}
        assert {name for name, owner in owned.items() if not allowed & owner} == set(), path


def test_the_version_is_stated_once():
    assert dashpot.__version__ == importlib.metadata.version("dashpot") == VERSION
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: *(.*)$", citation, re.MULTILINE) == [VERSION]
    headings = re.findall(r"^## \[(.*?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert headings[:2] == ["Unreleased", VERSION]
    places = [path for path in (ROOT / "src").rglob("*.py*") if path.suffix in (".py", ".pyi")]
    assert [path for path in places if f'"{VERSION}"' in path.read_text(encoding="utf-8")] == []


def test_type_checkers_and_python_know_the_same_names_from_the_same_modules():
    stub = ast.parse((ROOT / "src" / "dashpot" / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    typed = {alias.asname: f"{node.module}.{alias.name}" for node in imports for alias in node.names}
    assert typed == {name: f"dashpot.{home}.{name}" for name, home in dashpot._HOMES.items()}
    assert sorted(dashpot.__all__) == sorted(typed)


RIGHT = """
import numpy as np
import dashpot
from dashpot import Controller, Event, Payload, Robot, Scenario, build, load_controller, multisine, run
from dashpot.lanes import run_lanes

robot = Robot.load("fr3")
config = load_controller("fr3")
controller = Controller.from_config(config, robot.drives)
command = np.zeros(len(robot.drives))
controller.inputs.torque[:] = command
status: int = controller.step(command)
plant = build(robot, config.period, [Payload(1.0, 0.1)])
motion = multisine(robot.home, 1.0, config.period, seed=1)
scenario = Scenario(plant, controller, motion, [Event(0.5, "joint1", "position_loop", False)])
recordings = [run(scenario), *run_lanes([scenario])]
largest: float = max(float(np.abs(recording.position).max()) for recording in recordings)
print(status, largest, dashpot.__version__.split("."))
"""
WRONG = """
from dashpot import Controller, Payload, Robot, hold, load_controller
import dashpot

robot = Robot.load(3)  # arg-type
robot.drive  # attr-defined
config: int = load_controller("fr3")  # assignment
Payload("2 kg", 0.1)  # arg-type
hold(robot.home, 1.0)  # call-arg
dashpot.simulated  # attr-defined
dashpot.__version__ + 1  # operator
from dashpot import Robots  # attr-defined
"""


def test_a_users_program_is_checked_against_the_installed_types(package, tmp_path):
    names = "".join(f"reveal_type(dashpot.{name})\n" for name in dashpot.__all__)
    texts = {"right.py": RIGHT, "wrong.py": WRONG, "names.py": f"import dashpot\n{names}"}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "mypy.ini").write_text("[mypy]\nstrict = true\ncache_dir = cache\nerror_summary = false\n")
    python = ("--python-executable", package / "user" / "bin" / "python")
    mypy = [sys.executable, "-m", "mypy", *python, *texts]
    done = subprocess.run(mypy, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    found = [re.fullmatch(r"(\w+\.py):(\d+): (error|note): (.*)", line) for line in done.stdout.splitlines()]
    errors = {(m[1], int(m[2]), m[4].rpartition("[")[2].rstrip("]")) for m in found if m and m[3] == "error"}
    marked = {
        ("wrong.py", number, line.rpartition("# ")[2])
        for number, line in enumerate(WRONG.splitlines(), 1)
        if "# " in line
    }
    assert errors == marked, done.stdout
    revealed = {int(m[2]): m[4] for m in found if m and m[1] == "names.py"}
    assert sorted(revealed) == list(range(2, 2 + len(dashpot.__all__))), done.stdout
    assert [text for text in revealed.values() if re.search(r'is "(builtins\.)?(Any|object)"', text)] == []
