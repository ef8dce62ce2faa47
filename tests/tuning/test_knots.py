"""Knots of a family as parameters: their axes, what judges them, and slopes against central differences."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from jaxmpc import Params, design
from jaxmpc.files.errors import InputError
from jaxmpc.files.toml import write_toml
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS
from jaxmpc.spectra.residual import residual_rms
from jaxmpc.spectra.spectrum import spectrum_of
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.stability.held_beat import telling_rates
from jaxmpc.stability.loop import contact_of
from jaxmpc.xla.precision import in_float64
from tuning import TuneSpec
from tuning.job.risk import soft_worst
from tuning.objective.evaluated import HEADROOM
from tuning.objective.judged_cells import FEWER, coarser, judged_cells
from tuning.objective.problem import _held, problem_of, training
from tuning.search.constraints import Constraints
from tuning.search.run import run_search

Job = Callable[..., dict[str, Any]]
PLACES = (375.0, 810.0)
MARGIN_GOALS = {"M_s": 2.0, "gain_margin_db": 6.0, "delay_margin_s": 0.0015, "ideal": False}


@pytest.fixture
def of_two(small: Job) -> Callable[..., TuneSpec]:
    """A function that gives a job with the published family's knots at 375 and 810 N/m."""
    published = Params.published("family").to_dict()
    knots = [
        knot
        for knot, place in zip(published["knots"], published["listening"]["stiffness"], strict=True)
        if place in PLACES
    ]
    params = {"published": "family", "knots": knots, "listening": {"stiffness": list(PLACES)}}

    def job(**tables: Any) -> TuneSpec:
        experiment = {"published": "family-wam", "stiffness": list(PLACES)}
        base: dict[str, Any] = {"experiment": experiment, "params": params, "goals": MARGIN_GOALS}
        return TuneSpec.from_dict(small(**{n: {**base.get(n, {}), **tables.get(n, {})} for n in (*base, *tables)}))

    return job


def test_a_name_of_all_knots_is_a_number_of_each_or_of_all(of_two: Callable[..., TuneSpec]) -> None:
    free = {"lam": True, "knots": {"Q_p": [0.1, 50.0], "Khat_s": True, "T_cl": True, "1": {"T_cl": [1e-3, 1e-2]}}}
    spec = of_two(tune={"free": free, "tied": ["Khat_s"]})
    names = ["lam", "knots.1.Q_p", "knots.2.Q_p", "knots.Khat_s", "knots.2.T_cl", "knots.1.T_cl"]
    assert spec.space.names == names
    assert not spec.fixed_stay
    bounds = spec.to_dict()["tune"]["free"]
    assert (bounds["knots.2.Q_p"], bounds["knots.1.T_cl"]) == ([0.1, 50.0], [1e-3, 1e-2])
    z = spec.space.encode(spec.params)
    z[names.index("knots.Khat_s")] += 0.3
    found = spec.space.exact(z)
    # What is tied is the ratio to the knot's own stiffness; the first one's is where it starts.
    ratios = [float(knot.Khat_s) / place for knot, place in zip(found.knots, PLACES, strict=True)]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-14)
    assert 1.2 < ratios[0] / (406.5 / 375.0) < 1.4
    assert (found.guarded, found.listening) == (True, spec.params.listening)
    for before, after in zip(spec.params.knots, found.knots, strict=True):
        assert [float(after.Q_p), float(after.T_cl)] == pytest.approx(
            [float(before.Q_p), float(before.T_cl)], rel=1e-12
        )
        for name in ("lam", "Q_x", "K2", "Hp", "Hu"):
            assert float(getattr(after, name)) == float(getattr(before, name)), name


def test_knots_start_out_alike(of_two: Callable[..., TuneSpec]) -> None:
    space = of_two().space
    assert set(space.names) == {f"knots.{i}.{n}" for i in (1, 2) for n in ("lam", "Q_p", "Q_x", "T_cl", "Khat_s")}
    drawn = space.values(space.draw(3, 0))
    for name in ("lam", "Khat_s"):
        first, second = (drawn[:, space.names.index(f"knots.{i}.{name}")] for i in (1, 2))
        np.testing.assert_allclose(first, second, rtol=1e-12)


