"""The passivity certificate: how long it takes, and the same question put to python-control and CVXPY.

Neither of the two knows a sampled joint. Each is handed dashpot's lifted port for N sub-intervals of a
period, ``x+ = A x + B w``, ``p = C x + D w``, in units of damping, and asked for a solution of the discrete
KYP inequality. The certificate itself holds in the limit of N; the verdicts are compared with that limit,
extrapolated from a frequency grid at N = 64 and 128.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from measure import SETS, Rows, Timed, calls, interleave
from rich.table import Table

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.box import certify_box
from dashpot.certify.exact import at_rest, quadratic_form, storage
from dashpot.certify.index import passivity_index, unfit
from dashpot.certify.joint import sampled_joint
from dashpot.certify.map import index_map
from dashpot.certify.port import Port, lift
from dashpot.control.controller import joint_block, load_controller
from dashpot.control.sampled import VirtualPassive, add_position_loop, virtual_passive_block

WRIST = Drive("wrist", rotor_inertia=0.05, viscous_friction=0.6, stiffness=6e3, damping=0.7, torque_limit=40)
PERIOD, SAMPLING, K = 5e-3, "average", 1.0
INTERVALS, FINER = 8, 32
CASES = {  # R, D, kp, kd
    "R 6, D 3": (6.0, 3.0, 0.0, 0.0),
    "R 8.1, D 3": (8.1, 3.0, 0.0, 0.0),
    "R 10, D 3": (10.0, 3.0, 0.0, 0.0),
    "R 1, D 1\nkp 60, kd 1": (1.0, 1.0, 60.0, 1.0),
    "R 3, D 3\nkp 60, kd 4": (3.0, 3.0, 60.0, 4.0),
}
ASKED = "R 6, D 3"  # the case that is timed
ERROR = 0.02  # of the damping of the transmission: an index farther off is marked

NOTES = f"""[red]Red[/red]: wrong about the joint; no index; or an index off by more than {100 * ERROR:g} % \
of the transmission's damping. ~: the solver calls its answer inaccurate.
- Neither rival takes a sampled joint. Both are handed dashpot's lift(joint, {INTERVALS}), whose time is not \
counted, and answer about that N: R 8.1 passes there and fails in the limit.
- python-control: ispassive, and get_input_ff_index, on a discrete StateSpace; the solver is cvxopt.
- CVXPY: the KYP inequality is the user's to write. SCS, at its default accuracy, is what it takes by default.
- With kp the port has a pole at z = 1: no strictly feasible point, which is where solvers give up.
- Rivals win: more digits of the index at the N they are given (dashpot stops within about 0.1 % of the \
limit), and any discrete LTI system with as many inputs as outputs; python-control continuous ones too.
"""


def law(R: float, D: float) -> Any:
    plant = VirtualPassive(R, D, K, WRIST.rotor_inertia, WRIST.viscous_friction)
    return virtual_passive_block(plant, PERIOD, "explicit")


def block_of(case: str) -> Any:
    R, D, kp, kd = CASES[case]
    return add_position_loop(law(R, D), kp, kd)


def port_of(case: str, intervals: int) -> Port:
    return lift(sampled_joint(WRIST, block_of(case), SAMPLING, PERIOD), intervals)


def exact_test(block: Any) -> bool:
    """Whether a storage function exists at level 0; all there is to "is this port passive?"."""
    joint = sampled_joint(WRIST, block, SAMPLING, PERIOD)
    rest = at_rest(joint)
    form = None if unfit(rest) else quadratic_form(joint, 0.0, rest)
    return form is not None and storage(form) is not None


def least(port: Port) -> float:
    """Index of a lifted port on a fine grid."""
    angles = np.concatenate([np.geomspace(1e-6, 0.1, 800), np.linspace(0.1, np.pi, 3000)])
    best = int(port.least_damping(angles).argmin())
    near = np.linspace(angles[max(best - 1, 0)], angles[min(best + 1, len(angles) - 1)], 200)
    return float(port.least_damping(near).min())


def limit(case: str) -> float:
    """Index for N to infinity; its error falls with the square of N. The worst frequency depends on N."""
    angles = np.concatenate([np.geomspace(1e-6, 0.1, 250), np.linspace(0.1, np.pi, 350)])
    fine, finest = port_of(case, 64), port_of(case, 128)
    best = int(fine.least_damping(angles).argmin())
    near = np.linspace(angles[max(best - 1, 0)], angles[min(best + 1, len(angles) - 1)], 41)
    last = float(finest.least_damping(near).min())
    return last + (last - float(fine.least_damping(near).min())) / 3


@dataclass(frozen=True)
class Rival:
    """Someone else's answers.

    Attributes:
        passive: "yes", "no", or why there is none.
        index: Index, or why there is none.
        handed: What it has to be given, in words.
    """

    passive: Callable[[Port], str]
    index: Callable[[Port], float | str]
    handed: str


def python_control() -> Rival | str:
    """`ispassive` and `get_input_ff_index`; or what is missing."""
    try:
        import control
    except ImportError:
        return "not installed"
    try:
        import cvxopt  # noqa: F401 - python-control's only solver for this
    except ImportError:
        return "needs cvxopt"

    def system(port: Port) -> Any:
        return control.ss(port.A, port.B, port.C * port.scale, port.D * port.scale, port.period)

    def passive(port: Port) -> str:
        try:
            return "yes" if control.ispassive(system(port)) else "no"
        except (ValueError, ArithmeticError):
            return "failed"

    def index(port: Port) -> float | str:
        try:
            return float(control.passivity.get_input_ff_index(system(port)))
        except (ValueError, ArithmeticError, RuntimeError):
            return "failed"

    return Rival(passive, index, "a discrete StateSpace")


def cvxpy(solver: str) -> Rival | str:
    """The KYP inequality written out by hand; or what is missing."""
    try:
        import cvxpy as cp
    except ImportError:
        return "not installed"
    if solver not in cp.installed_solvers():
        return f"needs {solver}"

    def solve(port: Port, maximise: bool) -> tuple[str, float]:
        A, B, C, D = port.A, port.B, port.C * port.scale, port.D * port.scale
        P = cp.Variable(A.shape, symmetric=True)
        level = cp.Variable() if maximise else 0.0
        corner = D + D.T - B.T @ P @ B - 2 * level * np.eye(len(D))
        M = cp.bmat([[P - A.T @ P @ A, C.T - A.T @ P @ B], [C - B.T @ P @ A, corner]])
        goal = cp.Maximize(level) if maximise else cp.Minimize(0)
        problem = cp.Problem(goal, [P >> 0, (M + M.T) / 2 >> 0])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of inaccurate solutions; the status says so too
            try:
                problem.solve(solver=solver)
            except cp.error.SolverError:
                return "failed", np.nan
        found = maximise and level.value is not None
        return problem.status, float(level.value) if found else np.nan

    def passive(port: Port) -> str:
        status = solve(port, False)[0]
        words = {"optimal": "yes", "optimal_inaccurate": "yes~", "infeasible": "no"}
        return {**words, "infeasible_inaccurate": "no~"}.get(status, "failed")

    def index(port: Port) -> float | str:
        value = solve(port, True)[1]
        return value if np.isfinite(value) else "failed"

    return Rival(passive, index, "every matrix of the inequality")


def rivals() -> dict[str, Rival | str]:
    return {
        "python-control": python_control(),
        "CVXPY, CLARABEL": cvxpy("CLARABEL"),
        "CVXPY, SCS": cvxpy("SCS"),
    }


def certificate(rows: Rows) -> None:
    own_times(rows)
    asked = rivals()
    rival_times(rows, asked)
    verdicts(rows, asked)


def own_times(rows: Rows) -> None:
    block = block_of(ASKED)
    robot, config = Robot.load("iiwa14"), load_controller("iiwa14")
    drives = {drive.name: drive for drive in robot.drives}
    arm = [
        (drives[g.name], joint_block(replace(g, kp=0.0, kd=0.0), drives[g.name], config))
        for g in config.joints
    ]
    proven = [0]
    R, D = np.geomspace(0.5, 20, 200), np.geomspace(0.3, 30, 200)

    def box() -> None:
        found = [certify_box(drive, b, config.sampling, config.period) for drive, b in arm]
        proven[0] = sum(one.proven for one in found)

    best = interleave(
        {
            "index": calls(lambda: passivity_index(WRIST, block, SAMPLING, PERIOD), 5),
            "exact": calls(exact_test, 20, block),
        },
        12,
    )
    slow = interleave(
        {
            "box": calls(box, 1),
            "map": calls(lambda: index_map(WRIST, law, (0.0, 0.0), SAMPLING, PERIOD, R, D), 1),
        },
        1,
    )
    rows.section("Passivity certificate", "200 Hz wrist joint; one core")
    exact = float(np.median(best["exact"] / best["index"]))
    rows.add("certify_index", "passivity index of a joint", best["index"] * 1e3, "ms", most=5.0)
    rows.add("certify_exact", "exact test alone", best["exact"] * 1e3, "ms", note=f"({exact:.2g} x an index)")
    note = f"{proven[0]} of {len(arm)} proven"
    rows.add("certify_box", "iiwa14 brake laws, whole box", slow["box"], "s", most=2.0, note=note)
    points = len(R) * len(D)
    ratio = float(np.median(best["index"] * points / slow["map"]))
    note = f"index by index: {ratio:.2g} x"
    rows.add("certify_map", f"map over R and D, {len(R)} x {len(D)}", slow["map"], "s", most=10.0, note=note)


def rival_times(rows: Rows, asked: dict[str, Rival | str]) -> None:
    block, port, finer = block_of(ASKED), port_of(ASKED, INTERVALS), port_of(ASKED, FINER)
    functions: dict[str, Timed] = {
        "passive dashpot": calls(exact_test, 20, block),
        "index dashpot": calls(lambda: passivity_index(WRIST, block, SAMPLING, PERIOD), 5),
    }
    for name, rival in asked.items():
        if isinstance(rival, Rival):
            functions[f"passive {name}"] = calls(rival.passive, 1, port)
            functions[f"index {name}"] = calls(rival.index, 1, port)
    control = asked["python-control"]
    if isinstance(control, Rival):
        functions["finer python-control"] = calls(control.index, 1, finer)
    best = interleave(functions, 2)
    for question, title in (("passive", "Is this port passive?"), ("index", "How passive: its index")):
        own = best[f"{question} dashpot"]
        rows.section(title, f"{ASKED}; rivals: at N = {INTERVALS}")
        rows.add(f"certify_{question}_dashpot", "dashpot, limit of N", own * 1e3, "ms")
        for name, rival in asked.items():
            if isinstance(rival, str):
                rows.table.add_row(name, rival, "", "", "pip install dashpot\\[bench]")
                continue
            taken, key = best[f"{question} {name}"], name.lower().replace(", ", "_").replace("-", "_")
            note = f"({float(np.median(taken / own)):.3g} x)"
            rows.add(f"certify_{question}_{key}", name, taken * 1e3, "ms", note=note)
        if question == "index" and "finer python-control" in best:
            taken = best["finer python-control"]
            note = f"({float(np.median(taken / own)):.3g} x) for our accuracy"
            what = f"python-control, N = {FINER}"
            rows.add("certify_index_python_control_finer", what, taken * 1e3, "ms", note=note)


def marked(text: str, good: bool) -> str:
    return text if good else f"[red]{text}[/red]"


def verdicts(rows: Rows, asked: dict[str, Rival | str]) -> None:
    """Who says what about five controllers; what is wrong is marked."""
    ports = {case: port_of(case, INTERVALS) for case in CASES}
    limits = {case: limit(case) for case in CASES}
    table = Table(
        title="Verdict and index [N m s/rad] of the explicit law on the wrist joint", show_lines=True
    )
    table.title_justify = "left"
    table.add_column("")
    for case in CASES:
        table.add_column(case)
    said: dict[str, dict[str, tuple[str, float | str]]] = {}
    said["limit of N, grid"] = {case: ("yes" if v > 0 else "no", v) for case, v in limits.items()}
    own = {case: passivity_index(WRIST, block_of(case), SAMPLING, PERIOD) for case in CASES}
    said["dashpot"] = {
        case: ("yes" if exact_test(block_of(case)) else "no", own[case].value) for case in CASES
    }
    grid = {case: least(port) for case, port in ports.items()}
    said[f"N = {INTERVALS}, grid"] = {case: ("yes" if v > 0 else "no", v) for case, v in grid.items()}
    handed = {name: rival for name, rival in asked.items() if isinstance(rival, Rival)}
    said |= {
        name: {case: (rival.passive(port), rival.index(port)) for case, port in ports.items()}
        for name, rival in handed.items()
    }
    right, right_there, off = ({name: 0 for name in said} for _ in range(3))
    for name, answers in said.items():
        cells = []
        for case, (word, value) in answers.items():
            yes = {"yes": True, "no": False}.get(word.rstrip("~"))
            good = yes == (limits[case] > 0)
            right[name] += good
            right_there[name] += yes == (grid[case] > 0)
            # A rival's index is that of the port it was handed.
            truth = limits[case] if name in ("limit of N, grid", "dashpot") else grid[case]
            error = abs(value - truth) if isinstance(value, float) else np.inf
            off[name] = max(off[name], error)
            shown = f"{value:.4f}" if isinstance(value, float) else value
            near = error <= ERROR * WRIST.damping
            cells.append(f"{marked(word, good)}\n{marked(shown, near)}")
        table.add_row(name, *cells)
    rows.section("Five controllers: index error", f"see below; rivals: at N = {INTERVALS}")
    percent = np.full(SETS, 100 * off["dashpot"] / WRIST.damping)
    note = f"{right['dashpot']} of {len(CASES)} right"
    what = "dashpot, of c (transmission)"
    rows.add("certify_error_dashpot", what, percent, "%", most=0.3, note=note)
    if right["dashpot"] < len(CASES):
        rows.missed.append("certify_verdicts")
    for name in handed:
        key = "certify_error_" + name.lower().replace(", ", "_").replace("-", "_")
        note = f"{right[name]} of {len(CASES)} right; {right_there[name]} at N = {INTERVALS}"
        percent = np.full(SETS, 100 * off[name] / WRIST.damping)
        if np.isfinite(off[name]):
            rows.add(key, name, percent, "%", note=note)
        else:
            rows.table.add_row(name, "failed", "", "", note)
    rows.results["certify_verdicts"] = {
        name: {case.replace("\n", ", "): answer for case, answer in answers.items()}
        for name, answers in said.items()
    }
    rows.more += [table, NOTES]
