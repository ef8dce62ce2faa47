"""Random trials: what is drawn, that each is the experiment it claims to be, and what is counted."""

import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import msgspec
import numpy as np
import pytest
import scipy.stats

from jaxmpc import Experiment, InputError, Params, Status, evaluate, stability
from jaxmpc.beside import Beside
from jaxmpc.engine.kernel import Kernel
from jaxmpc.experiment.reference import Reference
from jaxmpc.report.content import Table
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.stability.loop import closed_loop_matrix, spectral_radius
from tuning import trials
from tuning.job.scenarios import RHYTHMS, Scenarios
from tuning.trials import HARD, NOMINAL, Job, Outcomes, Spread, compute, drawn, linear_margins, on_own_tissues
from tuning.trials.cli import _tables
from tuning.trials.linear_margins import margins_table
from tuning.trials.program import Met
from tuning.trials.report import _short, failures, pairs, ranked, trials_report

BLOCK = 4


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two motions with two trials each in a block, and 0.6 s to judge."""
    for name, value in (("POOL", 2), ("COPIES", 2), ("BLOCK", BLOCK), ("DURATION", 2.6)):
        monkeypatch.setattr(drawn, name, value)


def job(*controllers: Params, spread: trials.Spread = HARD, seed: int = 0) -> Job:
    """No ramp: so `evaluate` scores the samples that a trial is judged by."""
    base = Experiment.published("table-1-wam")
    return Job(controllers or (Params(),), msgspec.structs.replace(base, reference=Reference()), spread, seed)


def outcomes(peak: Any, status: Any = 0) -> Outcomes:
    field = np.asarray(peak, float)[..., None] * [1.0, 0.5, 0.1]
    flat = np.zeros(field.shape[:2])
    calm, never = 0.0 * field, flat == 1.0
    return Outcomes(np.broadcast_to(status, flat.shape), flat, flat, flat + np.inf, field, field, field, calm, never)


def test_pairs_and_ranks() -> None:
    found = outcomes(
        [[1.0, 3.0], [np.nan, 1.0], [2.0, 2.5], [0.1, 0.2], [0.3, 5.0]], [[0, 0], [2, 0], [0, 0], [0, 0], [1, 0]]
    )
    np.testing.assert_array_equal(found.lost[:, 0], [False, True, False, False, True])
    np.testing.assert_array_equal(found.left[:, 0], [False, False, True, False, False])
    assert pairs(found.lost) == (0, 2, 0, 3)
    assert ranked(found, 0, 4) == [1, 4, 2, 0]
    assert ranked(found, 1, 2) == [4, 0]


def test_failures_are_told_with_what_happened_and_to_whom() -> None:
    found = outcomes([[1.0, 1.0], [3.0, np.nan], [1.0, 1.0]], [[0, 0], [0, 2], [0, 0]])
    found = found._replace(
        when=np.full((3, 2), 4.25), swing=np.where(np.arange(3)[:, None, None] == 2, 0.2, found.swing)
    )
    asked = job(Params(), Params.published("cautious"))
    lines = list(failures(asked, ["text", "cautious"], 720, found))
    assert [line.partition(";")[0] for line in lines] == [
        "trial 721: text left 2 N, |e| 3.00 N",
        f"trial 721: cautious lost, {Status(2).name} at 4.2 s",
        "trial 722: text swinging, |e| 1.00 N",
        "trial 722: cautious swinging, |e| 1.00 N",
    ]
    assert f"{asked.trial(721).stiffness[0]:.0f} N/m" in lines[0]


def test_trials_are_on_the_tissues_of_an_experiment_that_has_its_own() -> None:
    base = Experiment.published("table-1-wam")
    assert on_own_tissues(HARD, base) == HARD
    assert on_own_tissues(HARD, msgspec.structs.replace(base, stiffness=base.stiffness[::-1])) == HARD
    own = on_own_tissues(HARD, msgspec.structs.replace(base, stiffness=(900.0, 500.0)))
    assert own == HARD._replace(stiffness=(500.0, 900.0))
    drawn = [job(spread=own).trial(i).stiffness[0] for i in range(50)]
    assert 500.0 <= min(drawn) < 550.0 < 820.0 < max(drawn) <= 900.0


def test_the_report_has_every_trial_and_the_worst_as_files() -> None:
    found = outcomes([[1.0, 3.0], [np.nan, 1.0], [2.0, 2.5]], [[0, 0], [2, 0], [0, 0]])
    asked = job(Params(), Params.published("cautious"))
    told = Table(("controller",), [["text"]])
    report = trials_report(asked, asked.drawn(0, len(found.status)), ["text", "cautious"], found, told)
    rows = report.rows
    assert rows is not None
    assert (len(rows), list(rows.tissues), rows.group) == (3, ["text", "cautious"], "controller")
    by_name = {each.name: each for each in rows.measures}
    np.testing.assert_array_equal(by_name["stiffness"].values, [asked.trial(i).stiffness[0] for i in range(3)])
    np.testing.assert_array_equal(by_name["peak_error"].values, 1e3 * found.peak_error.max(axis=-1))
    assert rows.feasible.tolist() == [False, False, False]
    again = Experiment.from_dict(tomllib.loads(rows.details[2].toml))
    assert again.to_dict() == asked.trial(2).to_dict()
    assert report.sections[0].charts[0].marks[0].x == 2.0


def test_a_median_counts_what_did_not_last(capsys: pytest.CaptureFixture[str]) -> None:
    """Six of ten are lost: so is the trial in the middle."""
    _tables(
        job(), ["text"], outcomes(np.where(np.arange(10) < 6, np.nan, 0.05)[:, None], 2 * (np.arange(10) < 6)[:, None])
    )
    row = next(line for line in capsys.readouterr().out.splitlines() if re.match(r" *text +[∞0]", line))
    assert row.split()[1:5] == ["∞", "∞", "∞", "∞"]


@pytest.mark.oracle
def test_margins_of_a_family_are_those_of_what_flies_too() -> None:
    """The fixed gains hold tissues beyond the knots, at the price of M_s; what freezing declares is of the knots."""
    family, spread = Params.published("family"), NOMINAL._replace(stiffness=(375.0, 1900.0))
    fixed, held = margins_table(["family"], job(family, spread=spread))
    known, ratios = judged_where(family.listening)
    M_s = family_margins(family, known, ratios, Experiment.published("table-1-wam").loop_path()).M_s
    assert held[2] == f"{np.max(M_s):.2f}"
    assert float(fixed[2]) < float(held[2]) < 2.0


def test_margins_are_told_for_every_delay_and_of_a_family_for_both_its_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("fixed", "known"):
        monkeypatch.setattr(linear_margins, f"_of_{name}", lambda _, base, __, name=name: [name, base.delay])
    rows = margins_table(["text", "family"], job(Params(), Params.published("family"), spread=HARD))
    assert rows == [
        [title, str(delay), name, delay]
        for title, name in (("text", "fixed"), ("family, fixed gains", "fixed"), ("family, known", "known"))
        for delay in (1, 2)
    ]


def test_a_stable_loop_that_an_event_pushes_is_not_lost() -> None:
    """|e| of 3 N: lost if the whole arm's loop is unstable or still swings at the end; 0.2 N at the end swings."""
    found = outcomes([[3.0], [3.0], [3.0], [0.2], [0.2]])
    swing, unstable = found.swing.copy(), found.whole_arm_unstable.copy()
    swing[[2, 4], 0, 1], unstable[1] = 0.2, True
    found = found._replace(swing=swing, whole_arm_unstable=unstable)
    assert found.left[:, 0].tolist() == [True, False, False, False, False]
    assert found.lost[:, 0].tolist() == [False, True, True, False, False]
    assert found.swinging[:, 0].tolist() == [False, False, True, False, True]
    assert found.at_rest.all()