def test_whole_horizons_of_a_knot_stay_ordered(of_two: Callable[..., TuneSpec]) -> None:
    spec = of_two(tune={"free": {"knots": {"Hp": [2, 20], "Hu": [1, 16]}}})
    z = np.array(
        [float(axis.unconstrained(value)) for axis, value in zip(spec.space.axes, (4.4, 9.0, 9.7, 2.2), strict=True)]
    )
    assert spec.space.whole.all()
    soft, hard = (jax.jit(spec.space.decode)(z, width).knots for width in (2.0, 1.0))
    assert [float(soft[0].Hp), float(soft[0].Hu)] == pytest.approx([4.4, 9.7], rel=1e-6)
    assert [(float(knot.Hp), float(knot.Hu)) for knot in hard] == [(4.0, 4.0), (9.0, 2.0)]


@pytest.mark.parametrize(
    ("tables", "key", "says"),
    [
        ({"tune": {"free": {"knots": {"lamb": True}}}}, "tune.free.knots.lamb", "'lam'"),
        ({"tune": {"free": {"knots": {"3": {"lam": True}}}}}, "tune.free.knots.3.lam", "from 1 to 2"),
        ({"tune": {"free": {"knots": {"0": {"lam": True}}}}}, "tune.free.knots.0.lam", "from 1 to 2"),
        ({"tune": {"free": {"knots": {"K2": True}}}}, "tune.free.knots.1.K2", "start 0.02"),
        ({"tune": {"free": {"knots": {"Khat_s": [0.5, 1.05]}}}}, "tune.free.knots.1.Khat_s", "start 1.084"),
        ({"tune": {"free": {"knots": {"Khat_s": [0.5, 2e4]}}}}, "tune.free.knots.1.Khat_s", "must be in"),
        ({"tune": {"free": {"knots": {"lam": "tied"}}}}, "tune.free.knots.lam", "[lowest, highest]"),
        ({"tune": {"free": {"knots": {"lam": True}}, "tied": ["Q_p"]}}, "tune.tied", "`knots.Q_p = true`"),
        ({"experiment": {"stiffness": [375.0]}}, "experiment.stiffness", "Add 810"),
        ({"experiment": {"physics": "linear"}}, "experiment.physics", "family-wam"),
        ({"goals": {"overshoot": 0.1}}, "goals.overshoot", "fixed gains"),
        ({"goals": {"soft": {"overshoot": 0.1}}}, "goals.soft.overshoot", "fixed gains"),
        ({"pareto": {"overshoot": [0.1, 0.2]}}, "pareto.overshoot", "fixed gains"),
    ],
)
def test_what_no_knot_has_is_refused_by_name(
    of_two: Callable[..., TuneSpec], tables: dict[str, Any], key: str, says: str
) -> None:
    with pytest.raises(InputError) as refused:
        of_two(**tables)
    assert refused.value.key == key
    assert says in str(refused.value)


def test_without_knots_there_are_none_to_tune(small: Job) -> None:
    with pytest.raises(InputError, match=r"tune\.free\.knots\.lam = true: must be free where there are knots"):
        TuneSpec.from_dict(small(tune={"free": {"knots": {"lam": True}}}))


def test_a_family_comes_back_from_its_file(of_two: Callable[..., TuneSpec], tmp_path: Path) -> None:
    spec = of_two()
    found = spec.space.exact(spec.space.encode(spec.params) + 0.1)
    write_toml(tmp_path / "params.toml", {"params": found.to_dict()})
    again = Params.from_toml(tmp_path / "params.toml")
    assert again.to_dict() == found.to_dict()
    assert float(again.knots[1].lam) != float(spec.params.knots[1].lam)


def test_knots_are_judged_where_freeze_judges_and_fixed_gains_where_they_move(of_two: Callable[..., TuneSpec]) -> None:
    spec = of_two()
    known, ratios = judged_where(spec.params.listening)
    stiffness, believed = judged_cells(spec, coarse=False)
    np.testing.assert_array_equal(believed, np.repeat(known, len(ratios)))
    np.testing.assert_allclose(stiffness / believed, np.tile(ratios, len(known)), rtol=1e-14)
    assert set(PLACES) <= set(judged_cells(spec, coarse=True)[1])
    both = of_two(tune={"free": {"lam": True, "knots": {"lam": True}}})
    stiffness, believed = judged_cells(both, coarse=True)
    fixed = np.isnan(believed)
    np.testing.assert_array_equal(stiffness[fixed], coarser(both))
    assert np.count_nonzero(~fixed) == len(np.unique(believed[~fixed])) * FEWER[1]


