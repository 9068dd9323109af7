"""What the studio hands out is read back by the rest of dashpot as it was."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")

from dashpot.control.controller import load_controller
from dashpot.errors import InputError
from dashpot.logs import read_log
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.studio.files import as_bytes, recording, replay_html, saved_controller, written_log
from dashpot.studio.panels.record import FORMATS
from dashpot.studio.session import Session


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    found = Session("k807", "k807-wrist", certify=False)
    found.move(0.3)
    found.step(3.0)
    yield found
    found.close()


def test_nothing_is_handed_out_before_something_has_moved() -> None:
    still = Session("k807", "k807-wrist", certify=False)
    try:
        with pytest.raises(InputError, match="nothing has been simulated"):
            recording(still)
    finally:
        still.close()


def test_recording(session: Session, tmp_path: Path) -> None:
    file = tmp_path / "recording.npz"
    file.write_bytes(as_bytes(recording(session).save, file.name))
    back, past = Recording.load(file), session.past()
    assert back.joints == session.robot.joints
    np.testing.assert_array_equal(back.time, past.time)
    np.testing.assert_array_equal(back.reference, past.reference)
    for channel in CHANNELS:
        np.testing.assert_array_equal(getattr(back, channel), past.channel(channel), err_msg=channel)


@pytest.mark.parametrize("suffix", FORMATS)
def test_log_for_identify(session: Session, tmp_path: Path, suffix: str) -> None:
    """Torque, command and position of the controlled joints, every tick but the last, as `simulate --log`."""
    file = tmp_path / f"log.{suffix}"
    file.write_bytes(as_bytes(lambda path: written_log(session, path), file.name))
    sampling = session.config.sampling
    log, past = read_log(file, sampling=sampling), session.past()
    (segment,) = log.segments
    assert log.sampling == sampling
    assert len(segment.time) == len(past.time) - 1
    for law in session.config.joints:
        i, j = log.joints.index(law.name), session.robot.index(law.name)
        for values, channel in (
            (segment.torque, "sample"),
            (segment.command, "command"),
            (segment.position, "position"),
        ):
            assert values is not None
            np.testing.assert_allclose(values[:, i], past.channel(channel)[:-1, j], rtol=1e-6, atol=1e-9)


def test_controller(session: Session, tmp_path: Path) -> None:
    session.edit("joint6", R=7.5, D=3.25)
    file = tmp_path / "controller.toml"
    session.set_payload(2.0, 0.1)
    text = saved_controller(session)
    assert "k807" in text
    assert "carried 2 kg at (0.1, 0, 0) m" in text
    file.write_text(text)
    back = load_controller(file)
    assert back.joints == session.config.joints
    for key in ("period", "latency", "latency_max", "sampling", "form", "blend"):
        assert getattr(back, key) == getattr(session.config, key), key


def test_replay_needs_no_network(session: Session) -> None:
    page = replay_html(session, 1.0)
    assert page.lstrip().lower().startswith("<!doctype html")
    assert not re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="(?!data:)https?:', page)
