import math
import re

import numpy as np
import pytest

from deploy.cli.run import _guarded
from deploy.controller.artifact import Artifact
from deploy.controller.file import to_bytes
from deploy.twin.faults import parse
from deploy.twin.peak_force import PeakForces
from deploy.twin.residual import SETTLE, FlownResiduals
from jaxmpc.cli import main
from tests.deploy.conftest import trace
from tests.deploy.made import LOOP, arm_artifact, guarded_gains, margin_row, text_gains


@pytest.fixture(scope="module")
def controller(tmp_path_factory):
    path = tmp_path_factory.mktemp("frozen") / "controller.npz"
    path.write_bytes(to_bytes(arm_artifact()))
    return path


@pytest.fixture
def fly(controller, tmp_path, capsys):
    def run(*flags):
        code = main(["run", str(controller), "--lockstep", "--rhythm", "none", "-o", str(tmp_path / "flights"), *flags])
        return code, capsys.readouterr()

    return run


def test_a_run_that_ends_well_leaves_no_recording_unless_asked(fly, tmp_path):
    code, said = fly("--duration", "0.5")
    assert code == 0
    assert "contact: the controller is in charge" in said.out
    assert "ended: stopped, finished" in said.out
    assert "guard: none\n" in said.out
    assert not (tmp_path / "flights").exists()


def test_a_run_against_the_twin_tells_the_residual_measured_and_true(fly):
    """The heart stands still: what is left is the sensor's noise and rounding, 10 mN, and hardly any of the force."""
    code, said = fly("--duration", "6.5")
    assert code == 0
    rows = {line[:12].strip(): line[12:] for line in said.out.splitlines() if line.startswith(("  measured", "  true"))}
    assert list(rows) == ["measured", "true force"]
    measured, true = ([float(x) for x in re.findall(r"/ ([0-9.]+)", row)] for row in rows.values())
    assert len(measured) == len(true) == 3
    assert all(0.008 < x < 0.05 for x in measured)
    assert all(0.0 < x < y for x, y in zip(true, measured, strict=True))


def test_a_flight_too_short_tells_none_and_a_lost_force_counts_for_the_true_one_alone():
    residuals = FlownResiduals()
    residuals.add(SETTLE - 1e-3, (0.0, 0.0, -5.0), (9.0, 9.0, 9.0), (9.0, 9.0, 9.0))
    (short,) = residuals.report()
    assert short.startswith("no residual")
    residuals.add(SETTLE, (0.0, 0.0, -5.0), (9.0, 9.0, 9.0), (9.0, 9.0, 9.0))
    assert residuals.report() == [short], "a single sample has no peak to peak"
    residuals = FlownResiduals()
    random = np.random.default_rng(0)
    wanted, measured, true = random.normal(size=(3, 50, 3))
    for k, rows in enumerate(zip(wanted, measured, true, strict=True)):
        ref, force, known = map(tuple, rows)
        residuals.add(SETTLE + k, ref, None if k == 3 else (math.nan,) * 3 if k == 4 else force, known)
    kept = np.delete(measured - wanted, (3, 4), axis=0)
    for line, error in zip(residuals.report()[1:], (kept, true - wanted), strict=True):
        found = [[float(x) for x in pair.split(" / ")] for pair in re.findall(r"[0-9.]+ / [0-9.]+", line)]
        expected = np.stack([np.ptp(error, axis=0), np.sqrt(np.mean(error**2, axis=0))], axis=1)
        np.testing.assert_allclose(found, expected, atol=6e-4)


