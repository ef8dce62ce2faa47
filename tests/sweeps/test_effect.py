"""What no run depends on is refused: rows beside each other would be equal, and nobody would be told."""

from typing import Any

import pytest

from jaxmpc.files.errors import InputError
from sweeps.spec import SweepSpec

ARM = {"published": "table-1-wam"}
RHYTHM = {"motion": {"kind": "rhythm", "rhythm": "steady"}}
IDLE: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any], str]] = {
    "a guard on the linear loop": ({}, {}, {"guarded": [True, False]}, "the linear loop has no guard"),
    "the scale of no motion": ({"motion": {"kind": "none"}}, {}, {"motion.scale": [0.5, 1.0]}, "the heart moves"),
    "phases of no motion": ({"motion": {"kind": "none"}}, {}, {"motion.phases": ["table", "random"]}, "has phases"),
    "the unit of no recording": ({}, {}, {"motion.unit": ["m", "mm"]}, "a recording is played"),
    "the seed of a steady rhythm": (
        {"motion": {"kind": "rhythm"}}, {}, {"motion.seed": [0, 1]}, "something of the heart's motion is drawn"
    ),
    "friction that nothing is done about": (
        ARM, {}, {"arm.nominal_presliding": [1e-3, 2e-3]}, "friction is compensated"
    ),
    "a joint of it": (
        ARM | {"arm": {"nominal_coulomb": [1.0] * 4}}, {}, {"arm.nominal_coulomb.2": [1.0, 2.0]}, "is compensated"
    ),
    "the damping of rigid cables": (ARM, {}, {"arm.cable_damping": [0.03, 0.1]}, "cables have a mode"),
    "weights of no MPC": ({}, {"architecture": "aob"}, {"lam": [0.1, 0.2]}, "the part that it is of"),
    "horizons of no MPC": ({}, {"architecture": "aob"}, {"Hp": [10, 20]}, "the part that it is of"),
    "the wanted loop of no observer": ({}, {"published": "mpc-alone"}, {"T_cl": [0.002, 0.003]}, "the part that"),
    "a rate that does not step": (RHYTHM, {}, {"motion.rate_step_at": [5.0, 8.0]}, "the heart's rate steps"),
    "an entry of one": (RHYTHM, {}, {"motion.rate_step_hz.1": [1.5, 2.0]}, "the heart's rate steps"),
    "the mean of a rate that steps": (
        {"motion": {"kind": "rhythm", "rhythm": "rate-step"}}, {}, {"motion.heart_rate_hz": [1.0, 1.5]}, "no rate step"
    ),
    "what steady intervals do not vary by": (RHYTHM, {}, {"motion.rr_variation": [0.0, 0.02]}, "intervals vary"),
    "breath in steady intervals": (RHYTHM, {}, {"motion.sinus_arrhythmia": [0.0, 0.02]}, "intervals vary"),
    "a drift of a steady rate": (RHYTHM, {}, {"motion.heart_rate_drift": [0.0, 10.0]}, "intervals vary"),
    "when a steady ventilator holds": (RHYTHM, {}, {"motion.ventilation_at": [5.0, 8.0]}, "holds or the patient"),
    "how long a cough is held": (
        {"motion": {"kind": "rhythm", "ventilation": "cough"}}, {}, {"motion.hold_duration": [5.0, 8.0]}, "ventilator h"
    ),
    "a constant force that is known ahead": (
        {"reference": {"z": -5.0}}, {}, {"reference.preview": [True, False]}, "the wanted force changes"
    ),
    "presliding of no friction": (
        ARM | {"arm": {"coulomb": [0.0] * 4}}, {}, {"arm.presliding": [1e-3, 2e-3]}, "a joint has Coulomb friction"
    ),
    "times nothing": (
        {}, {}, {"sensor.kalman": {"linear": [0.5, 2.0], "points": 2, "relative": True}}, "a number other than 0"
    ),
}  # fmt: skip
ACTING: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "a guard on the arm": (ARM, {}, {"guarded": [True, False]}),
    "a scale beside no motion": ({}, {}, {"motion.scale": [0.5, 1.0], "motion.kind": ["none", "harmonics"]}),
    "the seed of some rhythm": (
        {"motion": {"kind": "rhythm"}}, {}, {"motion.seed": [0, 1], "motion.rhythm": ["steady", "premature"]}
    ),
    "friction that is compensated": (ARM | {"arm": {"compensation": 0.5}}, {}, {"arm.nominal_presliding": [1e-3]}),
    "the damping of cables": (ARM, {}, {"arm.cable_damping": [0.03, 0.1], "arm.cable_hz": [0.0, 60.0]}),
    "weights of some": ({}, {"architecture": "aob"}, {"lam": [0.1, 0.2], "architecture": ["aob", "mpc-aob"]}),
    "the wanted loop of an observer": ({}, {"architecture": "aob"}, {"T_cl": [0.002, 0.003]}),
    "a rate beside rhythms": (
        RHYTHM, {}, {"motion.rate_step_at": [5.0, 8.0], "motion.rhythm": ["steady", "rate-step"]}
    ),
    "a rate of all rhythms": (RHYTHM, {}, {"motion.heart_rate_hz": [1.0, 1.5]}),
    "when a cough comes": (
        {"motion": {"kind": "rhythm", "ventilation": "cough"}}, {}, {"motion.ventilation_at": [5.0]}
    ),
    "a ramp that is known ahead": ({}, {}, {"reference.preview": [True, False]}),
    "ramps that are known ahead": (
        {"reference": {"z": -5.0}, "settle": 9.0},
        {},
        {"reference.preview": [True], "reference.z": [[{"kind": "ramp", "to": -5.0, "rate": rate}] for rate in (2, 3)]},
    ),
    "presliding beside a joint's friction": (
        ARM | {"arm": {"coulomb": [0.0] * 4}}, {}, {"arm.presliding": [1e-3, 2e-3], "arm.coulomb.1": [0.0, 1.0]}
    ),
    "times nothing on one joint": (
        ARM | {"arm": {"coulomb": [0.0, 2.0, 1.0, 0.5]}}, {}, {"arm.coulomb": {"values": [0.5], "relative": True}}
    ),
}  # fmt: skip


