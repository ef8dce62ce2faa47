"""Specs: what is read, and what is refused with file, line, key and remedy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.files.errors import InputError
from tuning import Scenarios, TuneSettings, TuneSpec, pareto, tune
from tuning.job.space import FREE


def spec_of(folder: Path, text: str) -> TuneSpec:
    path = folder / "tune.toml"
    path.write_text(text)
    return TuneSpec.from_toml(path)


def test_an_empty_file_is_the_default_job(tmp_path: Path) -> None:
    spec = spec_of(tmp_path, "")
    assert tuple(spec.free) == FREE
    assert spec.goals == {"M_s": 2.0}
    assert not spec.ideal
    assert spec.experiment.stiffness == (375.0, 810.0, 1900.0)
    assert not set(spec.tune.train_seeds) & set(spec.tune.heldout_seeds)


def test_everything_can_be_said(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[params]\nQ_p = 3.0\n")
    spec = spec_of(
        tmp_path,
        """
        [experiment]
        published = "table-1"
        stiffness = [500.0]
        sensor = { noise = 0.02 }
        [params]
        file = "mine.toml"
        K2 = 40.0
        [tune]
        steps = 7
        diagonals = ["lam"]
        [tune.free]
        lam = true
        K2 = [10.0, 50.0]
        [goals]
        M_s = 1.8
        gain_margin_db = 6
        ideal = true
        """,
    )
    assert spec.experiment.stiffness == (500.0,)
    assert spec.experiment.sensor.noise == 0.02
    assert spec.experiment.sensor.lsb == (0.0061, 0.0061, 0.0122)
    assert float(spec.params.Q_p) == 3.0
    assert float(spec.params.K2) == 40.0
    assert spec.space.size == 17
    assert spec.to_dict()["tune"]["free"]["K2"] == [10.0, 50.0]
    assert spec.to_dict()["goals"] == {"M_s": 1.8, "gain_margin_db": 6, "ideal": True, "soft": {"rms": 0.05}}


def test_the_hash_follows_every_number(tmp_path: Path) -> None:
    one = spec_of(tmp_path, "[goals]\nM_s = 2.0").digest
    assert one == spec_of(tmp_path, "").digest
    assert one != spec_of(tmp_path, "[goals]\nM_s = 1.9").digest
    assert one != spec_of(tmp_path, "[params]\nQ_p = 0.6").digest


def test_jobs_of_several_orders_are_made_and_checked(tmp_path: Path) -> None:
    spec = spec_of(tmp_path, "[tune]\norders = [1, 2]")
    assert [int(spec.with_order(order).params.disturbance_order) for order in spec.tune.orders] == [1, 2]
    assert spec.with_order(2).with_order(1).tune.orders == (1, 2)


def test_the_order_of_what_is_free_is_part_of_a_job(tmp_path: Path) -> None:
    """Vectors have it, and so do the states that a job goes on from."""
    first, second = "lam = true", "Q_p = true"
    one, other = (spec_of(tmp_path, f"[tune.free]\n{a}\n{b}") for a, b in ((first, second), (second, first)))
    assert one.digest != other.digest
    first, second = "M_s = [2.0, 1.8]", "chatter = [1.2, 0.9]"
    one, other = (spec_of(tmp_path, f"[pareto]\n{a}\n{b}") for a, b in ((first, second), (second, first)))
    assert one.digest != other.digest


WRONG = {
    "unknown goal": ("[goals]\nMs = 2.0", "goals.Ms", "'M_s'", 2),
    "goal without a limit": ("[goals]\nM_s = true", "goals.M_s", "a number", 2),
    "goal not finite": ("[goals]\nphase_margin_deg = inf", "goals.phase_margin_deg", "a number", 2),
    "M_s below 1": ("[goals]\nM_s = 0.9", "goals.M_s", "above 1", 2),
    "unknown parameter": ("[tune.free]\nQp = true", "tune.free.Qp", "'Q_p'", 2),
    "bounds upside down": ("[tune.free]\nK2 = [50.0, 5.0]", "tune.free.K2", "[lowest, highest]", 2),
    "three bounds": ("[tune.free]\nK2 = [1.0, 2.0, 3.0]", "tune.free.K2", "[lowest, highest]", 2),
    "bound out of range": ("[tune.free]\nHp = [2, 65]", "tune.free.Hp", "in [1, 64]", 2),
    "bound without a unit": ("[tune.free]\nlam = [0.0, 1.0]", "tune.free.lam", "in [1e-12, 1e+12]. Move", 2),
    "value without a unit": ("[params]\nlam = 0.0", "params.lam", "1e+12]. Correct lam; a typical value is 0.1.", 2),
    "bound nan": ("[tune.free]\nK2 = [nan, 50.0]", "tune.free.K2", "in [0, 10000]", 2),
    "half a sample": ("[tune.free]\nHp = [2.5, 40]", "tune.free.Hp", "whole", 2),
    "start outside": ("[params]\nK2 = 5.0\n[tune.free]\nK2 = [10.0, 50.0]", "tune.free.K2", "start point", 4),
    "nothing free": ("[tune.free]", "tune.free", "at least one", 1),
    "no held-out seed": ("[tune]\nheldout_seeds = []", "tune.heldout_seeds", "at least one", 2),
    "a seed on both sides": ("[tune]\ntrain_seeds = [1, 1000]", "tune.heldout_seeds", "unknown to", 1),
    "a seed twice": ("[tune]\ntrain_seeds = [1, 1]", "tune.train_seeds", "repetition", 2),
    "settle too long": ("[tune]\nsettle = 9.0", "tune.settle", "below duration", 2),
    "unknown key": ("[tune]\nstep = 3", "tune.step", "'steps'", 2),
    "a setting that is gone": ('[tune]\nlevels = ["arm"]', "tune.levels", "known key", 2),
    "no steps": ("[tune]\nsteps = 0", "tune.steps", ">= 1", 2),
    "a controller": ("[params]\n[provenance]\nmade_by = 1", "provenance", "looks like a tuned controller", 2),
    "unknown table": ("[goal]\nM_s = 2.0", "goal", "'goals'", 1),
    "unknown experiment key": ("[experiment]\nstiffnes = [1.0]", "experiment.stiffnes", "'stiffness'", 2),
    "negative stiffness": ("[experiment]\nstiffness = [-1.0]", "experiment.stiffness", "> 0", 2),
    "Hu above Hp": ("[params]\nHp = 3\nHu = 5", "params.Hu", "Hp", 3),
    "two sources": ('[params]\npublished = "text"\nfile = "a.toml"', "params.file", "given without", 3),
    "frozen diagonal": ('[tune]\ndiagonals = ["delta"]', "tune.diagonals", "free", 2),
    "diagonal as one number": ("[params]\nlam = [0.1, 0.2]", "params.lam", "one number", 2),
    "ideal in words": ('[goals]\nideal = "yes"', "goals.ideal", "true or false", 2),
    "a share of no part": ("[risk]\nshare = 0.1", "risk.share", 'given for "cvar" only', 2),
    "a share of the worst": ('[risk]\nkind = "worst"\nshare = 0.25', "risk.share", 'given for "cvar" only', 3),
    "rounds without an arm": ("[tune]\nmapping = 3", "tune.mapping", "given on the arm only", 2),
    "compensation in words": ("[baseline]\ncompensation = true", "baseline.compensation", "in [0, 2]", 2),
}


@pytest.mark.parametrize(("text", "key", "says", "line"), WRONG.values(), ids=WRONG)
def test_a_wrong_spec_is_refused(tmp_path: Path, text: str, key: str, says: str, line: int) -> None:
    with pytest.raises(InputError) as caught:
        spec_of(tmp_path, text)
    assert caught.value.key.startswith(key)
    assert says in str(caught.value)
    assert caught.value.file == tmp_path / "tune.toml"
    assert caught.value.line == line


ON_ICE = {"experiment": {"published": "table-1-wam", "arm": {"coulomb": [0.0] * 4, "viscous": [0.0] * 4}}}


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"experiment": {"duration": 2.0, "settle": 1.0}}, "settle"),
        ({"tune": {"duration": 2.0, "settle": 1.0}}, "tune.settle"),
        ({"params": {"published": "mpc-alone"}, "tune": {"orders": [1, 2]}}, "disturbance_order"),
        ({"params": {"published": "mpc-alone"}, "tune": {"free": {"Hp": [1, 64]}}}, "tune.free.Hp"),
        ({"params": {"guarded": True}}, "params.guarded"),
        ({"params": {"architecture": "aob"}, "tune": {"free": {"K2": True, "lam": True}}}, "tune.free.lam"),
        ({"params": {"published": "mpc-alone"}, "tune": {"free": {"T_cl": [1e-3, 1e-2]}}}, "tune.free.T_cl"),
        ({"tune": {"orders": [1, 2], "free": {"lam": True}}}, "tune.orders"),
        ({**ON_ICE, "scenarios": {"friction": 0.3}}, "scenarios.friction"),
        ({"baseline": {"compensation": 0.5}}, "baseline.compensation"),
        ({"goals": {"joint_torque": 30.0}}, "goals.joint_torque"),
        ({"goals": {"soft": {"clamped_ratio": 0.5}}}, "goals.soft.clamped_ratio"),
        ({"pareto": {"torque_step_x": [5.0, 10.0]}}, "pareto.torque_step_x"),
        ({"tune": {"free": {"Hp": [4, 30], "Hu": [8, 16]}}, "params": {"Hu": 8.0}}, "tune.free.Hp"),
        ({"experiment": {"published": "table-1-wam"}, "scenarios": {"cable_hz": [15.0, 120.0]}}, "scenarios.cable_hz"),
    ],
)
def test_what_the_proof_could_not_run_is_refused_before_the_search(table: dict[str, Any], key: str) -> None:
    """Table I's ramp lasts 1 s: of 2 s of which one settles nothing is left to score."""
    with pytest.raises(InputError) as caught:
        TuneSpec.from_dict(table)
    assert caught.value.key.startswith(key)


