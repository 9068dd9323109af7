"""Exported FMUs: valid, equal to the native controller to the bit, with a state that is a copy."""

import json
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.export.compiler import FLAGS, compiler, platform_tuple
from dashpot.export.fmu import fmu_files, write_fmu
from dashpot.studies.export_cases import bundled, differing, in_python

fmpy = pytest.importorskip("fmpy", reason="needs fmpy: pip install 'dashpot[test]'")
fmi2 = pytest.importorskip("fmpy.fmi2")
fmi3 = pytest.importorskip("fmpy.fmi3")
pytestmark = [
    pytest.mark.skipif(
        compiler() is None or platform_tuple() is None, reason="needs a C compiler on Linux or macOS"
    ),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]
INPUTS = ("torque", "position", "velocity", "position_ref", "velocity_ref", "acceleration_ref", "torque_ref")
CASES = [(3, False), (3, True), (2, False), (2, True)]


class Slave:
    """One interface to FMUs of both versions: whole groups of variables by name."""

    def __init__(self, path, folder, version, n):
        self.version, self.n = version, n
        self.description = fmpy.read_model_description(str(path))
        self.vrs = {v.name: v.valueReference for v in self.description.modelVariables}
        place = fmpy.extract(str(path), str(folder))
        name = self.description.coSimulation.modelIdentifier
        kind = fmi3.FMU3Slave if version == 3 else fmi2.FMU2Slave
        token = self.description.instantiationToken if version == 3 else self.description.guid
        self.fmu = kind(guid=token, unzipDirectory=place, modelIdentifier=name, instanceName="one")

    def start(self, at=0.0):
        self.fmu.instantiate()
        if self.version == 2:
            self.fmu.setupExperiment(startTime=at)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=at)
        self.fmu.exitInitializationMode()
        return self

    def refs(self, group):
        if self.version == 3 or group in self.vrs:
            return [self.vrs[group]]
        return [self.vrs[f"{group}[{j + 1}]"] for j in range(self.n)]

    def set(self, kind, group, values):
        names = {"real": ("setReal", "setFloat64"), "enum": ("setInteger", "setInt64")}
        names |= {"int": ("setInteger", "setInt32"), "bool": ("setBoolean", "setBoolean")}
        getattr(self.fmu, names[kind][self.version - 2])(self.refs(group), list(values))

    def get(self, kind, group, count=None):
        names = {"real": ("getReal", "getFloat64"), "enum": ("getInteger", "getInt64")}
        names |= {"int": ("getInteger", "getInt32"), "bool": ("getBoolean", "getBoolean")}
        function = getattr(self.fmu, names[kind][self.version - 2])
        return (
            function(self.refs(group), self.n if count is None else count)
            if self.version == 3
            else function(self.refs(group))
        )

    def step(self, at, size):
        self.fmu.doStep(currentCommunicationPoint=at, communicationStepSize=size)

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Path of an FMU of every version, with and without supervisor, and what it was made from."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "dashpot.export.compiler.FLAGS", tuple("-O0" if f == "-O2" else f for f in FLAGS)
        )  # faster
        for version, supervised in CASES:
            export = bundled("k807", "k807-wrist", supervised=supervised)
            path = tmp_path_factory.mktemp("fmu") / f"k807_{version}{'s' if supervised else ''}.fmu"
            assert write_fmu(export, path, version) is not None
            found[version, supervised] = path, export
    return found


def inputs(ticks, n, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(ticks, 7, n)) * np.array([5.0, 0.02, 0.3, 0.02, 0.3, 1.0, 2.0])[:, None]
    values[rng.random(values.shape) < 0.003] = np.nan
    return values


@pytest.mark.parametrize(("version", "supervised"), CASES)
def test_is_valid(built, version, supervised):
    from fmpy.validation import validate_fmu

    path, export = built[version, supervised]
    assert validate_fmu(str(path)) == []
    names = zipfile.ZipFile(path).namelist()
    assert names[0] == "modelDescription.xml"
    assert f"sources/{export.name}.c" in names
    assert ("sources/buildDescription.xml" in names) == (version == 3)
    if version == 3:
        from lxml import etree

        schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd"
        text = zipfile.ZipFile(path).read("sources/buildDescription.xml")
        etree.XMLSchema(etree.parse(str(schema))).assertValid(etree.fromstring(text))


