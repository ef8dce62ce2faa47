"""Flights made by the runtime itself, recorded, and replayed through it and through the traced law."""

import hashlib
import math
import re
import shutil
from argparse import ArgumentParser
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from deploy.controller.file import load, to_bytes
from deploy.controller.runtimes import arm_runtime
from deploy.flight import inputs as inputs_module
from deploy.flight.forgetting import SETTLING, observers_forget
from deploy.flight.inputs import KNOWN, inputs_of
from deploy.flight.recorder import COLUMNS, FlightRecorder, FlightRecording, RecordingError, read
from deploy.flight.replay import compare, through_runtime
from deploy.loop.loop import STATES
from deploy.safety.machine import BRIDGED
from deploy.safety.reasons import Reason
from jaxmpc.cli import replay as verb
from jaxmpc.cli.flight_report import _states
from jaxmpc.files.errors import InputError
from jaxmpc.law import cascade
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gains import constant_reference
from jaxmpc.law.reference import told
from jaxmpc.pictures import recording_figure
from jaxmpc.pictures.figures import figure
from tests.deploy import made
from tests.twin import flying

pytestmark = pytest.mark.once

NAMES = {"state": ["idle", "armed", "approach", "contact", "retract", "stopped", "fault"]}
IDLE, APPROACH, CONTACT, RETRACT = 0, 2, 3, 4
STIFFNESS = 80.0
NAN = (float("nan"),) * 3


def fly(artifact, samples=1500, contact=(300, 1300), seconds=10.0, change=None, lost=(500, 501), missed=()):
    """A recorder after a run: angles that sway, a force with noise, samples lost, torques clamped now and then.

    `change(k, runtime)` may meddle with the controller at a sample; missed cycles move the velocity alone.
    """
    runtime, recorder = arm_runtime(artifact), FlightRecorder(seconds=seconds)
    swing = made.SWING if artifact.gains.guard else 0.0
    q_all, force_all, wanted_all = made.recorded_inputs(samples, width=64 if artifact.preview else 1, swing=swing)
    wanted_all = told(wanted_all) if artifact.preview else wanted_all
    runtime.start(tuple(q_all[0]))
    for k in range(samples):
        q, force = tuple(q_all[k]), tuple(force_all[k])
        if artifact.gains.schedule:  # a tissue, whose stiffness can be found
            pressed = zip(force, runtime.tip(q), runtime.tip(tuple(q_all[0])), strict=True)
            force = tuple(y + STIFFNESS * (x - touched) for y, x, touched in pressed)
        ref = tuple(map(tuple, wanted_all[k])) if artifact.preview else tuple(axis[0] for axis in wanted_all[k])
        first = tuple(axis[0] for axis in wanted_all[k])
        qd = runtime.velocity(q)
        if k in missed:
            continue
        if change:
            change(k, runtime)
        if contact[0] <= k < contact[1]:
            state = CONTACT
            if k == contact[0]:
                runtime.enter(force, q)
            given = None if k in lost else force
            wanted = runtime.control(q, qd, given, ref)
            applied = (wanted[0], wanted[1] - (0.3 if k % 50 == 7 else 0.0), *wanted[2:])
            runtime.applied(applied)
        else:
            state, given = APPROACH if k < contact[0] else RETRACT, force
            wanted = applied = runtime.servo(q, qd, (0.1, 0.0, -0.2), force)
        row = (1e-3 * k, *(given or NAN), *first, *runtime.u, *runtime.last_v, *runtime.last_a, *runtime.p_hat)
        row += (runtime.gain, *runtime.stiffness, *runtime.authority, *runtime.dither)
        row += (*runtime.tip(q), *q, *applied, *qd, *runtime.memory[1:], *runtime.deflection, runtime.swing_share)
        row += (*wanted, *applied, state, *(0,) * 13)
        recorder.append(row)
    return recorder