def test_a_baseline_that_says_nothing_of_its_parameters_has_those_of_the_job() -> None:
    table = {"experiment": {"published": "table-1-wam"}, "params": {"published": "cautious"}}
    uncompensated = TuneSpec.from_dict({**table, "baseline": {"compensation": 0.0}})
    assert uncompensated.before.to_dict() == Params.published("cautious").to_dict()
    assert uncompensated.baseline_compensation == 0.0
    other = TuneSpec.from_dict({**table, "baseline": {"published": "text", "compensation": 0.0}})
    assert other.before.to_dict() == Params.published("text").to_dict()


def test_what_an_architecture_does_not_have_is_not_free_by_default() -> None:
    """The tuner would move numbers that no loop depends on, and tell of them."""
    assert set(FREE) - set(TuneSpec.from_dict({"params": {"architecture": "aob"}}).free) == {"lam", "Hp", "Hu"}
    assert set(FREE) - set(TuneSpec.from_dict({"params": {"published": "mpc-alone"}}).free) == {"T_cl"}


def test_the_risk_of_a_job_tells_what_it_has_and_nothing_else() -> None:
    assert TuneSpec.from_dict({}).to_dict()["risk"] == {"kind": "soft-worst"}
    assert TuneSpec.from_dict({"risk": {"kind": "cvar"}}).to_dict()["risk"] == {"kind": "cvar", "share": 0.25}
    assert TuneSpec.from_dict({"risk": {"kind": "cvar", "share": 0.5}}).resolved()["risk"] == "kind cvar, share 0.5"


