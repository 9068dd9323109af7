"""`dashpot studio` as a command: what it needs, where it listens, and how it ends."""

from __future__ import annotations

import shlex
import signal
import socket
import subprocess
import sys
import time

import pytest

from dashpot.arm.robot import BUNDLED, Robot
from dashpot.cli.simulate import Studio
from dashpot.commands.studio import studio
from dashpot.control.controller import load_controller
from dashpot.errors import DashpotError, InputError
from dashpot.studio.choices import CONTROLLER_OF, controller_of

TELLS = "import sys; from dashpot.cli import main; main(sys.argv[1:])"


def test_without_viser_it_says_how_to_get_it_for_this_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(DashpotError) as said:
        studio(Studio())
    words = shlex.split(str(said.value).partition("viser: ")[2])
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    assert words[-1].endswith("[studio]")


def test_every_bundled_robot_has_a_controller_that_fits() -> None:
    assert set(CONTROLLER_OF) == set(BUNDLED)
    for name in BUNDLED:
        robot, config = Robot.load(name), load_controller(controller_of(name))
        covered = {law.name for law in config.joints}
        assert all(drive.name in covered or drive.servo is not None for drive in robot.drives)


def test_a_robot_of_ones_own_needs_its_controller() -> None:
    pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")
    with pytest.raises(InputError, match=r"CONTROLLER: is missing.*my_robot\.toml"):
        studio(Studio(robot="my_robot.toml"))


def test_an_address_that_is_not_ours_is_refused() -> None:
    pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")
    done = subprocess.run(
        [sys.executable, "-c", TELLS, "studio", "--host", "192.0.2.1"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "192.0.2.1" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="no signals")
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_with_one_word(number: signal.Signals, times: int) -> None:
    """Told to end while a proof is under way, once or twice: no process is left, no word of semaphores."""
    pytest.importorskip("viser", reason="pip install 'dashpot[studio]'")
    port = _free()
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", TELLS, "studio", "--port", str(port)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert process.stdout is not None
    assert str(port) in process.stdout.readline()
    time.sleep(1.0)
    for _ in range(times):
        process.send_signal(number)
        time.sleep(0.05)
    _, said = process.communicate(timeout=60)  # reaches its end only once no child holds the pipes
    assert process.returncode == 128 + number
    assert said == "dashpot: stopped\n"


def _free() -> int:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        return int(door.getsockname()[1])


def test_a_bad_flag_is_named() -> None:
    for flags, said in (
        (Studio(seed=-1), "--seed = -1: must be a whole number"),
        (Studio(payload=-1.0), r"--payload \[kg\] = -1.0: must be at least 0"),
        (Studio(offset=(1.0, 2.0)), r"--offset \[m\]"),
    ):
        with pytest.raises(InputError, match=said):
            studio(flags)
