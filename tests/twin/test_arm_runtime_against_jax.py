"""The recorded tick against the JAX law on what a simulated arm reads; and the arm made of plain numbers."""

import dataclasses

import jax
import msgspec
import numpy as np
import pytest

from deploy.controller import golden, known_tissue
from deploy.controller.arm_model import ROBOT, ArmModel
from deploy.controller.artifact import Artifact
from deploy.controller.file import load
from deploy.controller.golden import replay
from deploy.controller.limits import Limits
from deploy.controller.runtimes import arm_runtime
from jaxmpc import Experiment, Params, design
from jaxmpc.experiment.reference import Ramp
from jaxmpc.experiment.tables import Change
from jaxmpc.export import golden as export_golden
from jaxmpc.export.freezing import freeze_controller, nominal_arm
from jaxmpc.export.golden import ArmRun, arm_law_trace, simulated_arm_runs
from jaxmpc.files.errors import InputError
from jaxmpc.law import gain_backoff
from jaxmpc.law.ops import FLOATS
from jaxmpc.world.arm import chain, tip_at
from tests.deploy import made

replace = msgspec.structs.replace
TABLE = Experiment.published("table-1-wam")
RAMP = Ramp(to=-5.0, rate=20.0)
SHORT = replace(TABLE, duration=1.0, settle=0.0, reference=replace(TABLE.reference, z=(RAMP,)))
STIFFNESS = (375.0, 560.0, 810.0, 1240.0, 1900.0)
BAND = 0.06
"""Of the stiffness that a family knows [-]."""
TOLERANCE = 1e-9
"""Of the torques [N m]; each sample rounds some 1e-14, and the observers forget it within some samples."""


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    """A file as the command line makes it, of a guarded controller, and what it holds."""
    folder = tmp_path_factory.mktemp("frozen")
    (folder / "limits.toml").write_text("force = 9.0\n")
    file = folder / "controller.npz"
    settings = {"ideal": False, "limits": folder / "limits.toml"}
    return file, freeze_controller(file, Params(guarded=True), SHORT, {"M_s": 5.0}, **settings)


def artifact_of(experiment, gains, run, answer, K2=10.0):
    """The controller with this run as its golden trace, so that `replay` runs all of it."""
    trace = {"golden_q": run.q, "golden_applied": answer.applied, "golden_torque": answer.torque}
    preview = experiment.reference.preview
    if gains.schedule is not None:
        controller, compensated = export_golden.nominal_controller(gains, K2, experiment)
        read = known_tissue.samples(run.q, run.force, run.force_ref, preview)
        trace |= known_tissue.answers(controller, compensated, read, preview)
    model = ArmModel.from_plain(nominal_arm(experiment, None), trace)
    gains = jax.tree.map(np.asarray, gains)
    rows, floor = [made.margin_row(810.0)], {"M_s": 2.0}
    family = None if gains.schedule is None else {"band": BAND, "rows": rows}
    return Artifact(
        gains, 1e-3, K2, preview, made.LOOP, {}, rows, floor, {}, run.force, run.force_ref, answer.v, model, family
    )


def deviations(experiment, params, stiffness):
    """Largest differences of v [-], torque [N m] and memory [-] at each stiffness, over a whole simulated run."""
    gains, K2, found = design(params), float(params.K2), []
    for run in simulated_arm_runs(params, experiment, stiffness):
        answer = arm_law_trace(gains, K2, experiment, run)
        assert np.ptp(answer.torque[:, 1]) > 1.0
        limited = np.abs(answer.applied - answer.torque).max() > 1e-3
        assert limited == (export_golden.LIMITED_ABOVE < 1.0)
        found.append(replay(artifact_of(experiment, gains, run, answer, K2)))
    return found


@pytest.mark.oracle
def test_a_second_on_five_stiffnesses():
    found = deviations(SHORT, Params(), STIFFNESS)
    assert len(found) == 5
    assert max(torque for _, torque, _ in found) <= TOLERANCE
    assert max(v for v, *_ in found) <= 1e-9


@pytest.mark.slow
def test_a_hundred_thousand_samples_on_five_stiffnesses():
    found = deviations(replace(TABLE, duration=100.0), Params(), STIFFNESS)
    assert max(torque for _, torque, _ in found) <= TOLERANCE


def of_a_family_whose_tissue_turns_twice_as_stiff(monkeypatch):
    """The runtime after 100 000 samples that agree with the JAX law; tissue of 550 N/m is 1100 N/m from 40 s on."""
    flown = []
    monkeypatch.setattr(golden, "arm_runtime", lambda artifact: flown.append(arm_runtime(artifact)) or flown[-1])
    experiment = Experiment.published("family-wam")
    tissue = replace(experiment.tissue, changes=(Change(at=40.0, factor=2.0, duration=0.2),))
    experiment = replace(experiment, duration=100.0, tissue=tissue)
    ((v, torque, memory),) = deviations(experiment, Params.published("family"), (550.0,))
    assert max(torque, memory) <= TOLERANCE
    assert v <= TOLERANCE
    return flown[0]


@pytest.mark.slow
def test_a_hundred_thousand_samples_of_a_family_whose_tissue_turns_twice_as_stiff(monkeypatch):
    monkeypatch.setattr(export_golden, "LIMITED_ABOVE", 1.0)
    runtime = of_a_family_whose_tissue_turns_twice_as_stiff(monkeypatch)
    # The family's gains are for a stiffness known to this band.
    assert runtime.stiffness == pytest.approx((1100.0,) * 3, rel=BAND)
    assert runtime.authority == (1.0, 1.0, 1.0)