def test_a_fault_is_recorded_named_and_replayed(fly, tmp_path, controller, capsys):
    log = tmp_path / "bus.log"
    code, said = fly("--fault", "force:off@5", "--duration", "3", "--bus-log", str(log))
    assert code == 1
    assert "ended: stopped, force-lost" in said.out
    (flight,) = (tmp_path / "flights").iterdir()
    assert main(["replay", str(flight), "--artifact", str(controller)]) == 0
    assert "written because: force-lost" in capsys.readouterr().out
    assert "can0 401#AA" in log.read_text()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--hz", "500"], ["500 Hz", "1000 Hz", "Freeze"]),
        (["--hz", "nan"], ["1000 Hz", "Freeze"]),
        (["--reference", "0,0,-50"], ["50 N", "at most 12 N"]),
        (["--reference", "nowhere.csv"], ["nowhere.csv", "existing file"]),
        (["--fault", "force:stuk@3"], ["force:stuk@3", "stuck"]),
        (["--rhythm", "bigemini"], ["bigeminy"]),
        (["--mount", "1,2"], ["--mount", "three angles"]),
        (["--duration", "0"], ["--duration", "86400"]),
        (["--approach-speed", "500"], ["--approach-speed", "50] mm/s", "slowly"]),
        (["--retract", "500"], ["--retract", "200] mm.", "30 is usual"]),
        (["--sensor", "ati"], ["--sensor", "jr3"]),
        (["--sensor", "can:7"], ["--sensor", "can or jr3:DEVICE"]),
        (["--sensor", "jr3:/dev/comedi0"], ["--sensor", "left out with --lockstep"]),
        (["--rate", "inf"], ["--rate", "100"]),
    ],
)
def test_wrong_arguments_exit_2_with_a_sentence(fly, flags, words):
    code, said = fly(*flags)
    assert code == 2
    assert said.err.count("\n") == 1
    assert all(word in said.err for word in words), said.err


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["-i", "slcan", "-c", "/dev/ttyACM0"], ["--interface", "watchdog", "slcand"]),
        (["-i", "virtual", "-c", "nobody", "--reference", "-"], ["--arm", "Standard input"]),
    ],
)
def test_what_no_arm_can_be_driven_with_is_refused_before_a_bus_is_opened(controller, capsys, flags, words):
    assert main(["run", str(controller), *flags]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert all(word in said for word in words), said


def test_a_linear_controller_only_replays(tmp_path, capsys):
    gains, row = text_gains(), margin_row(810.0)
    golden = trace(gains, 40, False)
    linear = Artifact(gains, 1e-3, 10.0, False, LOOP, {"lam": 0.1}, [row], {"M_s": 2.0}, {"made": "here"}, *golden)
    path = tmp_path / "linear.npz"
    path.write_bytes(to_bytes(linear))
    assert main(["run", str(path), "--lockstep"]) == 2
    assert "only replays" in capsys.readouterr().err


def test_what_is_no_controller_is_refused(tmp_path, capsys):
    assert main(["run", str(tmp_path / "nothing.npz"), "--lockstep"]) == 2
    (tmp_path / "foreign.npz").write_bytes(b"PK" + bytes(200))
    assert main(["run", str(tmp_path / "foreign.npz"), "--lockstep"]) == 1
    assert "refused" in capsys.readouterr().err


def test_nothing_moves_without_the_controllers_name(controller, monkeypatch, capsys):
    """Over a bus; python-can's virtual one has nobody on it, so even the start is refused."""
    assert main(["run", str(controller), "-i", "virtual", "-c", "nobody", "--arm", "0" * 8]) == 1
    assert "nobody answers on this bus" in capsys.readouterr().err


def test_without_a_bus_nothing_begins(controller, capsys):
    assert main(["run", str(controller), "--arm", "0" * 8]) == 2
    said = capsys.readouterr()
    assert "--interface = left out: must be given" in said.err
    assert "or fly against the twin, --lockstep" in said.err
    assert "sha256" not in said.out


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("--lockstep", "-i", "virtual"), "--interface"),
        (("--lockstep", "--cpu", "1"), "--cpu"),
        (("--lockstep", "--bitrate", "500000"), "--bitrate"),
        (("-i", "virtual", "-c", "a", "--fault", "force:stuck@1"), "--fault = force:stuck@1:"),
        (("-i", "virtual", "-c", "a", "--stiffness", "500"), "--stiffness"),
        (("-i", "virtual", "-c", "a", "--experiment", "nosuch.toml"), "--experiment"),
    ],
)
def test_what_would_have_no_effect_is_refused(controller, words, key, capsys):
    assert main(["run", str(controller), *words]) == 2
    assert key in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        *("stifness = [900.0]", "stiffness = 900.0", 'stiffness = ["a"]', 'delay = "x"', "delay = true", "sensor = 3"),
        *("[sensor]\nlsb = 0.006", "[sensor]\nnois = 0.01", '[sensor]\nnoise = "a"'),
    ],
)
def test_an_experiment_that_is_none_is_one_sentence(controller, text, tmp_path, capsys):
    (tmp_path / "e.toml").write_text(text)
    assert main(["run", str(controller), "--lockstep", "--experiment", str(tmp_path / "e.toml")]) == 2
    said = capsys.readouterr().err
    assert "e.toml:" in said
    assert said.count("\n") == 1


def test_a_bus_log_is_written_over_nothing(controller, tmp_path, capsys):
    kept = controller.read_bytes()
    assert main(["run", str(controller), "--lockstep", "--bus-log", str(controller)]) == 2
    assert "--bus-log" in capsys.readouterr().err
    assert controller.read_bytes() == kept


def test_a_fault_that_never_began_is_told():
    lines = PeakForces().report([parse("force:stuck@99")], ["force:stuck@99"], True, 7.3, 15.0)
    assert lines[-1] == "NEVER BEGAN: fault force:stuck@99; the run ended 7.3 s after the twin began"


@pytest.mark.parametrize(
    ("gain", "said"),
    [
        ([1.0, 1.0, 1.0, math.nan], "guard: at rest in the last 10.0 s, the gain stayed whole"),
        ([1.0, 0.3, 0.8, 0.8], "guard: lowest gain in the last 15.0 s 0.30 at 25.0 s, 0.80 at the end"),
        ([math.nan] * 4, "guard: no gain was recorded"),
        ([], "guard: no gain was recorded"),
    ],
)
def test_what_a_guard_did_is_told_of_the_recorded_stretch(gain, said):
    time = 20.0 + 5.0 * np.arange(len(gain))
    assert _guarded({"gain": np.array(gain)[:, None], "time": time[:, None]}) == said


def test_a_flight_with_a_guard_tells_what_it_did(tmp_path, capsys):
    path = tmp_path / "controller.npz"
    path.write_bytes(to_bytes(arm_artifact(gains=guarded_gains())))
    assert main(["run", str(path), "--lockstep", "--rhythm", "none", "--duration", "0.3"]) == 0
    assert re.search(r"guard: .* in the last \d+\.\d s", capsys.readouterr().out)
