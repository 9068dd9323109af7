"""A Cortex-M in an emulator: exported controllers cross-compiled, run and measured without any hardware.

The compiler is that of the Python package ziglang (clang), the emulator unicorn (QEMU's instruction set
without peripherals): both come by pip. The emulator counts instructions. It has no pipeline, caches or flash:
cycles are not measured here, they are at best bracketed.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.export.c import Export
from dashpot.studies.export_cases import STRICT, write_sources
from dashpot.support.arrays import Floats
from dashpot.support.installing import install

FLASH, RAM, SCRIPT, RESULT = 0x08000000, 0x20000000, 0x60000000, 0x68000000
FLASH_SIZE, RAM_SIZE, BUFFER = 1 << 20, 1 << 17, 1 << 27
CORES = {"m7": "cortex_m7+fp_armv8d16", "m4f": "cortex_m4"}
"""Cortex-M7 with a double-precision unit; Cortex-M4F, whose doubles are software."""
LINK = f"""ENTRY(drive)
SECTIONS {{
    /DISCARD/ : {{ *(.ARM.*) *(.debug*) *(.comment) }}
    . = {FLASH:#x};
    .text : {{ KEEP(*(.text.start)) KEEP(*(.text.drive)) *(.text*) *(.rodata*) }}
    . = {RAM:#x};
    .data : {{ *(.data*) }}
    .bss : {{ *(.bss*) *(COMMON) }}
}}
"""


def available() -> str:
    """Why nothing can be run here; empty where it can."""
    from importlib.util import find_spec

    missing = [name for name in ("ziglang", "unicorn", "elftools") if find_spec(name) is None]
    return f"needs {', '.join(missing)}: {install('test')}" if missing else ""


@dataclass(frozen=True)
class Size:
    """Bytes of an exported controller on the target.

    Attributes:
        code: Instructions.
        constants: Coefficients and thresholds.
        variables: Must be 0.
    """

    code: int
    constants: int
    variables: int


def zig(*arguments: str) -> None:
    """Runs the cross-compiler.

    Raises:
        RuntimeError: It refuses; with its first line.
    """
    done = subprocess.run(
        [sys.executable, "-m", "ziglang", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip())


def build(export: Export, folder: Path, core: str = "m7", flags: tuple[str, ...] = ("-O2",)) -> Path:
    """Cross-compiles an export with `export_drive.c`; gives the linked image."""
    arguments = write_sources(export, folder)
    target = [
        "-target",
        "thumb-freestanding-eabihf",
        f"-mcpu={CORES[core]}",
        "-ffreestanding",
        "-fno-sanitize=all",
    ]
    target += ["-ffunction-sections"]
    objects = []
    for source in (f"{export.name}.c", "export_drive.c"):
        objects.append(str(folder / f"{Path(source).stem}.o"))
        zig("cc", *target, *STRICT, *flags, *arguments, "-c", str(folder / source), "-o", objects[-1])
    script, image = folder / "link.ld", folder / f"{core}.elf"
    script.write_text(LINK, encoding="ascii")
    if core == "m7":
        zig("ld.lld", "-T", str(script), *objects, "-o", str(image))
    else:  # with the run-time library for doubles in software
        zig(
            "cc",
            *target,
            *objects,
            f"-Wl,-T,{script}",
            "-Wl,-e,drive",
            "-Wl,--no-gc-sections",
            "-o",
            str(image),
        )
    return image


def size(folder: Path, export: Export) -> Size:
    """Sizes from the sections of the exported file's object."""
    from elftools.elf.elffile import ELFFile

    code = constants = variables = 0
    with (folder / f"{export.name}.o").open("rb") as file:
        for section in ELFFile(file).iter_sections():
            if not section["sh_flags"] & 2 or section.name.startswith(".ARM"):
                continue
            if section["sh_flags"] & 4:
                code += section["sh_size"]
            elif section["sh_flags"] & 1:
                variables += section["sh_size"]
            else:
                constants += section["sh_size"]
    return Size(code, constants, variables)


class Board:
    """The emulated processor with an image in its flash."""

    def __init__(self, image: Path, *, counting: bool = False) -> None:
        import unicorn
        from elftools.elf.elffile import ELFFile
        from unicorn.arm_const import UC_ARM_REG_C1_C0_2, UC_ARM_REG_FPEXC, UC_CPU_ARM_CORTEX_M7

        self.count = 0
        made: Any = unicorn  # types of its own it has none
        self.cpu: Any = made.Uc(made.UC_ARCH_ARM, made.UC_MODE_THUMB)
        self.cpu.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M7)
        for start, length in ((FLASH, FLASH_SIZE), (RAM, RAM_SIZE), (SCRIPT, BUFFER), (RESULT, BUFFER)):
            self.cpu.mem_map(start, length)
        with image.open("rb") as file:
            elf: Any = ELFFile(file)
            for segment in elf.iter_segments("PT_LOAD"):
                if segment["p_filesz"]:
                    self.cpu.mem_write(segment["p_vaddr"], segment.data())
            table = elf.get_section_by_name(".symtab")
            self.symbols = {symbol.name: symbol["st_value"] for symbol in table.iter_symbols()}
        self.cpu.reg_write(UC_ARM_REG_C1_C0_2, 0xF00000)  # the floating-point unit on
        self.cpu.reg_write(UC_ARM_REG_FPEXC, 0x40000000)
        if counting:
            self.cpu.hook_add(made.UC_HOOK_CODE, self._counted)

    def _counted(self, *_: object) -> None:
        self.count += 1

    def call(self, name: str, *arguments: int) -> int:
        """Calls a function of the image; gives what it returns."""
        from unicorn.arm_const import (
            UC_ARM_REG_LR,
            UC_ARM_REG_R0,
            UC_ARM_REG_R1,
            UC_ARM_REG_R2,
            UC_ARM_REG_SP,
        )

        for register, value in zip((UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2), arguments, strict=False):
            self.cpu.reg_write(register, value)
        end = FLASH + FLASH_SIZE - 16
        self.cpu.reg_write(UC_ARM_REG_SP, RAM + RAM_SIZE)
        self.cpu.reg_write(UC_ARM_REG_LR, end | 1)
        self.cpu.emu_start(self.symbols[name] | 1, end)
        return int(self.cpu.reg_read(UC_ARM_REG_R0))

    def run(self, rows: Floats, joints: int) -> Floats:
        """Runs a script of `export_cases.script`; (ticks, joints + 2)."""
        length = len(rows) * (joints + 2) * 8
        self.cpu.mem_write(SCRIPT, np.ascontiguousarray(rows).tobytes())
        self.call("drive", SCRIPT, RESULT, len(rows))
        return np.frombuffer(bytes(self.cpu.mem_read(RESULT, length))).reshape(len(rows), joints + 2)


def instructions(image: Path, rows: Floats, joints: int) -> list[int]:
    """Instructions of every tick of a script, the few of the loop around it included."""
    board = Board(image, counting=True)
    board.call("start")
    counts = []
    for row in rows:
        board.count = 0
        board.run(row[None], joints)
        counts.append(board.count)
    return counts
