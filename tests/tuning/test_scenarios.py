"""Scenarios: what a seed draws, and that a scene of many is each of them."""

import re
from typing import Any, get_args

import jax
import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, Params, evaluate
from jaxmpc.experiment.reference import Reference
from jaxmpc.experiment.tables import Change, softening
from jaxmpc.files.errors import InputError
from tuning.job.scenarios import Rhythm, Scenarios, _data, describe, draw, scenario, scenarios
from tuning.objective.comparison import compare

ARM = msgspec.structs.replace(Experiment.published("table-1-wam"), duration=0.5, settle=0.1, reference=Reference())
WIDE = Scenarios(rhythms=get_args(Rhythm), friction=0.3, mass=0.1, stiffness=0.2, delays=(1, 2))


def test_a_seed_draws_the_same_whatever_else_is_drawn() -> None:
    one = scenario(ARM, WIDE, 5)
    assert one == scenario(ARM, WIDE, 5)
    narrower = scenario(ARM, msgspec.structs.replace(WIDE, mass=0.0, delays=()), 5)
    assert narrower.arm.coulomb == one.arm.coulomb
    assert narrower.arm.mass_error == pytest.approx(ARM.arm.mass_error)
    assert one != scenario(ARM, WIDE, 14), "the same rhythm with another seed"


def test_draws_fill_their_ranges() -> None:
    drawn = scenarios(ARM, WIDE, range(300))
    friction = np.array([one.arm.coulomb for one in drawn]) / ARM.arm.coulomb
    mass = (1.0 + ARM.arm.mass_error) / (1.0 + np.array([one.arm.mass_error for one in drawn]))
    for values, width in ((friction, 0.3), (mass, 0.1)):
        assert 1.0 - width <= values.min() < 1.0 - 0.9 * width
        assert 1.0 + 0.9 * width < values.max() <= 1.0 + width
    assert {one.delay for one in drawn} == {1, 2}
    np.testing.assert_allclose([one.arm.viscous[2] / ARM.arm.viscous[2] for one in drawn], friction[:, 2])
    assert {one.motion.kind for one in drawn} == {"harmonics", "rhythm"}
    # What the controller believes of friction stays what it is.
    assert {one.arm.nominal_coulomb for one in drawn} == {ARM.arm.coulomb}


def test_nothing_to_draw_is_the_experiment_with_other_phases() -> None:
    one = scenario(ARM, Scenarios(), 3)
    assert one.motion == ARM.with_seed(3).motion
    assert one.arm.coulomb == ARM.arm.coulomb
    assert describe(one).startswith("harmonics, seed 3")


def test_events_fall_into_a_short_run() -> None:
    events: tuple[Rhythm, ...] = ("rate-step", "hold", "cough")
    for rhythm in events:
        settings = Scenarios(rhythms=(rhythm,))
        motion = scenario(msgspec.structs.replace(ARM, duration=6.0, settle=2.0), settings, 0).motion
        assert 2.0 < (motion.rate_step_at if rhythm == "rate-step" else motion.ventilation_at) < 4.0


def test_tissue_that_changes_stays_as_much_stiffer_as_was_drawn() -> None:
    """After its first change it had the experiment's stiffness again, whatever had been drawn."""
    turning = msgspec.structs.replace(ARM.tissue, changes=(Change(0.2, 4.0, 0.1), Change(0.4, 0.5, 0.0)))
    one = scenario(msgspec.structs.replace(ARM, tissue=turning), WIDE, 5)
    factor = draw(ARM, WIDE, 5).stiffness
    assert abs(factor - 1.0) > 0.01
    times = np.array([0.1, 0.25, 0.35, 0.45])
    np.testing.assert_allclose(softening(one.tissue, times), factor * softening(turning, times))


@pytest.mark.filterwarnings("error")
def test_a_joint_without_friction_has_a_factor_of_one() -> None:
    """It was told as nan, beside a warning of numpy's."""
    arm = msgspec.structs.replace(ARM.arm, coulomb=(0.0, 2.0, 1.0, 0.0))
    said = describe(scenario(msgspec.structs.replace(ARM, arm=arm), Scenarios(friction=0.3), 5))
    assert re.search(r"friction × 1\.00, [01]\.\d\d, [01]\.\d\d, 1\.00;", said)


@pytest.mark.oracle
def test_side_by_side_is_each_by_itself() -> None:
    """Friction, masses and delay of its own for each scenario; the same arithmetic lane by lane."""
    drawn = scenarios(ARM, WIDE, [0, 9, 18])
    params = Params.published("text")
    together = compare([params], drawn)
    for i, one in enumerate(drawn):
        alone = evaluate(params, one).metrics
        np.testing.assert_allclose(together.rms[0, i], alone.rms, rtol=1e-9)
        np.testing.assert_allclose(together.peak_error[0, i], alone.peak_error, rtol=1e-9)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"friction": 0.3}, "scenarios.friction"),
        ({"cable_hz": (15.0, 60.0)}, "scenarios.cable_hz"),
        ({"rhythms": ()}, "scenarios.rhythms"),
        ({"cable_hz": (60.0, 15.0)}, "scenarios.cable_hz"),
    ],
)
def test_what_the_linear_world_cannot_show_is_refused(settings: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as caught:
        Scenarios(**settings).check(Experiment.published("table-1"))
    assert caught.value.key == key


def test_the_arrays_of_a_scenario_are_made_once_for_each_precision() -> None:
    short = msgspec.structs.replace(Experiment.published("table-1-wam"), duration=3.0, settle=2.0)
    once, again = (scenarios(short, Scenarios(), [1000])[0] for _ in range(2))
    made = _data(once, True, jax.config.jax_enable_x64)
    assert _data(again, True, jax.config.jax_enable_x64) is made
    with jax.enable_x64(not jax.config.jax_enable_x64):
        other = _data(again, True, jax.config.jax_enable_x64)
    assert other is not made