@pytest.mark.slow
def test_a_hundred_thousand_samples_of_a_family_that_limits_hold_back(monkeypatch):
    """What is applied in a trace is less than was asked for, and makes the guard act: the schedule loses its trust."""
    runtime = of_a_family_whose_tissue_turns_twice_as_stiff(monkeypatch)
    assert runtime.gain < 1.0
    assert all(0.0 < authority < 0.1 for authority in runtime.authority)


@pytest.mark.oracle
def test_with_friction_compensation_preview_and_higher_order():
    arm = replace(TABLE.arm, compensation=0.5, tool_mass_error=0.05)
    experiment = replace(SHORT, arm=arm, reference=replace(SHORT.reference, preview=True))
    # Of second order it is barely stable on the softest and the hardest tissue.
    found = deviations(experiment, Params(disturbance_order=2), STIFFNESS[1:4])
    assert max(torque for _, torque, _ in found) <= TOLERANCE


@pytest.mark.oracle
def test_a_guarded_controller_of_another_delay_whose_force_swings():
    gains = design(Params(guarded=True, designed_delay=2))
    q, force, wanted = map(np.array, made.recorded_inputs(1000, swing=made.SWING))
    run = ArmRun(q, force, wanted[..., 0])
    answer = arm_law_trace(gains, 10.0, TABLE, run)
    assert max(replay(artifact_of(TABLE, gains, run, answer))) <= TOLERANCE
    # The guard acts in it: without, the commands are others.
    assert replay(artifact_of(TABLE, gains._replace(guard=None), run, answer))[0] > 0.1


@pytest.mark.oracle
def test_a_guarded_family_that_knows_the_reference_ahead(monkeypatch):
    """Both judge a force by what the row before had first ahead; guard and listening are in the golden trace."""
    monkeypatch.setattr(export_golden, "LIMITED_ABOVE", 1.0)
    flown = []
    monkeypatch.setattr(golden, "arm_runtime", lambda artifact: flown.append(arm_runtime(artifact)) or flown[-1])
    experiment = Experiment.published("family-wam")
    experiment = replace(experiment, reference=replace(experiment.reference, preview=True))
    family = Params.published("family")
    # Two of its five knots, which take half as long to compile.
    listening = dataclasses.replace(family.listening, stiffness=family.listening.stiffness[1:3])
    family = dataclasses.replace(family, knots=family.knots[1:3], listening=listening)
    gains = design(family)
    assert gains.guard is not None
    q, force, wanted = map(np.array, made.recorded_inputs(2000, width=gains.mpc_ref.shape[-1], swing=made.SWING))
    sine = np.sin(2.0 * np.pi * family.listening.frequency * 1e-3 * np.arange(len(q)))
    q[:, 1] += 1e-3 * sine
    force += 0.3 * sine[:, None]
    run = ArmRun(q, force, wanted)
    answer = arm_law_trace(gains, float(family.K2), experiment, run)
    v, torque, memory = replay(artifact_of(experiment, gains, run, answer, float(family.K2)))
    assert v <= TOLERANCE
    assert max(torque, memory) <= TOLERANCE
    # Both have acted: the guard feels the force swing, and Z hears the sine.
    assert flown[-1].gain < 0.5
    unheard, _, heard = flown[-1].stiffness
    assert abs(heard / unheard - 1.0) > 0.1


@pytest.mark.oracle
def test_another_law_would_be_seen(frozen):
    """A mass that is a billionth off, or no guard."""
    _, artifact = frozen
    assert max(replay(artifact)) <= TOLERANCE
    arm = artifact.arm
    heavier = {name: getattr(arm, name) for name in ArmModel.__dataclass_fields__}
    heavier |= {"nominal": arm.nominal._replace(mass_scale=arm.nominal.mass_scale * (1.0 + 1e-9))}
    fields = {name: getattr(artifact, name) for name in Artifact.__dataclass_fields__}
    assert replay(Artifact(**(fields | {"arm": ArmModel(**heavier)})))[1] > TOLERANCE
    # The guard acts in it: without, the commands are others.
    assert replay(Artifact(**(fields | {"gains": artifact.gains._replace(guard=None)})))[0] > 0.1


def test_the_arm_of_plain_numbers_is_that_of_the_model_file():
    made_links, links = made.wam_chain().links, chain().links
    for one, other in zip(made_links, links, strict=True):
        for value, wanted in zip(one, other, strict=True):
            np.testing.assert_allclose(value, wanted, rtol=0, atol=1e-15)
    assert made.wam_chain()[1:] == chain()[1:]


@pytest.mark.oracle
def test_freezing_from_parameters_to_a_file_that_runs(frozen):
    file, artifact = frozen
    again = load(file, expect_rate=1000.0, expect_robot=ROBOT)
    assert again.kind == "wam"
    assert again.arm.limits == Limits.from_plain(Limits.default(tip_at(TABLE.arm.posture)).plain() | {"force": 9.0})
    assert again.arm.chain == artifact.arm.chain == chain()
    assert len(again.arm.golden_q) == 512
    assert not again.loop.ideal


@pytest.mark.oracle
def test_a_guarded_controller_is_frozen_with_a_force_that_swings(frozen):
    _, artifact = frozen
    guard = gain_backoff.init()
    for error in (artifact.golden_force - artifact.golden_force_ref).tolist():
        guard = gain_backoff.step(artifact.gains.guard, guard, tuple(error), FLOATS)
    assert guard.memory.gain < 0.5


def test_a_guarded_controller_is_not_frozen_without_an_arm(tmp_path):
    guarded, table = Params(guarded=True), Experiment.published("table-1")
    with pytest.raises(InputError, match="guarded = True: must be false where no arm is driven"):
        freeze_controller(tmp_path / "c.npz", guarded, table, {"M_s": 5.0}, ideal=False)
