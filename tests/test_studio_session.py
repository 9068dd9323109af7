"""The studio without its page: what runs live is what `dashpot simulate` computes, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build, with_timestep
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.control.supervisor import SupervisorSettings
from dashpot.errors import InputError
from dashpot.simulation.faults import Fault
from dashpot.simulation.recording import CHANNELS
from dashpot.simulation.simulate import Event, PayloadChange, Scenario, run
from dashpot.simulation.trajectory import multisine
from dashpot.studio.choices import RIVALS, rival_of
from dashpot.studio.files import recording
from dashpot.studio.handover import equilibrium_state
from dashpot.studio.live import LiveArm
from dashpot.studio.references import Hold, Move, Play, go_to, wander
from dashpot.studio.ring import envelope
from dashpot.studio.scenes import SCENES, play
from dashpot.studio.session import Session

LOAD, HEAVY = Payload(1.0, (0.0, 0.0, 0.1)), Payload(2.0, (0.0, 0.0, 0.1))


@pytest.fixture
def session() -> Iterator[Session]:
    found = Session("k807", "k807-wrist", certify=False)
    yield found
    found.close()


@pytest.mark.parametrize(
    ("name", "controller", "carried"),
    [("k807", "k807-wrist", False), ("fr3", "fr3", False), ("fr3", "fr3", True)],
)
def test_live_is_simulate_bit_for_bit(name: str, controller: str, carried: bool) -> None:
    """A fault, a change of payload, a cut position loop, a tap, the supervisor: all at their ticks."""
    robot, config = Robot.load(name), load_controller(controller)
    path = multisine(robot.home, 1.0, config.period, 3, amplitude=0.3, lead_in=0.0)
    ticks, h = len(path.position), config.period
    last = robot.joints[-1]
    cut, fails, lost = (round(share * ticks) for share in (0.3, 0.6, 0.8))
    external = np.zeros_like(path.position)
    external[cut : cut + round(0.1 / h), -1] = 2.0
    fault = Fault("encoder_lost", fails * h, joint=last)
    drops = Fault("samples_dropped", 0.0, joint=last, value=0.2)
    plant = build(robot, h, [LOAD])
    wanted = run(
        Scenario(
            plant,
            Controller.from_config(config, robot.drives),
            path,
            [Event(cut * h, last, "warm_start")],
            external,
            seed=5,
            faults=[drops, fault],
            payload_changes=[PayloadChange(lost * h, HEAVY)],
            supervisor=SupervisorSettings(),
            gravity_compensation=carried,
        )
    )
    heavy = build(robot, h, [HEAVY])
    if heavy.timestep < plant.timestep:  # the shortest step that one of the loads needs, as simulate does
        plant = with_timestep(plant, heavy.timestep)
    arm = LiveArm(
        robot,
        config,
        plant,
        Play(path),
        payloads=[LOAD],
        supervisor=SupervisorSettings(),
        seed=5,
        carried=carried,
    )
    rng, marks, seen = np.random.default_rng(0), [cut, fails, lost, ticks], []
    arm.begin(drops)
    while arm.tick < ticks:
        if arm.tick == cut:
            arm.warm_start(last)
            arm.tap(robot.index(last), 2.0, 0.1)
        if arm.tick == fails:
            arm.begin(fault)
        if arm.tick == lost:
            arm.carry(heavy, [HEAVY])
        until = min(mark for mark in marks if mark > arm.tick)
        seen.append(arm.go_on(min(int(rng.integers(1, 30)), until - arm.tick)))
    got = np.concatenate([window.record for window in seen], axis=1)
    for channel, values in zip(CHANNELS, got, strict=True):
        np.testing.assert_array_equal(values, getattr(wanted, channel), err_msg=channel)
    np.testing.assert_array_equal(np.concatenate([w.status for w in seen]), wanted.status)
    assert "track" != arm.state == wanted.settings["supervisor"]["state"]  # type: ignore[index]


def test_a_lighter_load_needs_a_shorter_step_and_changes_nothing_else() -> None:
    """What goes on with it is the run that has had the short step from the beginning, to its accuracy."""
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    # A delayed and filtered sensor, so that all of a drive's memory is moved over.
    slow = {"torque_latency": 0.002, "sensor_bandwidth": 200.0}
    robot = robot.with_drives({name: slow for name in robot.joints})
    heavy, light = build(robot, config.period, [Payload(4.5, 0.2)]), build(robot, config.period)
    assert light.timestep < heavy.timestep
    seen = []
    for plant in (heavy, with_timestep(heavy, light.timestep)):
        rest = Hold(np.array(robot.home))
        arm = LiveArm(robot, config, plant, rest, payloads=[Payload(4.5, 0.2)], seed=5)
        arm.go_on(100)
        arm.carry(light, [])
        assert arm.plant.timestep == light.timestep
        seen.append(arm.go_on(60).record)
    for channel, atol in (("sample", 0.01), ("link_position", 1e-6), ("link_velocity", 1e-3)):
        one, other = (record[CHANNELS.index(channel)] for record in seen)
        np.testing.assert_allclose(one, other, atol=atol, err_msg=channel)


def test_same_numbers_again_change_nothing() -> None:
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    plant, records = build(robot, config.period, [LOAD]), []
    for again in (False, True):
        arm = LiveArm(robot, config, plant, Hold(np.array(robot.home)), seed=1)
        arm.follow(go_to(arm.reference_now(), np.array(robot.home) + 0.2, config.period))
        arm.go_on(30)
        if again:
            arm.retune(replace(config))
        records.append(arm.go_on(100).record)
    np.testing.assert_array_equal(*records)


def test_new_numbers_do_not_kick(session: Session) -> None:
    """At rest a change of D alone moves nothing: the torque goes on where it was."""
    session.step(0.5)
    before = session.snapshot()
    session.edit("all", D=20.0)
    session.step(0.05)
    after = session.snapshot()
    np.testing.assert_allclose(after.command, before.command, atol=0.3)
    assert np.abs(after.velocity).max() < 0.02


def test_references_are_smooth() -> None:
    """Velocity and acceleration are the derivatives, also where one motion goes over into the next."""
    h, home = 1e-3, np.array([0.1, -0.2])
    moving = wander(np.stack([home, 0 * home, 0 * home]), home + 0.3, np.array([0.3, 0.1]), h, 4)
    start = moving.at(np.array([2500]))[:3, 0]
    for reference in (moving, go_to(start, home, h)):
        rows = reference.at(np.arange(8000))
        for order in (0, 1):
            slope = (rows[order, 2:] - rows[order, :-2]) / (2 * h)
            np.testing.assert_allclose(slope, rows[order + 1, 1:-1], atol=2e-4 if order == 0 else 0.02)
    np.testing.assert_allclose(go_to(start, home, h).at(np.array([0]))[:3, 0], start, atol=1e-12)
    move = Move.of(start, home, h)
    np.testing.assert_array_equal(move.at(np.array([10**6]))[:3, 0], [home, 0 * home, 0 * home])


def test_energy_is_only_taken_out_once_nothing_drives(session: Session) -> None:
    """Released, the arm falls and is braked: the balance never goes up, and the hand's work appears in it."""
    session.supervise(False)
    session.load("k807", "k807-wrist", Payload(4.5, 0.2))
    session.go("wrist turned")
    session.step(0.5)
    session.set_position_loop("all", False)
    session.step(1.5)
    rows = np.array(session.energies)
    after = rows[:, 0] > 0.5
    total = (rows[:, 3] + rows[:, 4])[after]  # virtual and taken out: what the arm has given away
    scale = np.ptp(rows[after, 2])
    assert scale > 0.01
    assert np.diff(total).min() > -0.02 * scale