def spec_of(experiment: dict[str, Any], params: dict[str, Any], axes: dict[str, Any]) -> SweepSpec:
    return SweepSpec.from_dict({"experiment": experiment, "params": params, "sweep": {"kind": "grid", "axes": axes}})


@pytest.mark.parametrize("name", IDLE)
def test_what_no_run_depends_on_is_refused(name: str) -> None:
    experiment, params, axes, words = IDLE[name]
    with pytest.raises(InputError, match=words) as caught:
        spec_of(experiment, params, axes)
    assert caught.value.key == f"sweep.axes.{next(iter(axes))}"


@pytest.mark.parametrize("name", ACTING)
def test_what_some_run_depends_on_is_taken(name: str) -> None:
    spec_of(*ACTING[name])


RANKED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "before a rerun on the arm": ({"best": "joint_torque"}, {"rerun": {"best": 1}}, "sweep.best"),
    "beside rows on the arm": ({"best": "torque_step", "axes": {"physics": ["linear", "wam"]}}, {}, "sweep.best"),
    "in a stage": (
        {"best": "swing"},
        {"method": "halving", "stages": [{"keep": 1, "experiment": {"physics": "linear"}}]},
        "sweep.best",
    ),
    "by a limit that no row keeps": (
        {"constraints": {"swing": 0.1}}, {"rerun": {"best": 1}}, "sweep.constraints"
    ),
    "along a front": ({}, {"method": "pareto", "goals": ["rms", "swing"], "rerun": {"best": 1}}, "refine.goals"),
}  # fmt: skip


@pytest.mark.parametrize("name", RANKED)
def test_rows_of_the_linear_loop_are_not_ranked_by_what_it_does_not_measure(name: str) -> None:
    """With 0 for every row the first ones were the best, and with NaN none was."""
    sweep, refine, key = RANKED[name]
    experiment = ARM if name == "in a stage" else {}
    sweep = {"kind": "grid", "axes": {"lam": {"log": [0.1, 0.2], "points": 2}}} | sweep
    with pytest.raises(InputError, match="the linear loop") as caught:
        SweepSpec.from_dict({"experiment": experiment, "sweep": sweep, **({"refine": refine} if refine else {})})
    assert caught.value.key == key


def test_a_rerun_on_the_arm_may_be_limited_by_what_it_measures() -> None:
    sweep = {"kind": "grid", "constraints": {"clamped": 0.001}, "axes": {"lam": [0.1, 0.2]}}
    SweepSpec.from_dict({"sweep": sweep, "refine": {"rerun": {"best": 1}}})


def test_a_guard_that_a_rerun_has_is_taken() -> None:
    sweep = {"kind": "grid", "axes": {"guarded": [True, False]}}
    SweepSpec.from_dict({"sweep": sweep, "refine": {"rerun": {"best": 1}}})