@pytest.mark.parametrize("version", [2, 3])
def test_equal_to_the_controller(built, version, tmp_path):
    path, export = built[version, False]
    n, ticks = len(export.blocks), 3000
    rows = np.zeros((ticks, 7 + 7 * n))
    given_inputs = inputs(ticks, n, 1)
    rows[:, 7:] = given_inputs.reshape(ticks, -1)
    rng = np.random.default_rng(2)
    acts = {
        int(t): (int(rng.integers(1, 4)), int(rng.integers(n))) for t in rng.choice(ticks, 200, replace=False)
    }
    slave = Slave(path, tmp_path / "x", version, n).start()
    mode, loop, warm = [2] * n, [True] * n, [False] * n
    found = np.zeros((ticks, n))
    for tick in range(ticks):
        warm = [False] * n
        action, j = acts.get(tick, (0, 0))
        if action == 1:
            mode[j] = int(rng.integers(3))
            rows[tick, :3] = 1, j, mode[j]
        elif action == 2:
            loop[j] = not loop[j]
            rows[tick, :3] = 2, j, loop[j]
        elif action == 3:
            warm[j] = True
            rows[tick, :3] = 3, j, given_inputs[tick, 2, j]
        for name, values in zip(INPUTS, given_inputs[tick], strict=True):
            slave.set("real", name, values)
        slave.set("enum", "mode", mode)
        slave.set("bool", "position_loop", loop)
        slave.set("bool", "warm_start", warm)
        slave.step(tick * 0.005, 0.005)
        found[tick] = slave.get("real", "command")
    slave.close()
    assert differing(found, in_python(export, rows)[:, :n]) == 0
    assert len(np.unique(found)) > ticks


@pytest.mark.parametrize("version", [2, 3])
def test_supervised_is_equal_to_the_supervisor(built, version, tmp_path):
    path, export = built[version, True]
    n, ticks = len(export.blocks), 1500
    rng = np.random.default_rng(3)
    rows = np.zeros((ticks, 7 + 9 * n))
    walk = np.cumsum(rng.normal(size=(ticks, 7 * n)) * 1e-5, axis=0)
    rows[:, 7 : 7 + 7 * n] = walk
    rows[700:, 7 + 9 * n - 1] = np.arange(ticks - 700)  # the last encoder falls silent
    slave = Slave(path, tmp_path / "x", version, n).start()
    found = np.zeros((ticks, n + 1))
    for tick in range(ticks):
        for i, name in enumerate(INPUTS):
            slave.set("real", name, rows[tick, 7 + i * n : 7 + (i + 1) * n])
        slave.set("int", "torque_age", rows[tick, 7 + 7 * n : 7 + 8 * n].astype(int))
        slave.set("int", "encoder_age", rows[tick, 7 + 8 * n :].astype(int))
        slave.step(tick * 0.005, 0.005)
        found[tick, :n] = slave.get("real", "command")
        found[tick, n] = slave.get("enum", "state", 1)[0] + 4 * slave.get("bool", "apply_brake", 1)[0]
    slave.close()
    expected = in_python(export, rows)
    assert differing(found, expected[:, [*range(n), n + 1]]) == 0
    assert set(found[:, n]) >= {0, 1}