def test_fault_brakes_and_resume_tracks(session: Session) -> None:
    session.go("aside")
    session.step(0.6)
    session.fail("encoder_lost", "joint6")
    session.step(1.5)
    assert session.arm.state == "torque_brake"
    assert np.abs(session.snapshot().velocity).max() < 0.05
    assert any(news.kind == "supervisor" and "joint6" in news.text for news in session.news)
    with pytest.raises(InputError, match="resume first"):
        session.edit("joint6", R=5.0)
    session.heal()
    here = session.snapshot().position
    session.resume()
    session.step(0.5)
    found = session.snapshot()
    assert found.state == "track"
    np.testing.assert_allclose(found.position, here, atol=0.03)


def test_an_arm_that_carries_itself_stays_under_the_brake() -> None:
    """The encoder of the last joint is lost in motion: without its gravity compensation an fr3 sinks."""
    found = Session("fr3", "fr3", certify=False)
    try:
        assert found.arm.carried
        found.set_rival("PD, same kp and kd")
        assert found.rival is not None
        assert found.rival.carried
        found.move(0.3)
        found.step(4.0)
        found.fail("encoder_lost", "joint7")
        found.step(1.9)
        assert found.arm.state == "torque_brake"
        (said,) = [news.text for news in found.news if news.kind == "supervisor"]
        assert "nan" not in said
        assert np.abs(found.snapshot().velocity).max() < 0.02
        assert recording(found).settings["gravity_compensation"] is True
        here = found.snapshot().position
        found.heal()
        found.resume()
        found.step(1.0)
        assert found.arm.state == "track"
        np.testing.assert_allclose(found.snapshot().position, here, atol=0.01)
    finally:
        found.close()


