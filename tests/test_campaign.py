"""Campaigns: every scenario is the one `run` gives, however it was run, stopped, killed or spread."""

from __future__ import annotations

import filecmp
import math
import os
import signal
import subprocess
import sys
import time
import warnings
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.campaign.cluster import connected
from dashpot.campaign.execute import execute
from dashpot.campaign.judge import judge, passed
from dashpot.campaign.measures import MEASURES, measure
from dashpot.campaign.scenario import FAILED, OK, Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, campaign_of, create, open_dataset, run_chunk
from dashpot.campaign.together import LANES, MUJOCO
from dashpot.cli import main
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import DashpotError, InputError
from dashpot.lanes import run_lanes
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trajectory import multisine

ROBOT = """
name = "one"
model = "one.xml"
home = [0.3]
[[joint]]
name = "joint"
rotor_inertia = 0.1
viscous_friction = 0.5
coulomb_friction = 0.3
stiffness = 1e3
damping = 0.5
torque_limit = 30.0
torque_noise = 0.01
"""
MODEL = """
<mujoco><compiler angle="radian"/>
<worldbody><body><joint name="joint" type="hinge" axis="0 1 0" range="-3 3" limited="true"/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>
"""
CONTROLLER = """
period = 0.005
[[joint]]
name = "joint"
R = 5.0
D = 8.0
kp = 60.0
kd = 4.0
"""
SPEC = """
robot = "one.toml"
controller = "law.toml"
duration = 0.4
amplitude = 0.1
release = 0.2
chunk = 6
[axes]
payload = [0.0, 0.2, 0.5]
gains.R = [0.8, 1.0]
seed = [1, 2, 3]
[requirements]
error_max_deg = [{ max = 20.0, quantile = 0.9 }, { max = 1e-6, where = { payload = 0.5 } }]
"""


@pytest.fixture
def spec(tmp_path):
    """A small campaign of 18 scenarios of one joint, and a way to change it."""
    for name, text in (("one.toml", ROBOT), ("one.xml", MODEL), ("law.toml", CONTROLLER)):
        (tmp_path / name).write_text(text)

    def write(change=lambda text: text):
        (tmp_path / "spec.toml").write_text(change(SPEC))
        return tmp_path / "spec.toml"

    write()
    return write


def finished(path, out, **how):
    campaign = Campaign(Spec.load(path))
    create(out, campaign)
    store = Store(out, campaign)
    execute(campaign, store, **{"workers": 0, **how})
    store.close()
    return out


def same_files(a: Path, b: Path) -> bool:
    """Whether two folders hold the same files with the same bytes."""
    files = [sorted(str(p.relative_to(root)) for p in root.rglob("*") if p.is_file()) for root in (a, b)]
    return files[0] == files[1] and not any(filecmp.cmpfiles(a, b, files[0], shallow=False)[1:])


def command(*arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-m", "dashpot", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.mark.parametrize("engine", ["auto", "mujoco"])
def test_the_dataset_holds_what_run_gives_for_hand_made_scenarios(spec, tmp_path, engine):
    text = f'engine = "{engine}"\n' + SPEC
    out = finished(spec(lambda _: text), tmp_path / "out.zarr")
    robot, config = Robot.load(tmp_path / "one.toml"), load_controller(tmp_path / "law.toml")
    path = multisine(robot.home, 0.4, config.period, 0, amplitude=0.1, lead_in=1.0)
    plant = build(robot, config.period, [Payload(0.2)])
    law = Controller.from_config(config, robot.drives)
    scenario = Scenario(plant, law, path, [Event(0.2, "all", "position_loop", False)], seed=3)
    recording = run(scenario) if engine == "mujoco" else run_lanes([scenario], width=2)[0]
    expected = measure(recording, 0.2, np.array([30.0]), ["joint"], np.array([np.inf]), np.array([1e3]))
    with open_dataset(out) as dataset:
        assert dataset.sizes == {"payload": 3, "gains_R": 2, "seed": 3, "joint": 1}
        one = dataset.sel(payload=0.2, gains_R=1.0, seed=3)
        for name, kind in MEASURES.items():
            np.testing.assert_array_equal(one[name].values, expected[name])
            assert dataset[name].attrs["units"] == kind.unit
        assert dataset["payload"].attrs["units"] == "kg"
        assert dataset.attrs["spec"] == text
        assert (dataset["engine"] == (MUJOCO if engine == "mujoco" else LANES)).all()
        assert (dataset["status"] == OK).all()
        assert int(one["scenario"]) == 11
    recording_error = (recording.reference - recording.link_position)[200:240]
    assert float(one["error_max"].values[0]) == np.abs(recording_error).max()


def test_order_and_workers_change_no_bit(spec, tmp_path):
    one = finished(spec(), tmp_path / "one.zarr")
    campaign = Campaign(Spec.load(spec()))
    create(tmp_path / "back.zarr", campaign)
    store = Store(tmp_path / "back.zarr", campaign)
    for chunk in reversed(store.pending()):
        store.commit(run_chunk(Campaign(Spec.load(spec())), chunk))
    store.close()
    assert same_files(one, tmp_path / "back.zarr")
    assert same_files(one, finished(spec(), tmp_path / "two.zarr", workers=2))


def test_a_killed_campaign_keeps_what_is_done_and_ends_the_same(spec, tmp_path):
    longer = spec(lambda text: text.replace("seed = [1, 2, 3]", f"seed = {list(range(36))}"))
    out, whole = tmp_path / "out.zarr", finished(longer, tmp_path / "whole.zarr")
    running = command("campaign", longer, "--out", out, "--workers", 2)
    end = time.monotonic() + 60
    while len(list((out / "status").rglob("*"))) < 14:  # some chunks are done
        assert time.monotonic() < end
        assert running.poll() is None
        time.sleep(0.005)
    running.kill()
    running.communicate()
    time.sleep(0.3)  # workers see that their parent is gone
    campaign = Campaign(Spec.load(longer))
    store = Store(out, campaign)
    rest, ran = store.pending(), []
    assert 0 < len(rest) < campaign.spec.chunks
    before = {p: p.stat().st_mtime_ns for p in (out / "status").rglob("*") if p.is_file()}
    execute(campaign, store, workers=0, advance=lambda block: ran.append(block.chunk))
    store.close()
    assert ran == rest
    assert all(p.stat().st_mtime_ns == then for p, then in before.items())  # none was written twice
    assert same_files(whole, out)


def test_a_stop_says_how_to_continue_and_a_second_writer_is_refused(spec, tmp_path):
    out = tmp_path / "out.zarr"
    longer = spec(lambda text: text.replace("seed = [1, 2, 3]", f"seed = {list(range(200))}"))
    running = command("campaign", longer, "--out", out, "--workers", 1)
    while not (out / "status" / "c").exists():
        assert running.poll() is None
        time.sleep(0.01)
    with pytest.raises(DashpotError, match="another campaign is writing"):
        Store(out, Campaign(Spec.load(longer)))
    begin = time.monotonic()
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=20)
    assert running.returncode == 130
    assert time.monotonic() - begin < 5
    assert "of 1200 scenarios are kept; the same command continues" in said
    assert "Traceback" not in said