def test_what_scenarios_and_horizons_may_have_is_taken() -> None:
    TuneSpec.from_dict({"tune": {"free": {"Hp": [8, 30], "Hu": [8, 16]}}, "params": {"Hu": 8.0}})
    table = {
        "experiment": {"published": "table-1-wam", "arm": {"substeps": 2}},
        "scenarios": {"cable_hz": [15.0, 120.0]},
    }
    assert TuneSpec.from_dict(table).scenarios.cable_hz == (15.0, 120.0)


def test_a_start_of_many_numbers_outside_its_bounds_is_told_by_the_first_of_them() -> None:
    table = {"params": {"lam": [0.1, 2.0]}, "tune": {"diagonals": ["lam"], "free": {"lam": [1.0, 10.0]}}}
    with pytest.raises(InputError, match=r"start 0\.1 lies outside"):
        TuneSpec.from_dict(table)


def test_python_meets_the_same_checks() -> None:
    spec = TuneSpec.from_dict({})
    with pytest.raises(InputError, match="one controller"):
        TuneSpec(spec.experiment, Params.stack([spec.params, spec.params]))


@pytest.mark.parametrize("wrong", ["tune.toml", None, 3])
def test_what_is_no_job_is_told(wrong: Any) -> None:
    """The path of a job in place of the job was "'str' object has no attribute 'tune'"."""
    for asked in (tune, pareto):
        with pytest.raises(InputError, match=r"must be of the type TuneSpec.*TuneSpec\.from_toml"):
            asked(wrong)
    with pytest.raises(InputError, match="must be a table"):
        TuneSpec.from_dict(wrong)