def test_the_weight_is_handed_over_without_a_jump() -> None:
    found = Session("fr3", "fr3", payload=LOAD, certify=False)
    try:
        found.step(0.3)
        where, command = found.snapshot().position, found.snapshot().command
        weight = build(found.robot, found.config.period).load_torque(where)
        assert np.abs(weight).max() > 10.0
        for on, share in ((False, 1.0), (True, 0.0)):
            found.compensate(on)
            found.step(0.5)
            now, past = found.snapshot(), found.past(0.5)
            assert now.state == "track"
            assert found.arm.carried is on
            assert np.abs(past.channel("link_velocity")).max() < 0.15
            np.testing.assert_allclose(now.position, where, atol=0.02)  # the weight's sag, and friction
            np.testing.assert_allclose(now.command, command + share * weight, atol=4.0)
    finally:
        found.close()


def test_a_robot_that_cannot_carry_itself_says_so(session: Session) -> None:
    assert not session.arm.carried
    with pytest.raises(InputError, match="gravity compensation: the robot has none"):
        session.compensate(True)


def test_push_moves_the_link_where_it_is_pulled(session: Session) -> None:
    session.step(0.2)
    body = session.arm.model.nbody - 1
    before = session.bodies()[0][0][body].copy()
    session.grasp(body, before)
    session.pull(before + np.array([0.0, 0.3, 0.0]))
    session.step(0.5)
    assert session.bodies()[0][0][body][1] > before[1] + 1e-3
    push = session.snapshot().push
    assert push is not None
    assert push[0][1] > 5.0
    session.let_go()
    session.step(0.1)
    assert session.snapshot().push is None


@pytest.mark.parametrize("name", RIVALS)
def test_rivals_run_beside(session: Session, name: str) -> None:
    session.go("aside")
    session.step(0.3)
    session.set_rival(name)
    session.step(0.3)
    assert session.rival is not None
    assert session.rival.diverged is None
    mine, other = session.arm.window.reference, session.rival.window.reference
    np.testing.assert_array_equal(mine, other)
    assert rival_of(name, session.config, session.robot).joints[0].law != "virtual_passive"