def flown(folder, **options):
    """A folder with a controller's file and the recording of its flight."""
    (folder / "controller.npz").write_bytes(to_bytes(made.arm_artifact(**options)))
    artifact = load(folder / "controller.npz")
    write(folder / "flight.npz", folder / "controller.npz", fly(artifact))
    return folder


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    return flown(tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module", params=["preview", "compensated", "guarded", "observed", "scheduled", "foreseeing"])
def other_flight(request, tmp_path_factory):
    special = {
        "guarded": {"gains": made.guarded_gains()},
        "observed": {"momentum_observer": 60.0},
        "scheduled": {"gains": made.scheduled_gains()},
        "foreseeing": {"gains": made.scheduled_gains(), "preview": True},
    }
    options = special.get(request.param) or {request.param: True}
    return flown(tmp_path_factory.mktemp(request.param), **options)


def write(path, controller, recorder, **header):
    sha256 = hashlib.sha256(controller.read_bytes()).hexdigest()
    about = {"artifact": sha256, "reason": "operator", "T_s": 1e-3, "names": NAMES} | header
    assert "samples in" in recorder.write(path, about)


def replay(*words):
    parser = ArgumentParser()
    verb.configure(parser)
    return verb.run(parser.parse_args([str(word) for word in words]))


def test_a_flight_is_replayed_by_the_runtime_to_the_last_bit(other_flight):
    recording, artifact = read(other_flight / "flight.npz"), load(other_flight / "controller.npz")
    inputs = inputs_of(recording, artifact, recording.header["artifact"])
    rows = {row.signal: row for row in compare(recording, inputs, through_runtime(inputs, artifact))}
    assert {row.largest for row in rows.values()} == {0.0}
    gain = recording.signals["gain"][inputs.contact, 0]
    assert (gain.min() < 0.5) == (artifact.gains.guard is not None)
    assert rows["gain"].samples == rows["v"].samples
    known = recording.signals["stiffness"][inputs.contact]
    assert (np.ptp(known[:, 0]) > 5.0) == (artifact.gains.schedule is not None)
    assert (np.max(known) > 0.0) == (artifact.gains.schedule is not None)
    assert (np.max(recording.signals["authority"]) > 0.0) == (artifact.gains.schedule is not None)
    assert (np.max(np.abs(recording.signals["dither"])) > 0.1) == (artifact.gains.schedule is not None)
    known = 1000 - (64 if artifact.preview else 0)  # the last wanted forces lie beyond the contact
    assert rows["v"].samples == known
    assert rows["wanted"].samples == known + 500 - artifact.arm.compensated  # where its friction begins
    assert rows["qd"].samples == 1500 - 301


def replayed(artifact, recorder, folder):
    """How the runtime differs from what flew, by signal."""
    recorder.write(folder / "flight.npz", {"artifact": "", "T_s": made.T_S, "names": NAMES})
    recording = read(folder / "flight.npz")
    inputs = inputs_of(recording, artifact, "")
    return {row.signal: row for row in compare(recording, inputs, through_runtime(inputs, artifact))}


def test_positions_that_came_and_were_refused_are_no_difference():
    """An encoder leaps farther than a motor turns: nothing is computed from what it reads from then on."""
    artifact = made.arm_artifact()
    flight = flying.fly(artifact, "J4:wrong=150@0.6", seconds=0.1)
    assert Reason.ENCODER_JUMP in {state.reason for state in flight.safety_states}
    recording = FlightRecording({"artifact": "", "T_s": made.T_S, "names": {"state": list(STATES)}}, flight.signals())
    assert recording.signals["position_age"][:, 3].max() > BRIDGED
    inputs = inputs_of(recording, artifact, "")
    assert not [row for row in compare(recording, inputs, through_runtime(inputs, artifact)) if row.parts]


def test_cycles_that_were_missed_are_no_difference(tmp_path):
    rows = replayed(made.arm_artifact(), fly(made.arm_artifact(), missed=(297, 1000)), tmp_path)
    assert {row.largest for row in rows.values()} == {0.0}
    assert rows["v"].samples == 999
    assert rows["qd"].samples == pytest.approx(1000 - 598 + 1500 - 1301, abs=2)  # 0.3 s, but for rounding


@pytest.mark.parametrize("cutoff", [30.0, 180.0])
def test_velocities_are_judged_once_their_filter_has_forgotten_what_was_before_the_recording(tmp_path, cutoff):
    artifact = made.arm_artifact()
    artifact = replace(artifact, loop=artifact.loop._replace(velocity_cutoff=cutoff))
    rows = replayed(artifact, fly(artifact, samples=3000, contact=(2600, 2800), seconds=2.0), tmp_path)
    assert not any(row.parts for row in rows.values())
    assert rows["qd"].samples == {30.0: 2000 - 834, 180.0: 2000 - 301}[cutoff]
    assert rows["qd"].largest < 1e-11


@pytest.mark.oracle
def test_friction_is_cancelled_again_as_it_was_where_the_recording_begins_later_than_the_flight(tmp_path, capsys):
    controller = tmp_path / "controller.npz"
    controller.write_bytes(to_bytes(made.arm_artifact(compensated=True)))
    write(tmp_path / "flight.npz", controller, fly(load(controller), contact=(1200, 1400), seconds=0.8))
    assert np.max(np.abs(read(tmp_path / "flight.npz").signals["deflection"][0])) > 0.5
    assert replay(tmp_path / "flight.npz", "--artifact", controller) == 0
    assert re.search(r"wanted +799 ", capsys.readouterr().out)


@pytest.mark.oracle
def test_both_programs_agree_with_the_flight(other_flight, capsys):
    assert replay(other_flight / "flight.npz", "--artifact", other_flight / "controller.npz") == 0
    out = capsys.readouterr().out
    assert "1500 samples, 0.000 to 1.499 s, 1000 in contact" in out
    assert "forces missing in contact, bridged: 2" in out
    assert "runtime against what flew" in out
    assert "simulator's law against what flew" in out
    assert "the same, within the tolerance" in out


@pytest.mark.oracle
@pytest.mark.parametrize("gains", [made.text_gains(), made.guarded_gains()], ids=["text", "guarded"])
def test_a_recording_that_begins_in_contact_settles(tmp_path, capsys, gains):
    controller = tmp_path / "controller.npz"
    controller.write_bytes(to_bytes(made.arm_artifact(gains=gains)))
    write(tmp_path / "flight.npz", controller, fly(load(controller), 8000, contact=(720, 8000), seconds=7.0))
    recording = read(tmp_path / "flight.npz")
    assert recording.signals["time"][0, 0] == 1.0
    assert replay(tmp_path / "flight.npz", "--artifact", controller) == 0

    artifact = load(controller)
    inputs = inputs_of(recording, artifact, recording.header["artifact"])
    again = through_runtime(inputs, artifact)
    assert not np.array_equal(again["v"][5], recording.signals["v"][5])
    assert np.mean(inputs.judged) > 0.2
    assert (recording.signals["gain"].min() < 0.9) == (gains.guard is not None)
    # why SETTLING is enough: half of it is
    late = np.cumsum(recording.signals["gain"]) * 1e-3 >= 0.5 * SETTLING if gains.guard is None else inputs.judged
    assert np.max(np.abs(again["v"] - recording.signals["v"])[late]) < 1e-11
    capsys.readouterr()


@pytest.mark.parametrize(("bandwidth", "judged"), [(12.0, True), (5.0, False)])
def test_a_recording_that_begins_in_contact_is_judged_once_a_slow_observer_has_forgotten(tmp_path, bandwidth, judged):
    artifact = made.arm_artifact(momentum_observer=bandwidth)
    rows = replayed(artifact, fly(artifact, samples=3200, contact=(100, 3200), seconds=3.0), tmp_path)
    assert not any(row.parts for row in rows.values())
    assert (rows["v"].samples > 0) == judged


@pytest.mark.parametrize(("gain", "judged_from"), [(1.0, 199), (0.5, 399), (0.0, 199)])
def test_with_less_gain_observers_take_longer_to_forget(flight, monkeypatch, gain, judged_from):
    artifact, recording = load(flight / "controller.npz"), read(flight / "flight.npz")
    monkeypatch.setattr(inputs_module, "observers_forget", lambda artifact: 0.2)
    signals = {name: each[400:1200] for name, each in recording.signals.items()}
    signals["gain"] = np.full_like(signals["gain"], gain)  # none at all was recorded by no law
    inputs = inputs_of(FlightRecording(recording.header, signals), artifact, recording.header["artifact"])
    assert int(np.argmax(inputs.judged)) == pytest.approx(judged_from, abs=1)


@pytest.mark.parametrize("told", [True, False])
def test_a_lasting_swing_that_began_before_the_recording_is_no_difference(monkeypatch, told):
    """Its share is forgotten within seconds only; recordings from before it was told are judged as late as that."""
    artifact = made.arm_artifact(gains=made.guarded_gains())
    monkeypatch.setattr(made, "SWING", 0.04)
    monkeypatch.setattr(made, "SWINGING", 3000)
    flown = fly(artifact, samples=3000, contact=(100, 3000), seconds=2.4).signals()
    recording = FlightRecording({"artifact": "", "T_s": made.T_S, "names": NAMES}, flown)
    assert recording.signals["swing_share"][0] > 0.2
    signals = {name: rows for name, rows in recording.signals.items() if told or name != "swing_share"}
    inputs = inputs_of(replace(recording, signals=signals), artifact, "")
    rows = {row.signal: row for row in compare(recording, inputs, through_runtime(inputs, artifact))}
    assert not any(row.parts for row in rows.values())
    assert (rows["gain"].samples > 0) == told


def test_observers_forget_a_wrong_beginning_within_the_time_that_a_replay_leaves_out():
    for Ky, Kr in ((0.02, 0.1), (0.5, 150.0)):
        gains = made.text_gains()._replace(force_filter=ForceFilter(made.T_S, Ky, Kr))
        artifact = replace(made.arm_artifact(), gains=gains)
        law = constant_reference(gains)
        one, other = cascade.init(law, -5.0), cascade.init(law, 3.0)
        samples = round(observers_forget(artifact) / made.T_S)
        assert (samples > 2000) == (Ky < 0.1)
        for k in range(samples):
            force, applied = -5.0 + math.sin(0.01 * k), math.cos(0.02 * k)
            (one, v), (other, same) = (cascade.step(law, each, force, (-5.0,)) for each in (one, other))
            if k == 1000:
                assert (abs(v - same) > 1e-6) == (Ky < 0.1)
            one, other = one._replace(v=applied), other._replace(v=applied)
        assert abs(v - same) < 1e-11


def test_a_recording_of_whose_law_nothing_can_be_judged_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(verb, "find_spec", lambda name: None)
    controller = tmp_path / "controller.npz"
    controller.write_bytes(to_bytes(made.arm_artifact()))
    write(tmp_path / "flight.npz", controller, fly(load(controller), contact=(100, 1500), seconds=1.0))
    with pytest.raises(InputError, match=r"No sample of the law could be judged.*--recorded"):
        replay(tmp_path / "flight.npz", "--artifact", controller)


@pytest.mark.parametrize(
    ("signal", "value", "text"),
    [
        ("qd", np.nan, "qd is no number somewhere in contact"),
        ("force_ref", np.nan, "force_ref is no number"),
        ("applied", np.nan, "applied is no number"),
        ("force_ref", np.inf, "force_ref is beyond"),
        ("applied", -np.inf, "applied is beyond"),
        ("force", np.inf, "force is beyond"),
    ],
)
def test_inputs_after_which_nothing_could_be_compared_are_refused(flight, signal, value, text):
    """They would make everything after them no number, and the same for want of a difference."""
    recording, artifact = read(flight / "flight.npz"), load(flight / "controller.npz")
    damaged = recording.signals[signal].copy()
    damaged[700, 1] = value
    with pytest.raises(RecordingError, match=text):
        inputs_of(
            replace(recording, signals=recording.signals | {signal: damaged}), artifact, recording.header["artifact"]
        )


def test_what_is_computed_to_be_no_number_is_a_difference(flight):
    recording, artifact = read(flight / "flight.npz"), load(flight / "controller.npz")
    inputs = inputs_of(recording, artifact, recording.header["artifact"])
    computed = recording.signals["v"].copy()
    computed[800:] = np.nan
    (row,) = compare(recording, inputs, {"v": computed})
    assert (row.parts, row.samples, row.first, row.by) == (True, 1000, pytest.approx(0.8), np.inf)
    both = replace(recording, signals=recording.signals | {"v": computed})
    assert not compare(both, inputs, {"v": computed})[0].parts


def test_a_schedule_whose_contact_is_not_in_the_recording_is_refused(tmp_path):
    controller = tmp_path / "controller.npz"
    controller.write_bytes(to_bytes(made.arm_artifact(gains=made.scheduled_gains())))
    write(tmp_path / "flight.npz", controller, fly(load(controller), seconds=0.5, contact=(300, 1500)))
    with pytest.raises(InputError, match=r"goes back to the contact.*--recorded"):
        replay(tmp_path / "flight.npz", "--artifact", controller)


def test_a_recording_from_before_there_were_schedules_is_replayed(flight, tmp_path):
    recording = read(flight / "flight.npz")
    columns = {name: column for name, column in COLUMNS.items() if name not in KNOWN}
    recorder = FlightRecorder(columns, seconds=10.0)
    for row in np.hstack([recording.signals[name] for name in columns]):
        recorder.append(row)
    write(tmp_path / "old.npz", flight / "controller.npz", recorder)
    assert replay(tmp_path / "old.npz", "--artifact", flight / "controller.npz", "--report", tmp_path / "a.html") == 0


@pytest.mark.oracle
def test_it_shows_where_a_flight_parts(tmp_path, capsys):
    controller = tmp_path / "controller.npz"
    controller.write_bytes(to_bytes(made.arm_artifact()))

    def slip(k, runtime):
        if k == 800:
            memory, p_hat = runtime._memory, runtime.p_hat[0]
            at = memory.index(p_hat)
            runtime._held[0] = (*memory[:at], p_hat + 1e-3, *memory[at + 1 :])

    write(tmp_path / "flight.npz", controller, fly(load(controller), change=slip))
    report = tmp_path / "flight.html"
    words = (tmp_path / "flight.npz", "--artifact", controller)
    assert replay(*words, "--report", report) == 1
    out = capsys.readouterr().out
    assert "they part: first" in out
    assert "at 0.800 s" in out
    assert out.count("at 0.800 s by") == 8  # v, a, p_hat and torques of both programs; u a sample later
    page = report.read_text(encoding="utf-8")
    assert "0.800" in page
    assert page.count('class="chart"') > 30
    assert replay(*words, "--tolerance", "0.5") == 0


def test_the_report_begins_with_the_verdict_and_leaves_out_what_rests(flight, tmp_path, monkeypatch):
    monkeypatch.setattr(verb, "find_spec", lambda name: None)
    report = tmp_path / "a.html"
    assert replay(flight / "flight.npz", "--artifact", flight / "controller.npz", "--report", report) == 0
    page = report.read_text(encoding="utf-8")
    assert "<h1>Flight flight</h1>" in page
    assert "Computed anew by runtime: the same, within the tolerance." in page
    assert "The same throughout: gain 1, stiffness 0 N/m, authority 0, dither 0 N." in page
    assert _states(read(flight / "flight.npz")) == "2 approach, 3 contact, 4 retract"


def test_the_picture_shows_a_guard_and_a_believed_stiffness_where_there_is_one(other_flight, tmp_path, monkeypatch):
    drawn = []

    @contextmanager
    def kept(*args, **options):
        with figure(*args, **options) as axes:
            drawn.extend(axes)
            yield axes

    monkeypatch.setattr(recording_figure, "figure", kept)
    monkeypatch.setattr(verb, "find_spec", lambda name: name == "matplotlib" or None)
    controller = other_flight / "controller.npz"
    assert replay(other_flight / "flight.npz", "--artifact", controller, "--picture", tmp_path / "a.png") == 0
    gains = load(controller).gains
    assert len(drawn) == 4 + (gains.guard is not None or gains.schedule is not None)
    lines = {line.get_label(): line for axes in drawn[0].figure.axes for line in axes.lines}
    assert ("gain left by the guard" in lines) == (gains.guard is not None)
    assert "0 clamped in contact" in lines
    in_contact = read(other_flight / "flight.npz").signals["state"][:, 0] == CONTACT
    believed = [line for label, line in lines.items() if label.startswith("K̂")]
    assert len(believed) == (0 if gains.schedule is None else 3)
    for line in believed:
        np.testing.assert_array_equal(np.isfinite(line.get_ydata()), in_contact)


def test_a_missing_simulator_is_said(flight, capsys, monkeypatch):
    monkeypatch.setattr(verb, "find_spec", lambda name: None)
    assert replay(flight / "flight.npz", "--artifact", flight / "controller.npz") == 0
    assert "jax is not installed here" in capsys.readouterr().out


def test_wrong_files_are_refused(flight, tmp_path):
    recording, controller = flight / "flight.npz", flight / "controller.npz"
    other = tmp_path / "other.npz"
    other.write_bytes(to_bytes(made.arm_artifact(n=41)))
    damaged = tmp_path / "damaged.npz"
    shutil.copyfile(recording, damaged)
    damaged.write_bytes(damaged.read_bytes()[:-1])
    cases = [
        ((recording, "--artifact", other), "the controller that flew has the sha256"),
        ((recording, "--artifact", tmp_path / "none.npz"), "cannot be read"),
        ((controller, "--artifact", controller), "no flight recording"),
        ((damaged, "--artifact", controller), "cut short"),
        ((tmp_path / "none.npz", "--artifact", controller), r"^recording = \S+none.npz: must be a readable file\. It"),
        ((recording, "--artifact", controller, "--tolerance", "0"), "in \\(0, 1\\)"),
        ((recording, "--artifact", controller, "--report", tmp_path / "no" / "a.html"), "can be written"),
    ]
    for words, text in cases:
        with pytest.raises(InputError, match=text):
            replay(*words)


@pytest.mark.parametrize(
    ("header", "columns", "text"),
    [
        ({"T_s": 2e-3}, COLUMNS, "every 0.002 s"),
        ({"names": None}, COLUMNS, "does not name the states"),
        ({"names": {"state": ["idle"]}}, COLUMNS, "does not name the states"),
        ({"names": {"state": ["idle", "contact", ["armed"]]}}, COLUMNS, "does not name the states"),
        ({"names": {"state": ["idle", "contact", r"$\frac{$"]}}, COLUMNS, "does not name the states"),
        ({"names": {"state": ["idle", "contact", "a" * 41]}}, COLUMNS, "does not name the states"),
        ({}, {name: width for name, width in COLUMNS.items() if name != "torque"}, "lacks the signal torque"),
        ({}, {name: width for name, width in COLUMNS.items() if name != "clamped"}, "lacks the signal clamped"),
        ({}, {name: width for name, width in COLUMNS.items() if name != "applied"}, "lacks the signal applied"),
    ],
)
def test_recordings_that_lack_something_are_refused(flight, tmp_path, header, columns, text):
    recorder = FlightRecorder(columns, seconds=0.01)
    write(tmp_path / "flight.npz", flight / "controller.npz", recorder, **header)
    with pytest.raises(InputError, match=text):
        replay(tmp_path / "flight.npz", "--artifact", flight / "controller.npz")


@pytest.mark.parametrize(
    ("signal", "value", "text"),
    [
        ("time", np.nan, "times do not rise"),
        ("time", -1.0, "times do not rise"),
        ("state", np.nan, "states that its header does not name"),
        ("state", 99.0, "states that its header does not name"),
        ("force", 1e308, "force is beyond"),
        ("q", -1e200, "q is beyond"),
        ("deflection", 1e200, "deflection is beyond"),
        ("torque", 1e308, "torque is beyond"),
        ("stiffness", -1e308, "stiffness is beyond"),
    ],
)
def test_numbers_that_are_none_of_a_flight_are_refused(flight, tmp_path, signal, value, text):
    """Sealed by hand: no recorder writes them."""
    recorder = FlightRecorder(seconds=0.01)
    for k in range(5):
        row = dict.fromkeys(COLUMNS, 0.0) | {"time": 1e-3 * k} | ({signal: value} if k == 3 else {})
        recorder.append([row[name] for name, (width, *_) in COLUMNS.items() for _ in range(width)])
    write(tmp_path / "flight.npz", flight / "controller.npz", recorder)
    with pytest.raises(InputError, match=text):
        replay(tmp_path / "flight.npz", "--artifact", flight / "controller.npz")


def test_an_empty_recording_is_refused(flight, tmp_path):
    write(tmp_path / "flight.npz", flight / "controller.npz", FlightRecorder(seconds=0.01))
    with pytest.raises(InputError, match="no samples"):
        replay(tmp_path / "flight.npz", "--artifact", flight / "controller.npz")