def test_a_dask_cluster_that_loses_a_worker_loses_nothing(spec, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the cluster's own parts
        from distributed import LocalCluster

        path = spec(lambda text: text.replace("seed = [1, 2, 3]", f"seed = {list(range(18))}"))
        out = tmp_path / "dask.zarr"
        options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
        with LocalCluster(silence_logs=50, worker_dashboard_address=None, **options) as cluster:
            campaign, seen = Campaign(Spec.load(path)), []
            create(out, campaign)
            store = Store(out, campaign)

            def kill_one(block):
                seen.append(block.chunk)
                if len(seen) == 3:
                    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

            with connected(cluster.scheduler_address) as client:
                execute(campaign, store, client=client, advance=kill_one)
            store.close()
    assert sorted(seen) == list(range(campaign.spec.chunks))  # each once
    assert same_files(finished(path, tmp_path / "whole.zarr"), out)


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("foo", "must be tcp://HOST:PORT or tls://HOST:PORT"),
        ("tcp://10.0.0.1", "must be tcp://HOST:PORT"),
        ("tcp://10.0.0.1:99999", "must be tcp://HOST:PORT"),
        ("tcp://127.0.0.1:1", "nobody answers: Connection refused"),
    ],
)
def test_a_scheduler_that_is_not_there_leaves_no_dataset(spec, tmp_path, capsys, address, said):
    out = tmp_path / "out.zarr"
    with pytest.raises(SystemExit) as left:
        main(["campaign", str(spec()), "--scheduler", address, "--out", str(out)])
    err = capsys.readouterr().err
    assert left.value.code == 2
    assert err.startswith(f"dashpot: error: --scheduler = {address!r}: {said}")
    assert len(err.splitlines()) == 1
    assert not out.exists()


def test_another_campaign_is_not_mixed_in(spec, tmp_path, capsys):
    out = finished(spec(), tmp_path / "out.zarr")
    (tmp_path / "law.toml").write_text(CONTROLLER.replace("R = 5.0", "R = 6.0"))
    for arguments in (("campaign", spec(), "--out", out), ("replay", out, 0, "--out", tmp_path / "again")):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        said = capsys.readouterr().err
        assert left.value.code == 2
        assert "law.toml changed" in said
        assert len(said.splitlines()) == 1
    with pytest.raises(InputError, match="not the dataset"):
        open_dataset(tmp_path)
    with pytest.raises(InputError, match="no such dataset"):
        open_dataset(tmp_path / "nowhere")


def test_an_index_that_is_none_is_named(spec, tmp_path, capsys):
    out = finished(spec(), tmp_path / "out.zarr")
    with pytest.raises(SystemExit):
        main(["replay", str(out), "-1"])
    assert capsys.readouterr().err.startswith(
        "dashpot: error: INDEX = -1: must be 0 to 17, the scenarios of "
    )


