"""Exported C: equal to the controller in Python to the bit, under sanitizers, whatever it is fed."""

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dashpot._native as _native
from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_arm
from dashpot.control.controller import Controller, ControllerConfig
from dashpot.control.jointlaw import JointGains
from dashpot.control.laws import LAWS
from dashpot.errors import InputError
from dashpot.export.c import Export
from dashpot.export.compiler import compiler
from dashpot.export.names import TAKEN, c_name
from dashpot.export.selfcheck import controller_hash
from dashpot.export.source import core_texts
from dashpot.export.summary import digest, plain, verdict
from dashpot.export.tables import c_double
from dashpot.studies.export import FUSED, GUARD, unguarded
from dashpot.studies.export_cases import (
    BUNDLED,
    SANITIZED,
    STRICT,
    all_laws,
    build,
    bundled,
    compiled,
    differing,
    in_python,
    script,
    write_sources,
)

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")
JOINT = {
    "rotor_inertia": 0.05,
    "viscous_friction": 0.6,
    "stiffness": 6e3,
    "damping": 0.7,
    "torque_limit": 40.0,
}


def one_joint(name="joint1", **changes):
    """A certified controller of one joint."""
    drive = Drive(name=name, **(JOINT | changes))
    law = JointGains(name=name, R=3.0, D=3.0)
    return Robot("bench", (drive,)), ControllerConfig(joints=(law,), period=0.005)


def random_arm():
    """16 joints with gains, latencies of two ticks, rate limits and drives at random; seed 7."""
    rng = np.random.default_rng(7)
    drives, laws = [], []
    for i in range(_native.MAX_JOINTS):
        values = {key: value * 10 ** rng.uniform(-1, 1) for key, value in JOINT.items()}
        rate = {"torque_rate_limit": 10 ** rng.uniform(2, 5)} if i % 2 else {}
        drives.append(Drive(name=f"j{i}", **values, **rate))
        R, D, K, kp, kd = 10 ** rng.uniform([-0.5, 0, -1, 0, -1], [1, 1.5, 2, 3, 1.5])
        laws.append(JointGains(name=f"j{i}", R=R, D=D, K=K * (i % 3 > 0), kp=kp, kd=kd))
    config = ControllerConfig(
        joints=tuple(laws), period=0.002, latency=2, form="explicit" if rng.random() < 0.5 else "implicit"
    )
    return Export("random", Robot("random", tuple(drives)), config)


@pytest.mark.filterwarnings("ignore::dashpot.errors.InputWarning")
@pytest.mark.parametrize(
    ("export", "ticks"),
    [
        (lambda: all_laws(), 80_000),  # 13 joints: a million samples
        (lambda: all_laws(16, "explicit"), 5_000),
        (lambda: all_laws(2, supervised=True), 8_000),
        (random_arm, 5_000),
        *((lambda names=names: bundled(*names), 5_000) for names in BUNDLED),
        (lambda: bundled("iiwa14", "iiwa14", supervised=True), 8_000),
    ],
    ids=[
        "laws",
        "latest",
        "laws-supervised",
        "random",
        *(names[1] for names in BUNDLED),
        "iiwa14-supervised",
    ],
)
def test_equal_to_python(export, ticks, tmp_path):
    export = export()
    rows = script(export, ticks, seed=1)
    expected = in_python(export, rows)
    found = compiled(build(export, tmp_path, ("-O1",)), export, rows)
    assert found is not None, "the export's own check fails"
    assert len(found) == ticks
    assert differing(found, expected) == 0
    bits = np.bitwise_or.reduce(expected[:, -2].astype(int))
    assert bits & 13 == 13  # limits, broken inputs and blending all happened
    if export.settings is not None:
        assert {0, 1, 2, 7} <= set(expected[:, -1])  # every state, the last with the mechanical brake closed


def test_every_law_is_exported():
    assert len(all_laws().blocks) == len(LAWS)
    assert {law.law for law in all_laws().config.joints} == set(LAWS)


@pytest.mark.parametrize("supervised", [False, True])
def test_sanitizers_find_nothing(supervised, tmp_path):
    export = (
        all_laws(3, supervised=supervised)
        if not supervised
        else bundled("k807", "k807-wrist", supervised=True)
    )
    rows = script(export, 3_000, seed=2)
    found = compiled(build(export, tmp_path, ("-O0", *SANITIZED)), export, rows)
    assert found is not None
    assert differing(found, in_python(export, rows)) == 0