def test_numbers_of_numpy_make_the_same_job() -> None:
    """Limits of a front were "no list", float32's no number, and seeds an error of numpy's."""
    tables: dict[str, Any] = {
        "tune": {"starts": 2, "train_seeds": [0, 1], "heldout_seeds": [5], "free": {"lam": [0.01, 1.0], "Q_p": True}},
        "goals": {"M_s": 2, "effort": 3.0, "soft": {"rms": 0.25}},
        "risk": {"kind": "cvar", "share": 0.5},
        "pareto": {"M_s": [1.75, 2.0]},
    }
    given: dict[str, Any] = {
        "tune": {
            "starts": np.int64(2),
            "train_seeds": np.arange(2),
            "heldout_seeds": np.array([5]),
            "free": {"lam": np.array([0.01, 1.0]), "Q_p": np.True_},
        },
        "goals": {"M_s": np.float32(2.0), "effort": np.int64(3), "soft": {"rms": np.float32(0.25)}},
        "risk": {"kind": "cvar", "share": np.float32(0.5)},
        "pareto": {"M_s": np.array([1.75, 2.0])},
    }
    spec = TuneSpec.from_dict(tables)
    assert TuneSpec.from_dict(given).digest == spec.digest
    built = TuneSpec(
        spec.experiment,
        spec.params,
        tune=TuneSettings(np.int64(150), starts=np.int8(2), train_seeds=np.arange(2), heldout_seeds=np.array([5])),  # type: ignore[arg-type]  # on purpose
        free={"lam": np.array([0.01, 1.0]), "Q_p": None},  # type: ignore[dict-item]  # on purpose
        goals={"M_s": np.float32(2.0), "effort": np.int64(3)},  # type: ignore[dict-item]  # on purpose
        soft={"rms": np.float32(0.25)},  # type: ignore[dict-item]  # on purpose
        risk=spec.risk,
        pareto=given["pareto"],
    )
    assert built.digest == spec.digest


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"tune": TuneSettings(starts=-1)}, r"tune\.starts = -1: must be "),
        ({"tune": TuneSettings(steps="many")}, r"tune\.steps = many: must be a whole number"),  # type: ignore[arg-type]  # on purpose
        ({"scenarios": Scenarios(friction=2.0)}, r"scenarios\.friction = 2\.0: must be "),
        ({"tune": {"starts": 2}}, r"tune = .*: must be of the type TuneSettings"),
        ({"experiment": "table-1"}, r"experiment = table-1: must be of the type Experiment"),
        ({"params": "text"}, r"params = text: must be of the type Params"),
        ({"baseline": "text"}, r"baseline = text: must be of the type Params"),
    ],
)
def test_a_job_that_is_built_in_python_is_checked_as_a_file_is(changes: dict[str, Any], says: str) -> None:
    """Starts of −1 were taken, a name in the place of what has it was an AttributeError."""
    given = {"experiment": Experiment.published("table-1"), "params": Params.published("text")}
    with pytest.raises(InputError, match=f"^{says}"):
        TuneSpec(**(given | changes))