def test_draws_keep_to_their_ranges_and_fill_them() -> None:
    given = job()
    drawn = [given.trial(i) for i in range(200)]
    stiffness = np.log([trial.stiffness[0] for trial in drawn])
    low, high = np.log(HARD.stiffness)
    shares = np.sort((stiffness - low) / (high - low))
    # A Kolmogorov–Smirnov test at 1 %; the seed is fixed, so this cannot fail by chance.
    assert scipy.stats.kstest(shares, "uniform").pvalue > 0.01
    assert {trial.delay for trial in drawn} == {1, 2}
    assert {trial.motion.kind for trial in drawn} == {"harmonics", "rhythm"}
    believed = np.array(given.base.arm.coulomb)
    for values, (least, most) in (
        ([trial.arm.cable_hz for trial in drawn], (15.0, 60.0)),
        ([trial.arm.cable_damping for trial in drawn], (0.03, 0.1)),
        ([np.array(trial.arm.coulomb) / believed for trial in drawn], (0.5, 1.5)),
        ([0.9 / (1.0 + trial.arm.mass_error) for trial in drawn], (0.85, 1.15)),
    ):
        assert least <= np.min(values) < least + 0.1 * (most - least)
        assert most - 0.1 * (most - least) < np.max(values) <= most
    assert set(NOMINAL.scenarios.rhythms) == set(RHYTHMS)
    assert {job(spread=NOMINAL).trial(i).delay for i in range(20)} == {1}
    plausible = [job(spread=NOMINAL).trial(i) for i in range(20)]
    assert all(90.0 <= trial.arm.cable_hz <= 250.0 and trial.arm.substeps == 5 for trial in plausible)