@settings(max_examples=8, deadline=None)
@given(
    parts=st.lists(st.integers(1, 40), min_size=3, max_size=12), start=st.sampled_from([0.0, 0.3, -2.0, 1e4])
)
def test_ticks_do_not_depend_on_the_steps(built, parts, start, tmp_path_factory):
    """Steps of any number of eighths of a period: after each, the torque of the last tick before its end."""
    path, export = built[3, False]
    n, period = len(export.blocks), export.config.period
    total = sum(parts)
    rows = np.zeros((total // 8 + 1, 7 + 7 * n))
    rows[:, 7 : 7 + n] = np.random.default_rng(4).normal(size=n)
    expected = in_python(export, rows)
    slave = Slave(path, tmp_path_factory.mktemp("x"), 3, n).start(start)
    slave.set("real", "torque", rows[0, 7 : 7 + n])
    done = 0
    for part in parts:
        slave.step(start + done * period / 8, part * period / 8)
        done += part
        assert slave.get("real", "command") == expected[(done - 1) // 8, :n].tolist()
    slave.close()


@pytest.mark.parametrize("version", [2, 3])
def test_simulated_by_fmpy(built, version):
    """FMPy's own master, inputs from a table: the torques of the controller."""
    path, export = built[version, False]
    n, ticks = len(export.blocks), 200
    wave = np.sin(np.arange(ticks))[:, None] * np.linspace(1, 2, n)
    columns = [("torque", float, (n,))] if version == 3 else [(f"torque[{j + 1}]", float) for j in range(n)]
    signals = np.zeros(ticks, [("time", float), *columns])
    signals["time"] = 0.005 * np.arange(ticks)
    if version == 3:
        signals["torque"] = wave
    for j in range(n if version == 2 else 0):
        signals[f"torque[{j + 1}]"] = wave[:, j]
    outputs = ["command"] if version == 3 else [f"command[{j + 1}]" for j in range(n)]
    means = {"step_size": 0.005, "output_interval": 0.005, "stop_time": 0.005 * (ticks - 1)}
    result = fmpy.simulate_fmu(str(path), input=signals, output=outputs, **means)
    found = result["command"] if version == 3 else np.stack([result[name] for name in outputs], axis=1)
    rows = np.zeros((ticks, 7 + 7 * n))
    rows[:, 7 : 7 + n] = wave
    assert found[1:].shape == (ticks - 1, n)
    assert found[1:] == pytest.approx(in_python(export, rows)[: ticks - 1, :n], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("version", [2, 3])
def test_state_is_a_copy(built, version, tmp_path):
    """From a saved, and from a serialised state, the same inputs give the same torques again."""
    path, export = built[version, False]
    n = len(export.blocks)
    slave = Slave(path, tmp_path / "x", version, n).start()
    values = inputs(30, n, 5)

    def run(first, last):
        found = []
        for tick in range(first, last):
            slave.set("real", "torque", values[tick, 0])
            slave.step(tick * 0.005, 0.005)
            found.append(slave.get("real", "command"))
        return found

    run(0, 10)
    fmu = slave.fmu
    state = fmu.getFMUState() if version == 3 else fmu.getFMUstate()
    kept = fmu.serializeFMUState(state) if version == 3 else fmu.serializeFMUstate(state)
    first = run(10, 30)
    (fmu.setFMUState if version == 3 else fmu.setFMUstate)(state)
    assert run(10, 30) == first
    again = fmu.deserializeFMUState(kept) if version == 3 else fmu.deSerializeFMUstate(kept)
    (fmu.setFMUState if version == 3 else fmu.setFMUstate)(again)
    assert run(10, 30) == first
    (fmu.freeFMUState if version == 3 else fmu.freeFMUstate)(state)
    fmu.reset()
    slave.close()


@pytest.mark.parametrize("version", [2, 3])
def test_refuses_what_cannot_be(built, version, tmp_path):
    path, export = built[version, False]
    n = len(export.blocks)
    slave = Slave(path, tmp_path / "x", version, n).start()
    before = slave.get("real", "command")
    for wrong in (
        lambda: slave.set("enum", "mode", [3] * n),
        lambda: slave.set("real", "command", [1.0] * n),
        lambda: slave.set("real", "mode", [1.0] * n),
        lambda: slave.step(0.0, -0.005),
        lambda: slave.step(0.0, float("nan")),
        lambda: slave.step(1.0, 0.005),
    ):
        with pytest.raises(Exception, match=r"fmi[23]|failed|status"):
            wrong()
    assert slave.get("real", "command") == before == [0.0] * n
    slave.step(0.0, 0.005)
    slave.close()
    other = Slave(path, tmp_path / "y", version, n)
    other.fmu.guid = "{another}"
    with pytest.raises(Exception, match="nstantiate"):
        other.fmu.instantiate()


@pytest.mark.parametrize("version", [2, 3])
def test_declarations_are_those_of_the_standard(version, tmp_path):
    """The sources compile without a warning, also against the standard's own headers, which FMPy brings."""
    for supervised in (False, True):
        for name, data in fmu_files(bundled("fr3", "fr3", supervised=supervised), version).items():
            (tmp_path / Path(name).name).write_bytes(data)
        command = [*(compiler() or []), "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
        command += [str(tmp_path / f"fmi{version}.c")]
        headers = Path(fmpy.__file__).parent / "c-code"
        subprocess.run([*command, "-pedantic"], check=True)
        subprocess.run(
            [*command, "-DFMI_STANDARD_HEADERS", f"-I{headers}", "-Wno-strict-prototypes"], check=True
        )


def test_same_bytes_every_time(tmp_path):
    export = bundled("fr3", "fr3")
    for name in "ab":
        assert write_fmu(export, tmp_path / name, 3, binary=False) is None
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert not any("binaries" in name for name in zipfile.ZipFile(tmp_path / "a").namelist())


def test_units_and_structure(built):
    """Arrays in 3.0, scalars in 2.0, the same start values, units of SI."""
    arrays = fmpy.read_model_description(str(built[3, False][0]))
    scalars = fmpy.read_model_description(str(built[2, False][0]))
    n = len(built[3, False][1].blocks)
    assert float(arrays.coSimulation.fixedInternalStepSize) == built[3, False][1].config.period
    by_name = {v.name: v for v in scalars.modelVariables}
    for v in arrays.modelVariables:
        if v.name == "time":
            continue
        assert [int(d.start) for d in v.dimensions] == [n]
        for j in range(n):
            twin = by_name.pop(f"{v.name}[{j + 1}]")
            assert (twin.causality, twin.variability, twin.unit) == (v.causality, v.variability, v.unit)
            assert twin.start == (v.start and v.start.split()[j])
    assert by_name == {}
    units = {u.name: u.baseUnit for u in arrays.unitDefinitions}
    assert json.dumps([units["N.m"].kg, units["N.m"].m, units["N.m"].s]) == "[1, 2, -2]"