def test_replay_gives_the_same_bits_and_simulates_picture(spec, tmp_path, capsys):
    out = finished(spec(), tmp_path / "out.zarr")
    with pytest.raises(SystemExit) as left:
        main(["replay", str(out), "11", "--out", str(tmp_path / "again")])
    said = capsys.readouterr().out
    assert left.value.code == 0
    assert "every measure has the same bits" in said
    assert (tmp_path / "again" / "simulate.png").stat().st_size > 10_000
    recording = Recording.load(tmp_path / "again" / "recording.npz")
    campaign = campaign_of(out)
    alone, reference = run_lanes([campaign.scenario(11)])[0], run(campaign.scenario(11))
    for name in CHANNELS:
        np.testing.assert_array_equal(getattr(recording, name), getattr(alone, name))
        np.testing.assert_allclose(getattr(recording, name), getattr(reference, name), rtol=0, atol=1e-10)


def test_failed_scenarios_are_named_with_seed_and_reason(spec, tmp_path, capsys):
    # A load far beyond the motor, and a physics step that no machine would run.
    path = spec(lambda text: text.replace("seed = [1, 2, 3]", "seed = [7]\ndrive.stiffness = [1.0, 1.01]"))
    campaign = Campaign(Spec.load(path))

    def broken(values, payload, period):
        if payload.mass == 0.5:
            raise InputError("cannot be built", quantity="payload [kg]", value=payload.mass)
        return Campaign._plant(campaign, values, payload, period)

    campaign._plant = broken
    out = tmp_path / "out.zarr"
    create(out, campaign)
    store = Store(out, campaign)
    execute(campaign, store, workers=0)
    store.close()
    with open_dataset(out) as dataset:
        lost = dataset["status"].values == FAILED
        assert lost.sum() == 4
        assert (dataset["payload"].broadcast_like(dataset["status"]).values[lost] == 0.5).all()
        assert np.isnan(dataset["error_max"].values[lost]).all()
        verdicts = judge(campaign.spec, dataset)
        assert verdicts[0].kept == pytest.approx(8 / 12)
        assert not verdicts[0].holds
        assert not passed(campaign.spec, dataset)[lost.ravel()].any()
    with pytest.raises(SystemExit) as left:
        main(["report", str(out)])
    said = capsys.readouterr().out
    assert left.value.code == 1
    assert "4 of 12 scenarios failed" in said
    assert "seed 7: payload [kg] = 0.5: cannot be built" in said


class Fetched(HTMLParser):
    """What a page would load."""

    def __init__(self):
        super().__init__()
        self.sources = []

    def handle_starttag(self, tag, attributes):
        self.sources += [value for key, value in attributes if key in ("src", "href")]


def test_the_report_judges_and_is_one_page(spec, tmp_path, capsys):
    out = finished(spec(), tmp_path / "out.zarr")
    page = tmp_path / "page.html"
    with pytest.raises(SystemExit) as left:
        main(["report", str(out), "--out", str(page)])
    said = capsys.readouterr().out
    assert left.value.code == 1  # the second requirement cannot be met
    assert "dashpot report" not in said  # that is what has just been done
    with pytest.raises(SystemExit) as left:
        main(["report", str(out), "--out", str(tmp_path / "law.toml" / "page.html")])
    assert left.value.code == 2
    assert "--out = " in capsys.readouterr().err
    text = page.read_text()
    parser = Fetched()
    parser.feed(text)
    assert len(parser.sources) == 3
    assert all(source.startswith("data:image/png;base64,") for source in parser.sources)
    with open_dataset(out) as dataset:
        first, second = judge(Spec.load(spec()), dataset)
        error = np.degrees(dataset["error_max"].values)
        assert first.kept == np.mean(error <= 20)
        assert first.holds == (np.quantile(error, 0.9, method="inverted_cdf") <= 20)
        assert math.degrees(first.quantile) == pytest.approx(np.quantile(error, 0.9, method="inverted_cdf"))
        assert (second.judged, second.kept, second.holds) == (6, 0.0, False)
        heavy = error[2]
        assert second.worst[0].value == math.radians(heavy.max()) or second.worst[0].value == pytest.approx(
            math.radians(heavy.max())
        )
        index = int(dataset["scenario"].values.ravel()[12 + int(heavy.ravel().argmax())])
    assert second.worst[0].index == index
    assert f"dashpot replay {out} {index}" in text.replace("&#x27;", "'")
    assert "not met" in said


def test_memory_does_not_grow_with_the_number_of_scenarios(spec, tmp_path):
    import tracemalloc

    path = spec(
        lambda text: text.replace("seed = [1, 2, 3]", f"seed = {list(range(24))}").replace(
            "chunk = 2", "chunk = 8"
        )
    )
    campaign = Campaign(Spec.load(path))
    create(tmp_path / "out.zarr", campaign)
    store = Store(tmp_path / "out.zarr", campaign)
    held = []
    tracemalloc.start()
    execute(campaign, store, workers=0, advance=lambda _: held.append(tracemalloc.get_traced_memory()[0]))
    tracemalloc.stop()
    store.close()
    recording = 8 * 8 * 280
    assert max(held[len(held) // 2 :]) - max(held[4 : len(held) // 2]) < 20 * recording  # 72 more scenarios