def has_fma():
    macros = subprocess.run(
        [*(compiler() or []), "-march=native", "-dM", "-E", "-"], input="", capture_output=True, text=True
    ).stdout
    return "__FP_FAST_FMA " in macros and "__GNUC__" in macros and "__clang__" not in macros


@pytest.mark.skipif(not has_fma(), reason="needs GCC on a processor with fused multiply-add")
def test_contraction_matters_and_is_kept_out(tmp_path):
    """Asked for, contraction changes bits, and the export's own check finds it; the pragma keeps it out."""
    export = bundled("fr3", "fr3")
    rows = script(export, 2_000, seed=3)
    found = compiled(build(export, tmp_path, FUSED), export, rows)
    assert found is not None
    assert differing(found, in_python(export, rows)) == 0
    assert GUARD in export.source()
    assert unguarded(export, tmp_path) == "found by the check"


def test_fast_math_is_refused(tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as caught:
        build(bundled("fr3", "fr3"), tmp_path, ("-ffast-math",))
    assert b"NaN" in caught.value.stderr


def test_check_notices_one_bit(tmp_path):
    """One unit in the last place of one coefficient, and the check says no."""
    export = bundled("k807", "k807-wrist")
    arguments = write_sources(export, tmp_path)
    source = tmp_path / "k807_wrist.c"
    number = re.search(r"\.C = \{(0x[^,}]+)", source.read_text())[1]
    other = float.hex(np.nextafter(float.fromhex(number), 0.0))
    source.write_text(source.read_text().replace(number, other, 1))
    program = tmp_path / "program"
    files = [str(source), str(tmp_path / "export_drive.c"), "-o", str(program)]
    subprocess.run([*(compiler() or []), "-std=c99", "-DHOST", *arguments, *files], check=True)
    assert compiled(program, export, script(export, 1, 0)) is None


def test_two_exports_in_one_program_and_in_cpp(tmp_path):
    """No clash of names, no library but memory functions, no variables; C++ reads the headers."""
    elf = pytest.importorskip("elftools.elf.elffile", reason="needs pyelftools: pip install 'dashpot[test]'")
    first, second = bundled("k807", "k807-wrist", supervised=True), bundled("fr3", "fr3", supervised=True)
    for export in (first, second):
        write_sources(export, tmp_path)
    calls = "".join(
        f"{{ static {n}_controller c; static {n}_supervisor s;\n"
        f"  bad |= {n}_check(&c) | {n}_supervisor_check(&s, &c);\n"
        f"  bad |= sizeof c != {size}; }}\n"
        for n, size in ((e.name, e.state_bytes) for e in (first, second))
    )
    main = tmp_path / "main.c"
    main.write_text(
        f'#include "k807_wrist.h"\n#include "fr3.h"\nint main(void) {{ int bad = 0;\n{calls}return bad; }}\n'
    )
    command = [*(compiler() or []), *STRICT, "-O1"]
    objects = []
    for name in ("k807_wrist", "fr3"):
        objects.append(tmp_path / f"{name}.o")
        freestanding = ["-ffreestanding", "-fno-stack-protector", "-c", tmp_path / f"{name}.c"]
        subprocess.run([*command, *freestanding, "-o", objects[-1]], check=True)
        if sys.platform != "linux":
            continue
        with objects[-1].open("rb") as file:
            read = elf.ELFFile(file)
            symbols = list(read.get_section_by_name(".symtab").iter_symbols())
            needed = {s.name for s in symbols if s["st_shndx"] == "SHN_UNDEF" and s.name}
            assert needed <= {"memset", "memcpy", "memmove", "memcmp", "_GLOBAL_OFFSET_TABLE_"}
            public = [
                s.name
                for s in symbols
                if s["st_info"]["bind"] == "STB_GLOBAL" and s["st_shndx"] != "SHN_UNDEF"
            ]
            assert all(symbol.startswith(f"{name}_") for symbol in public)
            assert all(s["sh_size"] == 0 for s in read.iter_sections() if s.name in (".data", ".bss"))
    subprocess.run([*command, main, *objects, "-o", tmp_path / "both"], check=True)
    assert subprocess.run([tmp_path / "both"], check=False).returncode == 0
    if shutil.which("c++"):
        cpp = ["c++", "-std=c++11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", "-x", "c++"]
        subprocess.run([*cpp, tmp_path / "fr3.h"], check=True)


def test_hostile_names_end_no_comment(tmp_path):
    robot, config = one_joint('*/ #error \\ ??/ "é" /* \u2028')
    build(Export("hostile", robot, config, certify_arm(robot, config)), tmp_path, ("-O0",))


@given(st.text())
def test_plain_text_ends_no_comment(text):
    said = plain(text)
    assert said.isascii()
    assert "".join(said.split("\n")) == said
    assert not re.search(r"\*/|/\*|\\|\?\?", said)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_read_back_to_the_bit(value):
    text = c_double(value)
    back = float.fromhex(text) if "0x" in text else float(text)
    assert back.hex() == value.hex()
    assert "0x" in text or "." in text or "e" in text  # a double, no integer


def test_infinity_is_a_constant_and_nan_none():
    assert c_double(float("inf")) == "UNLIMITED"
    with pytest.raises(ValueError):
        c_double(float("nan"))


@given(st.text(min_size=1, max_size=80))
def test_a_file_name_gives_an_identifier(name):
    made = c_name(Path("folder") / name.replace("/", "_").replace("\0", "_"))
    assert re.fullmatch(r"[a-z][a-z0-9_]*", made)
    assert len(made) <= 60
    assert made not in TAKEN
    assert c_name("x", made[:40]) == made[:40] or made[:40] in TAKEN


@pytest.mark.parametrize("name", ["", "A", "1a", "a-b", "int", "dp", "a" * 41, "é"])
def test_a_bad_name_is_refused(name):
    with pytest.raises(InputError, match="--name"):
        c_name("x.toml", name)


def test_the_header_says_what_is_proven():
    robot, config = one_joint()
    good = certify_arm(robot, config)
    assert verdict(good) == "CERTIFIED"
    text = Export("good", robot, config, good).header()
    assert " * CERTIFIED\n" in text
    assert "NOT CERTIFIED" not in text
    for number in (good.joints[0].nominal.value, good.joints[0].box.worst.value, good.joints[0].margin):
        assert f"{number:8.3g}" in text
    assert "period       0.005 s" in text
    assert "NOT CERTIFIED: no certificate was asked for" in Export("none", robot, config).header()
    weak = replace(config, joints=(JointGains(name="joint1", R=20.0, D=3.0, kp=60.0, kd=1.0),))
    bad = certify_arm(robot, weak)
    assert not bad.certified
    assert bad.joints[0].reason.split()[-1] in Export("bad", robot, weak, bad).header()
    assert "NOT CERTIFIED: joint1" in Export("bad", robot, weak, bad).header()
    file = bundled("fr3", "fr3").config.file
    assert digest(file) in bundled("fr3", "fr3").header()
    assert len(digest(file).split()[1]) == 64


def test_the_exported_block_is_the_certified_one():
    """Certificate, Python and export are given the same coefficients."""
    from dashpot.certify.certificate import paired
    from dashpot.control.controller import joint_block

    export = bundled("fr3", "fr3")
    for (drive, law), block in zip(
        paired(export.robot, export.config), export.controller.blocks, strict=True
    ):
        assert joint_block(law, drive, export.config) == block
    assert controller_hash(export.blocks) == controller_hash(export.controller.blocks)


def test_another_core_is_noticed(monkeypatch):
    """A change of the core that the export does not know stops it, rather than being left out."""
    text = _native.SOURCES["dashpot_core.c"].replace("int dp_init(", "int dp_initialise(")
    monkeypatch.setitem(_native.SOURCES, "dashpot_core.c", text)
    with pytest.raises(RuntimeError, match="core's text"):
        core_texts(3, 0)


def test_the_text_is_that_of_the_repository():
    native = Path(__file__).parent.parent / "native"
    for name, text in _native.SOURCES.items():
        assert text == (native / name).read_text(encoding="utf-8"), "rebuild: pip install -e ."
    assert isinstance(all_laws().controller, Controller)