def test_scene_1_goes_on_past_its_end(session: Session) -> None:
    """The load is gone at 12 s: both arms follow the same motion, and the one without the law jumps more."""
    play(SCENES[0], session)
    session.step(12.1)
    session.fail("torque_bias", "joint5", 1.0)
    before, rival = session.arm.reference, session.rival
    session.step(3.9)
    assert session.payload.mass == 0.0
    assert session.rival is rival is not None
    assert session.rival_name == "PD, same kp and kd"
    assert session.arm.reference is rival.reference is before
    assert session.faults
    j = session.robot.index("joint6")
    jumps = []
    for beside in (False, True):
        past = session.past(rival=beside)
        assert past.time[-1] > 15.9
        assert past.time[0] < 0.1
        angle, wanted = past.channel("link_position")[:, j], past.reference[:, j]
        late = past.time > 13.0
        assert np.ptp(angle[late]) > 0.5 * np.ptp(wanted[late]) > 0.05
        error = (wanted - angle)[(past.time > 11.99) & (past.time < 12.5)]
        jumps.append(np.abs(error - error[0]).max())
    assert jumps[1] > 5 * jumps[0]


@pytest.mark.parametrize("chosen", [True, False])
def test_a_scene_is_without_supervisor_and_what_follows_as_chosen(session: Session, chosen: bool) -> None:
    session.supervise(chosen)
    for scene in SCENES:
        play(scene, session)
        assert not session.supervised
        assert session.arm.guard is None
    session.load("k807", "k807-wrist")
    assert session.supervised is chosen
    play(SCENES[1], session)
    session.restart()
    assert session.supervised is chosen
    assert (session.arm.guard is not None) is chosen


def test_period_and_payload_change_without_a_jump(session: Session) -> None:
    session.step(0.3)
    before = session.snapshot().position
    session.configure(period=0.002)
    assert session.arm.config.period == 0.002
    session.set_payload(2.0, 0.1)
    session.step(0.02)
    np.testing.assert_allclose(session.snapshot().position, before, atol=0.01)
    assert session.time == pytest.approx(0.32, abs=0.006)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: s.edit("joint6", R=-1.0), "R"),
        (lambda s: s.edit("joint6", ki=1.0), "no such number"),
        (lambda s: s.edit("elbow", R=1.0), "elbow"),
        (lambda s: s.set_payload(-1.0), "payload"),
        (lambda s: s.go("upside down"), "home"),
        (lambda s: s.fail("encoder_lost", "joint1"), "joint1"),
        (lambda s: s.configure(latency=99), "latency"),
        (lambda s: s.move(7.0), "amplitude"),
        (lambda s: s.load("nobody", "fr3"), "neither a file"),
    ],
)
def test_bad_input_is_explained_and_changes_nothing(session: Session, call, words: str) -> None:  # type: ignore[no-untyped-def]
    config, arm = session.config, session.arm
    with pytest.raises(InputError, match=words):
        call(session)
    assert session.config == config
    assert session.arm is arm
    session.step(0.02)


def test_real_time_thread_runs_and_ends(session: Session) -> None:
    import time

    session.start()
    time.sleep(0.5)
    assert session.time > 0.05
    session.close()
    stood = session.time
    time.sleep(0.1)
    assert session.time == stood


def test_envelope_keeps_every_peak() -> None:
    values = np.random.default_rng(0).normal(size=(1234, 2))
    rows, shown = envelope(values, 50)
    assert len(shown) == 100
    assert (np.diff(rows) >= 0).all()
    np.testing.assert_array_equal(shown.max(0), values.max(0))
    np.testing.assert_array_equal(shown.min(0), values.min(0))


def test_equilibrium_state_stays() -> None:
    config, robot = load_controller("k807-wrist"), Robot.load("k807")
    block = Controller.from_config(config, robot.drives).blocks[0]
    w = np.array([3.0, 2.0, 0.1, 0.0, 0.2, 0.0, 0.0, 0.0])
    x = equilibrium_state(block, w)
    np.testing.assert_allclose(block["A"] @ x + block["B"] @ w, x, atol=1e-12)
