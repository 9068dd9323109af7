"""``dashpot certify`` and ``dashpot map``."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import Certificate, JointCertificate, block_of, certify_arm, paired
from dashpot.certify.digest import digest
from dashpot.certify.testbench import hidden, write
from dashpot.commands.shared import file_names, progress
from dashpot.control.controller import ControllerConfig, JointGains, Law, gains_of, load_controller
from dashpot.errors import InputError, InputWarning
from dashpot.support.output import whole_folder

if TYPE_CHECKING:
    from dashpot.cli.design import Certify, Map

POINTS = 44  # of R and of D in the picture of a certificate
MOST_POINTS = 1000
OUT = Path("out/certify")


def certify(options: Certify) -> int:
    """``dashpot certify``; returns the exit status: 1 unless every joint is certified."""
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    pairs = paired(robot, config)
    if robot.model is not None and not robot.model.is_file():
        rule = "no such file; the certificate needs none, but dashpot simulate does"
        message = InputError(rule, file=robot.file, quantity="model", value=str(robot.model))
        warnings.warn(str(message), InputWarning, stacklevel=2)
    out = options.out or (None if options.json else OUT)
    with progress("certifying", len(pairs) * (1 if out is None else 2)) as advance:
        certificate = certify_arm(robot, config, advance)
        if out is not None:
            with whole_folder(out) as folder:
                files = file_names([joint.name for joint in certificate.joints])
                for joint, (drive, gains) in zip(certificate.joints, pairs, strict=True):
                    _keep(folder / files[joint.name], joint, drive, gains, config)
                    advance()
                (folder / "certificate.json").write_text(_json(certificate, pairs, config), encoding="utf-8")
    if options.json:
        print(_json(certificate, pairs, config))
    else:
        from dashpot.commands.certify_view import show

        show(certificate, pairs, options, out)
    return 0 if certificate.certified else 1


def map_gains(options: Map) -> int:
    """``dashpot map``: the picture of a certificate alone, finer."""
    from dashpot.certify.plots import draw_map, gain_map
    from dashpot.support.plots import save

    robot, config = Robot.load(options.robot), load_controller(options.controller)
    if not 2 <= options.points <= MOST_POINTS:
        raise InputError(f"must be 2 to {MOST_POINTS}", quantity="--points", value=options.points)
    pairs = paired(robot, config)
    known = [drive.name for drive, _ in pairs]
    for name in options.joint:
        if name not in known:
            raise InputError(
                f"not controlled; controlled: {', '.join(known)}", quantity="--joint", value=name
            )
    if options.joint or not any(isinstance(law, JointGains) for _, law in pairs):
        named = [pair for pair in pairs if not options.joint or pair[0].name in options.joint]
        chosen = [(drive, gains_of(law, file=config.file)) for drive, law in named]
    else:
        chosen = [(drive, law) for drive, law in pairs if isinstance(law, JointGains)]
    files = file_names(known)
    with progress("mapping", len(chosen)) as advance, whole_folder(options.out) as folder:
        for drive, gains in chosen:
            found = gain_map(drive, gains, config, options.points)
            np.savez_compressed(folder / f"{files[drive.name]}.npz", R=found.R, D=found.D, index=found.index)
            save(draw_map(found, drive, gains, config), folder / files[drive.name])
            advance()
    console = Console()
    for drive, _ in chosen:
        console.print(
            f"{drive.name}: {options.points} x {options.points} gains; open "
            f"{options.out / (files[drive.name] + '.png')}",
            highlight=False,
            markup=False,
        )
    mapped = {drive.name for drive, _ in chosen}
    for drive, law in pairs if not options.joint else ():
        if drive.name not in mapped:
            console.print(
                f'{drive.name}: law "{law.law}" has no R and D, no map', highlight=False, markup=False
            )
    return 0


def _keep(place: Path, joint: JointCertificate, drive: Drive, gains: Law, config: ControllerConfig) -> None:
    """Writes a joint's picture and the bench on which its counter-example runs."""
    from dashpot.certify.plots import draw
    from dashpot.support.plots import save

    save(draw(joint, drive, gains, config, POINTS), place)
    load = joint.counterexample
    if load is not None:
        shown = replace(drive, coulomb_friction=0.0) if hidden(drive, gains, load) else drive
        write(place, load.load, shown, gains, config, joint.point)


def _json(certificate: Certificate, pairs: list[tuple[Drive, Law]], config: ControllerConfig) -> str:
    """With the digest of what was certified, by which `dashpot run` knows it again."""
    blocks = np.array([block_of(drive, gains, config) for drive, gains in pairs])
    about = digest([drive for drive, _ in pairs], blocks, config)
    return json.dumps({"digest": about, **certificate.table()}, indent=2, allow_nan=False)
