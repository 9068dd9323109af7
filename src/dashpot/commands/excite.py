"""``dashpot excite``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dashpot.arm.robot import Robot
from dashpot.commands.excite_view import draw, show
from dashpot.commands.payload import payload_of
from dashpot.commands.shared import check_joints
from dashpot.control.controller import load_controller
from dashpot.excite import Limits
from dashpot.excite import excite as search
from dashpot.logs.motionfile import write_motion
from dashpot.simulation.engine import quiet_engine
from dashpot.support.limits import check_seed
from dashpot.support.output import whole_folder
from dashpot.support.plots import save
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.identify import Excite

PERIOD = 0.005  # [s] of motion.csv where no controller gives one


def excite(options: Excite) -> int:
    """``dashpot excite``; returns the exit status."""
    robot = Robot.load(options.robot)
    limits = Limits(options.amplitude, options.speed, options.torque_share)
    check_seed(options.seed)
    check_joints(options.joints, robot, "--joints")
    period = PERIOD if options.controller is None else load_controller(options.controller).period
    payloads = [payload_of(mass, options.offset) for mass in options.payload]
    quiet_engine()
    with waiting("looking for a motion"):
        found = search(
            robot,
            duration=options.duration,
            period=period,
            joints=options.joints,
            payloads=payloads,
            limits=limits,
            seed=options.seed,
        )
    with waiting("drawing"), whole_folder(options.out) as folder:
        write_motion(folder / "motion.csv", found.trajectory, robot.joints)
        save(draw(found, limits), folder / "motion")
    show(found, limits, options)
    return 0