@pytest.mark.parametrize(
    ("seed", "rare"),
    [(0, {"harmonics", "steady/hold", "steady/cough"}), (1, {"harmonics", "steady/steady", "steady/cough"})],
)
def test_kinds_of_motion_have_the_parts_that_the_guide_tells(seed: int, rare: set[str]) -> None:
    """Of the 24 motions of every block, three each of six kinds and two each of three."""
    for first in (0, 5 * drawn.BLOCK):
        kinds, counts = np.unique(job(seed=seed).drawn(first, drawn.BLOCK).motion, return_counts=True)
        shares = dict(zip(kinds.tolist(), (counts / drawn.BLOCK).tolist(), strict=True))
        assert shares == {kind: 1 / 12 if kind in rare else 1 / 8 for kind in shares}
        assert len(shares) == len(RHYTHMS)


def test_a_trial_depends_on_its_seed_and_number_alone() -> None:
    assert job().trial(5) == job(Params(K2=20.0)).trial(5)
    assert job().trial(5) != job().trial(6)
    assert job().trial(5) != job(seed=1).trial(5)
    one, other, next_block = (job().trial(i) for i in (5, 5 + drawn.POOL, 5 + drawn.BLOCK))
    assert (one.motion, one.sensor) == (other.motion, other.sensor)
    assert one.stiffness != other.stiffness
    assert one.motion != next_block.motion


@pytest.mark.parametrize(
    ("changes", "spread"),
    [
        ({}, HARD),
        ({"mass_error": 0.1, "nominal_coulomb": (0.0, 2.0, 1.0, 0.5)}, NOMINAL),
        ({"cable_hz": 40.0, "cable_damping": 0.07}, Spread((400.0, 900.0), Scenarios(), substeps=2)),
        ({"cable_damping": 1.0}, NOMINAL),
    ],
    ids=["stress", "believed otherwise", "of the experiment", "damped less than the experiment's"],
)
def test_what_sets_trials_apart_is_what_they_have(changes: dict[str, Any], spread: Spread) -> None:
    """Numbers drawn without an experiment around them, against the experiments themselves, over two blocks' motions."""
    base = Experiment.published("table-1-wam")
    base = msgspec.structs.replace(base, arm=msgspec.structs.replace(base.arm, substeps=2, **changes))
    asked = Job((Params(),), base, spread, seed=2)
    first = drawn.BLOCK - 2
    found = asked.drawn(first, 3 + drawn.POOL)
    for i, trial in enumerate(asked.trial(first + i) for i in range(3 + drawn.POOL)):
        arm, motion = trial.arm, trial.motion
        assert found.motion[i] == (f"{motion.rhythm}/{motion.ventilation}" if motion.kind == "rhythm" else motion.kind)
        assert (found.motion_seed[i], found.delay[i]) == (motion.seed, trial.delay)
        assert (found.stiffness[i], found.mass_error[i]) == (trial.stiffness[0], arm.mass_error)
        assert (found.cable_hz[i], found.cable_damping[i]) == (arm.cable_hz, arm.cable_damping)
        friction = [a / b if b else 1.0 for a, b in zip(arm.coulomb, arm.nominal_coulomb or (), strict=True)]
        assert found.friction[i].tolist() == friction


