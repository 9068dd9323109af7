"""What the studio hands out: controller, recording, log, and a replay in 3D."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import dashpot
from dashpot.arm.payload import Payload
from dashpot.control.controller import ControllerConfig, JointGains
from dashpot.control.laws import to_table
from dashpot.design.quantities import GAINS
from dashpot.errors import InputError
from dashpot.logs import write_log
from dashpot.logs.log import from_recording
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.trajectory import Trajectory
from dashpot.studio.session import Session
from dashpot.support.tables import toml_value

FRAMES = 25  # of a replay [1/s]


def controller_toml(
    config: ControllerConfig, robot: str, verdicts: dict[str, str], payload: Payload | None = None
) -> str:
    """A controller file that `load_controller` reads back as it is.

    Args:
        config: The controller.
        robot: Name of the arm, for the comment.
        verdicts: Joint -> what is known of its certificate, for the comments.
        payload: What the arm carried, for the comment.
    """
    load = payload or Payload(0.0)
    carried = "nothing"
    if load.mass > 0:
        at = ", ".join(f"{float(part):g}" for part in load.position)
        carried = f"{load.mass:.4g} kg at ({at}) m on the flange"
    lines = [
        f"# Controller for {robot}, saved from the studio of dashpot {dashpot.__version__}.",
        f"# The arm carried {carried}.",
        "# What is certified is said per joint as it was known then; dashpot certify proves it again.",
        "",
        f"period = {toml_value(config.period)}  # s",
        f"latency = {config.latency}  # whole samples",
    ]
    if config.latency_max is not None:
        lines.append(f"latency_max = {config.latency_max}")
    lines += [
        f"sampling = {toml_value(config.sampling)}",
        f"form = {toml_value(config.form)}",
        f"blend = {toml_value(config.blend)}  # s",
    ]
    for law in config.joints:
        lines += ["", f"# {verdicts.get(law.name, 'not certified yet')}", "[[joint]]"]
        for key, item in to_table(law).items():
            unit = GAINS.get(key, "") if isinstance(law, JointGains) else ""
            lines.append(f"{key} = {toml_value(item)}" + (f"  # {unit}" if unit else ""))
    return "\n".join(lines) + "\n"


def saved_controller(session: Session) -> str:
    """The session's controller as TOML."""
    rows = session.certifier.margins() if session.certifier else []
    known = {row.joint: f"{row.verdict}, margin {row.index:.3g} N m s/rad" for row in rows}
    return controller_toml(session.config, session.robot.name, known, session.payload)


def recording(session: Session, seconds: float | None = None) -> Recording:
    """The last seconds [s] at every tick, or all that is remembered.

    Raises:
        InputError: Nothing has been simulated yet.
    """
    past = session.past(seconds)
    if len(past.time) < 2:
        raise InputError("nothing has been simulated yet; let the arm run", quantity="recording")
    settings: dict[str, object] = {
        "robot": session.robot.name,
        "period": session.config.period,
        "timestep": session.arm.plant.timestep,
        "seed": session.seed,
        "label": "studio",
    }
    if session.arm.carried:
        settings["gravity_compensation"] = True
    channels: dict[str, Any] = dict(zip(CHANNELS, past.record, strict=True))
    return Recording(
        session.robot.joints, past.time, past.reference, status=past.status, settings=settings, **channels
    )


def written_log(session: Session, path: Path) -> None:
    """Writes the last minute as a robot would have logged it; the suffix chooses the format.

    Raises:
        InputError: Nothing has been simulated yet, or the format is not known.
    """
    kept = recording(session)
    h = session.config.period
    rate = np.gradient(kept.reference, h, axis=0)
    followed = Trajectory(h, kept.reference, rate, np.gradient(rate, h, axis=0), float(kept.time[0]))
    log = from_recording(
        kept,
        session.config.sampling,
        drives=session.robot.drives,
        trajectory=followed,
        controlled=session.arm.controller.joints,
    )
    write_log(log, path)


def as_bytes(write: Callable[[Path], object], name: str) -> bytes:
    """What a function writes into a file."""
    with tempfile.TemporaryDirectory(prefix="dashpot-") as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


def replay_html(session: Session, seconds: float) -> str:
    """The last seconds [s] in 3D as one HTML file that needs no network.

    Raises:
        InputError: Nothing has been simulated yet.
    """
    kept = recording(session, seconds)
    every = max(1, round(1 / (FRAMES * session.config.period)))
    rows = kept.link_position[::every]
    model = session.arm.model
    rotor = session.arm.plant.rotor_qpos
    return rendered(model, rotor, rows[np.isfinite(rows).all(1)], every * session.config.period)


def rendered(model: Any, qpos: Any, angles: Any, period: float) -> str:
    """Poses (k, n) [rad] of an arm, shown one after another every `period` [s], as HTML."""
    from dashpot.studio.scene3d import ArmScene, look_at, stage
    from dashpot.studio.server import close_server, open_server

    server = open_server("127.0.0.1", 0)
    try:
        stage(server)
        look_at(server, model)
        scene, data = ArmScene(server, "/arm"), mujoco.MjData(model)
        scene.draw(model)
        film = server.get_scene_serializer()
        for pose in angles:
            data.qpos[qpos] = pose
            mujoco.mj_kinematics(model, data)
            scene.move(np.array(data.xpos), np.array(data.xquat))
            film.insert_sleep(period)
        return film.as_html()
    finally:
        close_server(server)
