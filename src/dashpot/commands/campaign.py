"""``dashpot campaign`` and ``dashpot replay``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.arm.robot import BUNDLED as ROBOTS
from dashpot.campaign.axes import value_label
from dashpot.campaign.cluster import check_address, connected
from dashpot.campaign.execute import execute
from dashpot.campaign.judge import judge
from dashpot.campaign.measures import MEASURES
from dashpot.campaign.scenario import OK, Campaign
from dashpot.campaign.spec import PRESETS, Spec
from dashpot.campaign.store import Block, Store, attributes, campaign_of, check_same, create, open_dataset
from dashpot.campaign.together import run_one
from dashpot.commands.aside import run_aside
from dashpot.commands.campaign_view import progress_bar, show_plan, show_replay, show_results, show_supervisor
from dashpot.commands.shared import check_place
from dashpot.commands.simulate_view import draw, show
from dashpot.control.controller import BUNDLED as CONTROLLERS
from dashpot.errors import DashpotError, InputError
from dashpot.simulation.engine import quiet_engine
from dashpot.support.installing import install
from dashpot.support.limits import check_workers
from dashpot.support.output import whole_folder
from dashpot.support.plots import save
from dashpot.support.waiting import waiting
from dashpot.support.workers import remembered_interrupts

if TYPE_CHECKING:
    from dashpot.cli.simulate import Campaign as Options
    from dashpot.cli.simulate import Replay


def needs_campaign_extra() -> None:
    """Checks that what stores datasets is installed.

    Raises:
        DashpotError: It is not; says how to get it.
    """
    try:
        import xarray  # noqa: F401
        import zarr  # noqa: F401
    except ImportError as error:
        raise DashpotError(f"{error.name} is not installed: {install('campaign')}") from None


def campaign(options: Options) -> int:
    """``dashpot campaign``; returns the exit status: 1 if a requirement is not met or a scenario failed."""
    needs_campaign_extra()
    quiet_engine()
    if (options.spec is None) == (options.preset is None):
        raise InputError(
            f"needs either a file or --preset {'|'.join(PRESETS)}", quantity="SPEC", value=options.spec
        )
    check_workers(options.workers)
    if options.workers is not None and options.scheduler is not None:
        raise InputError(
            "has workers of its own; leave --workers out", quantity="--scheduler", value=options.scheduler
        )
    if options.scheduler is not None:
        check_address(options.scheduler)
    with waiting("preparing"):
        plan = Campaign(_spec(options))
        plan.check()
    if options.scheduler is None:
        return _run(options, plan, None)
    with connected(options.scheduler) as client:  # before there is a dataset
        return _run(options, plan, client)


def _spec(options: Options) -> Spec:
    """The specification with the flags in it."""
    source = options.preset or options.spec
    assert source is not None
    beside = Path() if options.spec is None else Path(options.spec).parent
    flags: dict[str, list[str]] = {"--robot": [options.robot] if options.robot else []}
    flags["--controller"] = list(options.controller)
    for flag, names in flags.items():
        known = ROBOTS if flag == "--robot" else CONTROLLERS
        for name in names:
            if name not in known and not Path(name).is_file() and not (beside / name).is_file():
                rule = f"neither a file nor a bundled name ({', '.join(known)})"
                raise InputError(rule, quantity=flag, value=name)
    robot = None if options.robot is None else _absolute(options.robot)
    return Spec.load(source, robot=robot, controller=tuple(map(_absolute, options.controller)))


def _run(options: Options, plan: Campaign, client: Any) -> int:
    """Runs what is not done yet, and judges."""
    spec, out = plan.spec, options.out
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        check_same(out, attributes(out), plan)
    else:
        create(out, plan)
    store = Store(out, plan)
    before = spec.size - sum(len(spec.chunk_indices(chunk)) for chunk in store.pending())
    show_plan(plan, out, before)
    done = before
    try:
        with remembered_interrupts() as stop_if_told, progress_bar(spec.size, before) as advance:

            def written(block: Block) -> None:
                nonlocal done
                done += len(block.status)
                advance(block)
                stop_if_told()

            execute(plan, store, workers=options.workers, client=client, advance=written)
    except KeyboardInterrupt:
        print(
            f"dashpot: {done} of {spec.size} scenarios are kept; the same command continues", file=sys.stderr
        )
        raise
    finally:
        store.close()
    with open_dataset(out) as dataset:
        verdicts = judge(spec, dataset)
        show_results(spec, dataset, verdicts, out)
        show_supervisor(plan)
        failed = bool((dataset["status"].values != OK).any())
    return 1 if failed or not all(verdict.holds for verdict in verdicts) else 0


def replay(options: Replay) -> int:
    """``dashpot replay``; returns the exit status: 1 if it diverged or differs from the dataset."""
    from dashpot.cli.simulate import Simulate

    needs_campaign_extra()
    quiet_engine()
    check_place(options.out, [options.dataset])
    with waiting("preparing"):
        plan = campaign_of(options.dataset)
    if not 0 <= options.index < plan.spec.size:
        rule = f"must be 0 to {plan.spec.size - 1}, the scenarios of {options.dataset}"
        raise InputError(rule, quantity="INDEX", value=options.index)
    setting = plan.setting(options.index)
    scenario = plan.assemble(setting)
    controller = scenario.controller
    assert controller is not None
    name = setting.values.get("controller", plan.spec.controllers[0])
    offset = tuple(float(part) for part in setting.payload.position)
    view = Simulate(
        robot=plan.spec.robot,
        controller=name,
        payload=setting.payload.mass,
        offset=offset if any(offset[1:]) else offset[:1],
        release=plan.spec.release,
        tap=plan.spec.tap,
        seed=setting.seed,
        out=options.out,
    )
    values = {
        key: value if isinstance(value, int | float) else _plain(value)
        for key, value in setting.values.items()
    }
    with whole_folder(options.out) as folder:
        with waiting("simulating"):
            recording = run_aside(lambda: run_one(plan, scenario))
        recording.settings |= {
            "controller": name,
            "payload_kg": setting.payload.mass,
            "offset_m": list(offset),
            "tap_nm": plan.spec.tap,
            "campaign": plan.digest,
            "index": setting.index,
            "axes": values,
        }
        recording.save(folder / "recording.npz")
        with waiting("drawing"):
            save(draw(recording, controller, view), folder / "simulate")
    show(recording, plan.robot, controller, scenario.plant, view)
    found = plan.measure(setting, scenario, recording)
    with open_dataset(options.dataset) as dataset:
        at = dict(zip(plan.spec.dims, np.unravel_index(setting.index, plan.spec.shape), strict=True))
        kept = dataset.isel({dim: int(i) for dim, i in at.items()})
        done = bool(kept["status"].values)
        differ = [key for key in MEASURES if done and not same_bits(found[key], kept[key].values)]
    show_replay(values, done, differ)
    return 1 if recording.diverged_at is not None or differ else 0


def _absolute(name: str) -> str:
    """A file given on the command line, so that it is found from anywhere; bundled names stay."""
    return str(Path(name).absolute()) if Path(name).is_file() else name


def same_bits(a: Any, b: Any) -> bool:
    """Whether two arrays hold the same bits (all NaN are alike)."""
    return bool(np.array_equal(np.asarray(a, float), np.asarray(b, float), equal_nan=True))


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value_label(value)


def replay_command(dataset: Path, index: int) -> str:
    """What to type to see a scenario."""
    return f"dashpot replay {shlex.quote(str(dataset))} {index}"