def radii_alone(cells: stability.Cells, _: Any) -> stability.Margins:
    """What a trial has of the margins: the others take half a minute to compile."""
    radius = jax.jit(jax.vmap(lambda one: spectral_radius(closed_loop_matrix(one.gains, one.contacts))))(cells)
    none = np.full(len(cells.residual), np.nan)
    return stability.Margins(*[none] * 5, radius, stability.stability_status(radius, cells.residual))


@pytest.mark.oracle
@pytest.mark.usefixtures("few")
@pytest.mark.parametrize(
    "own",
    [
        pytest.param({}, id="plain", marks=pytest.mark.slow),
        pytest.param({"velocity_cutoff": 320.0, "force_cutoff": 900.0}, id="filters"),
    ],
)
def test_every_trial_is_the_experiment_it_says(own: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the public function, one by one; K̂_s 200 is unstable on stiff tissue, whatever the run does."""
    monkeypatch.setattr(stability, "_block", radii_alone)
    controllers = Params(**own), Params(Khat_s=200.0, **own)
    given = job(*controllers, spread=HARD)
    found = trials.run(given, BLOCK)
    assert (found.status[:, 1] == Status.UNSTABLE).any()
    for i in range(BLOCK):
        expected = evaluate(Params.stack(controllers), given.trial(i))
        np.testing.assert_array_equal(found.status[i], np.asarray(expected.status)[:, 0])
        # Two programs round differently, and friction and quantisers amplify it for 2.6 s.
        np.testing.assert_allclose(found.spectral_radius[i], expected.margins.spectral_radius[:, 0], rtol=1e-9)
        ok = found.status[i] == Status.OK
        np.testing.assert_allclose(found.rms[i][ok], expected.metrics.rms[:, 0][ok], rtol=1e-6)
        np.testing.assert_allclose(found.true_rms[i][ok], expected.metrics.true_rms[:, 0][ok], rtol=1e-6)
        np.testing.assert_allclose(found.peak_error[i][ok], expected.metrics.peak_error[:, 0][ok], rtol=1e-6)


@pytest.mark.usefixtures("few")
def test_motions_robots_and_controllers_find_their_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that gives back what it was given, for controllers of two structures in between each other."""

    def wave_program(spec: Any, varied: Any, structure: Any, motions: int) -> Callable[..., Any]:
        def run(wave: Sequence[Met], shared: Any) -> Any:
            met = Met(*map(np.concatenate, zip(*wave, strict=True)))
            assert len(met.own) == motions
            # Of several XLA makes another program, with other bits: what one does would depend on who is beside it.
            assert len(shared.params.K2) == 1
            K2 = np.broadcast_to(shared.params.K2, (*met.own.shape[:2], len(shared.params.K2)))
            # Of what varies, stiffness alone lies here.
            leaves = np.moveaxis(met.own, -1, 0)
            found = next(values for values in leaves if values.min() > 300.0 and values.max() < 2200.0)
            stiffness = found[..., None] + 0.0 * K2
            noise = np.broadcast_to(met.noise[:, None, None, 7], (*K2.shape, 3))
            return 0.0 * K2, stiffness, K2, K2, noise, noise, noise, noise

        return run

    monkeypatch.setattr(compute, "wave_program", wave_program)
    controllers = Params(K2=1.0), Params(K2=2.0, disturbance_order=2), Params(K2=3.0)
    given = job(*controllers, spread=NOMINAL)
    found = trials.run(given, 2 * BLOCK - 1)
    assert found.status.shape == (2 * BLOCK - 1, 3)
    np.testing.assert_array_equal(found.spectral_radius, np.tile([1.0, 2.0, 3.0], (2 * BLOCK - 1, 1)))
    for i, (met, noise) in enumerate(zip(found.when, found.rms, strict=True)):
        trial = given.trial(i)
        np.testing.assert_array_equal(met, trial.stiffness[0])
        np.testing.assert_array_equal(noise, np.tile(trial.signals.noise[7], (3, 1)))


@pytest.mark.usefixtures("few")
def test_what_is_compiled_ahead_is_a_program_for_each_structure(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not for each controller."""
    compiled: list[int] = []
    monkeypatch.setattr(
        compute, "traced_ahead", lambda _, __, shared: partial(compiled.append, shared.params.disturbance_order)
    )
    asked = job(Params(K2=1.0), Params(K2=2.0, disturbance_order=2), Params(K2=3.0))
    for finish in compute._traced(compute._programs(asked, compute.constants_of(asked), 1), ()):
        finish()
    assert sorted(compiled) == [1, 2]


def test_the_whole_arm_is_rehearsed_where_a_wave_will_ask_it_of_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """On stress arms, once what the wave runs is traced; of few, operation by operation, nothing is to be compiled."""
    asked: list[tuple[Params, int]] = []
    traced: Future[None] = Future()
    monkeypatch.setattr(compute.whole_arm, "lost", lambda params, met: asked.append((params, len(met))))
    given = job(Params(K2=1.0), Params(K2=2.0), spread=HARD)
    with Beside(1) as beside:
        rehearsing = beside.submit(compute._rehearsed, given, 20_000, traced)
        assert not wait([rehearsing], timeout=0.05).done
        traced.set_exception(RuntimeError("it is raised where the wave runs"))
        assert rehearsing.result() is None
    assert asked == [(Params(K2=1.0), 1400), (Params(K2=2.0), 1400)]
    compute._rehearsed(replace(given, spread=NOMINAL), 20_000, traced)
    compute._rehearsed(given, 2 * BLOCK, traced)
    assert len(asked) == 2


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_no_bit_of_a_trial_depends_on_who_else_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Text on stress arms, where what is lost tells the last bit."""
    monkeypatch.setattr(drawn, "DURATION", 4.0)
    alone = trials.run(job(), 3 * BLOCK)
    beside = trials.run(job(Params.published("cautious"), Params()), 2 * BLOCK)
    for name, one, other in zip(Outcomes._fields, alone, beside, strict=True):
        np.testing.assert_array_equal(one[: 2 * BLOCK, 0], other[:, 1], err_msg=name)


@pytest.mark.oracle
@pytest.mark.usefixtures("few")
def test_the_kernel_runs_the_same_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a GPU runs, to rounding: robots, tissues and delays of their own on motions that several share."""
    monkeypatch.setattr(Kernel, "devices", ("cpu",))
    # With the ramp, on arms that all last: what becomes of a loop that is thrown off hangs on its last bits.
    asked = Job((Params.published("cautious"),), Experiment.published("table-1-wam"), HARD, seed=1)
    by_scan, by_kernel = (replace(asked, engine=engine) for engine in ("scan", "kernel"))
    scanned, found = (trials.run(each, BLOCK) for each in (by_scan, by_kernel))
    assert len(set(by_scan.trial(i).delay for i in range(BLOCK))) == 2
    assert np.all(scanned.status == Status.OK)
    for name, one, other in zip(Outcomes._fields, found, scanned, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.usefixtures("few")
def test_a_wave_is_as_wide_as_the_gpus_memory_lets_it_be() -> None:
    constants = compute.constants_of(job())
    block = sum(array.nbytes for array in compute.met_in_block(job(), constants.varied, 0))

    def blocks(room: float | None) -> int:
        device: Any = SimpleNamespace(memory_stats=lambda: room and {"bytes_limit": room})
        return compute._blocks_of_a_wave(constants, device)

    assert blocks(10.1 * compute.COPIES_OF_A_BLOCK * block) == 10
    assert blocks(0.1 * block) == 1, "one has to fit"
    assert blocks(1e6 * block) == blocks(None) == compute.BLOCKS_OF_A_WAVE


def test_numbers_of_a_table_keep_seven_digits_and_what_is_none_is_empty() -> None:
    assert _short(1234.56789, -2e-9, 3.0) == ["1234.568", "-2e-09", "3"]
    assert _short(np.nan, 0.0, np.inf) == ["", "0", ""]


@pytest.mark.usefixtures("few")
def test_blocks_are_kept_and_refused_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    computed = []

    def outcomes_of(_: Job, firsts: Sequence[int]) -> Iterator[Outcomes]:
        for first in firsts:
            computed.append(first)
            yield outcomes(np.arange(first, first + BLOCK)[:, None])

    monkeypatch.setattr(trials, "outcomes_of", outcomes_of)
    alone = trials.run(job(), 10)
    assert computed == [0, 4, 8]
    trials.run(job(), 3, str(tmp_path))  # as runs of sweeps and tunes take it
    damaged = tmp_path / "0000000.npz"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-1])
    again = trials.run(job(), 10, tmp_path)
    third = trials.run(job(), 10, tmp_path)
    assert computed == [0, 4, 8, 0, 0, 4, 8]
    assert damaged.read_bytes() == whole
    for field, second, kept in zip(alone, again, third, strict=True):
        np.testing.assert_array_equal(second, field)
        np.testing.assert_array_equal(kept, field)
    assert "0000000.npz is computed again" in caplog.text
    damaged.unlink()
    damaged.symlink_to(damaged)  # a link to itself: no right to read stops root
    with pytest.raises(InputError, match=r"0000000\.npz = .*It cannot be read: "):
        trials.run(job(), 3, tmp_path)
    assert damaged.is_symlink()
    damaged.unlink()
    damaged.write_bytes(whole)
    with pytest.raises(InputError, match="very trials"):
        trials.run(job(seed=1), 3, tmp_path)
    monkeypatch.setattr(trials, "source_of", lambda package: f"{package}, changed")
    with pytest.raises(InputError, match="this very program"):  # what a swing is may be something else there
        trials.run(job(), 3, tmp_path)


def test_what_cannot_be_tried_is_refused() -> None:
    with pytest.raises(InputError, match="wam"):
        Job((Params(),), Experiment.published("table-1"))
    with pytest.raises(InputError, match="seed"):
        job(seed=-1)
    with pytest.raises(InputError, match="trials"):
        trials.run(job(), 0)


def test_a_recording_shorter_than_trials_is_refused_with_what_helps(tmp_path: Path) -> None:
    """It was refused once trials were drawn, with the advice to shorten an experiment whose duration is the trials'."""
    (tmp_path / "heart.csv").write_text("t,x,y,z\n" + "".join(f"{0.01 * t},0,0,{1e-5 * t}\n" for t in range(1001)))
    motion = {"kind": "recording", "file": f"{tmp_path}/heart.csv"}
    recorded = Experiment.from_dict({"physics": "wam", "duration": 9.0, "motion": motion})
    with pytest.raises(InputError, match=r"^motion\.file = .*Trials last 30 s: set motion\.repeat = true\.$"):
        Job((Params(),), recorded)
    others = NOMINAL._replace(scenarios=msgspec.structs.replace(NOMINAL.scenarios, rhythms=("steady",)))
    Job((Params(),), recorded, others)
    Job((Params(),), Experiment.from_dict({**recorded.to_dict(), "motion": {**motion, "repeat": True}}))


def test_counts_and_seeds_of_trials_may_be_numpys() -> None:
    base = Experiment.published("table-1-wam")
    assert Job((Params(),), base, HARD, np.int64(3)).digest == Job((Params(),), base, HARD, 3).digest  # type: ignore[arg-type]  # on purpose
    for seed in (-1, 10**9, 1.5, True):
        with pytest.raises(InputError, match=r"^seed = "):
            Job((Params(),), base, HARD, seed)  # type: ignore[arg-type]  # on purpose
    for count in (0, -1, 1.5, True):
        with pytest.raises(InputError, match=r"^trials = "):
            trials.run(Job((Params(),), base), count)  # type: ignore[arg-type]  # on purpose