@pytest.mark.slow
@in_float64
def test_fixed_gains_that_stay_and_miss_a_goal_are_refused(of_two: Callable[..., TuneSpec]) -> None:
    with pytest.raises(InputError, match=r"M_s = 4\.\d+ at 375 N/m: must be ≤ 2 with its fixed gains"):
        run_search(of_two(params={"published": "text"}))
    with pytest.raises(InputError, match=r"tune\.orders, of 2 = M_s = 10\.\d+ at 375 N/m: must be ≤ 2 with its fixed"):
        run_search(of_two(tune={"orders": [1, 2]}))


def test_a_ratio_to_what_was_lost_on_a_tissue_is_refused_where_each_counts(of_two: Callable[..., TuneSpec]) -> None:
    """A risk of 0 there would make the mean over the tissues 0, for every controller: nothing would be left to find."""
    lost = Metrics(*np.ones((len(Metrics._fields), 2, 1, 3)))
    lost.peak_error[1] = np.nan
    with pytest.raises(InputError, match="baseline = lost in every run on 810 N/m"):
        _held(of_two(goals={"soft": {"rms_ratio": 0.5}}), lost)
    some = Metrics(*np.ones((len(Metrics._fields), 2, 2, 3)))
    some.peak_error[1, 0] = np.nan
    for held, soft in ((some, {"rms_ratio": 0.5}), (lost, {"rms_ratio": 0.5, "rms": 0.05})):
        known = np.isfinite(_held(of_two(goals={"soft": soft}), held).rms)
        np.testing.assert_array_equal(known, np.isfinite(held.peak_error))


@pytest.mark.oracle
@in_float64
def test_slopes_of_risk_and_of_every_constraint_are_central_differences(of_two: Callable[..., TuneSpec]) -> None:
    """Step 1e-5: rounding and curvature leave some 1e-7 of each row's largest slope; values from each knot's design."""
    knots = {"lam": True, "Q_x": True, "T_cl": True, "Khat_s": True}
    spec = of_two(tune={"free": {"lam": True, "knots": knots}, "tied": ["Q_x", "Khat_s"], "margin_points": 3})
    names, met = spec.space.names, training(spec, (0,))
    problem = problem_of(spec, met, spectral=True)
    assert problem.hard_goals == ("chatter",)
    z, h = spec.space.encode(spec.params), 1e-5
    # The point itself, and a step to either side along each number.
    points = z + h * np.concatenate([np.zeros((1, len(z))), np.eye(len(z)), -np.eye(len(z))])
    seen = Constraints(problem, len(points))(points, None)
    values, slopes = seen.values[0], seen.slopes[0]
    ahead, behind = np.split(seen.values[1:], 2)
    expected = (ahead - behind).T / (2.0 * h)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert (scale > 0.0).all(), "everything that is held can move"
    np.testing.assert_allclose(slopes / scale, expected / scale, atol=1e-5, rtol=0)

    _, believed = judged_cells(spec, coarse=True)
    fixed = np.isnan(believed)
    goals, tissues = len(spec.margin_goals), len(PLACES)
    assert slopes.shape == (1 + goals * len(believed) + tissues, len(z))
    of_knots = np.array([name.startswith("knots.") for name in names])
    by_goal = slopes[1:-tissues].reshape(goals, len(believed), -1)
    assert (by_goal[:, fixed][:, :, of_knots] == 0.0).all()
    assert (by_goal[:, ~fixed][:, :, ~of_knots] == 0.0).all()
    at_first = slopes[[0, -2, -1], names.index("knots.1.lam")]
    assert at_first[0] != 0.0
    assert at_first[1] != 0.0
    assert at_first[2] == 0.0, "the second knot's tissue does not feel the first"

    path = spec.experiment.loop_path()
    known, ratios = judged_where(spec.params.listening, *FEWER)
    of_margins = values[1:-tissues].reshape(goals, -1)
    params = spec.space.exact(z)
    judged = family_margins(params, known, ratios, path, telling_rates)
    for row, (name, limit) in zip(of_margins[:, ~fixed], spec.margin_goals.items(), strict=True):
        found = np.ravel(getattr(judged, name))
        inverse = limit / found if MARGINS[name].ceiling else found / limit
        np.testing.assert_allclose(row, 1.0 + HEADROOM - inverse, atol=1e-9, rtol=0)
    spectrum, left = spectrum_of(met[0]), []
    for knot, place in zip(params.knots, PLACES, strict=True):
        gains = design(knot, spec.experiment.timing, path.force_filter)
        left.append(soft_worst(residual_rms(gains, contact_of(place, knot.K2, path), spectrum) / spec.soft["rms"]))
    assert values[0] == pytest.approx(float(np.mean(np.log(left))), abs=1e-9)
