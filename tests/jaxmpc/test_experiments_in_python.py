"""Experiments that are built in Python: of numbers and lists of numpy and JAX, equal where they say the same."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Params, evaluate
from jaxmpc.experiment import SensorSettings
from jaxmpc.experiment.tables import ArmSettings
from jaxmpc.files.toml import toml_text

SHORT = {"duration": 1.0, "settle": 0.5, "stiffness": [375.0, 810.0]}


@pytest.mark.parametrize(
    "changed",
    [
        {"stiffness": np.array([375.0, 810.0])},
        {"stiffness": np.array([375, 810])},
        {"stiffness": jnp.asarray([375.0, 810.0])},
        {"stiffness": [np.float32(375.0), np.int64(810)]},
        {"duration": np.float64(1.0), "settle": np.float32(0.5), "delay": np.int64(1)},
        {"sensor": {"lsb": np.array([0.0061, 0.0061, 0.0122]), "seed": np.int64(0)}},
        {"reference": {"preview": np.False_}},
    ],
)
def test_plain_data_may_have_arrays_and_their_numbers(changed: dict[str, Any]) -> None:
    assert Experiment.from_dict({**SHORT, **changed}) == Experiment.from_dict(SHORT)


@pytest.mark.parametrize("wrong", [np.array([375.0, -1.0]), np.array(["375"]), np.array([1j]), np.array([np.nan])])
def test_what_arrays_hold_meets_its_bounds(wrong: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"^stiffness\[\d\] = "):
        Experiment.from_dict({"stiffness": wrong})


@pytest.mark.parametrize(
    "stiffness",
    [[375.0, 810.0], (375, 810), np.array([375.0, 810.0]), tuple(np.array([375, 810])), jnp.array([375, 810])],
)
def test_any_sequence_of_stiffnesses_is_a_tuple_of_floats(stiffness: Any) -> None:
    built, usual = Experiment(stiffness=stiffness), Experiment(stiffness=(375.0, 810.0))
    assert built == usual
    assert hash(built) == hash(usual)
    assert toml_text(built.to_dict()) == toml_text(usual.to_dict())


def test_plain_data_of_an_experiment_with_numbers_of_numpy() -> None:
    built = Experiment(
        duration=np.float64(1.0),
        settle=np.float32(0.5),
        delay=np.int64(2),
        stiffness=tuple(np.float32([375.0, 810.0])),
        sensor=SensorSettings(lsb=np.zeros(3)),
        arm=ArmSettings(coulomb=np.ones(4)),
    )
    read = Experiment.from_dict(built.to_dict())
    assert toml_text(read.to_dict()) == toml_text(built.to_dict()) == toml_text(built.content)


def test_what_is_shorter_than_a_sample_is_told_by_its_duration() -> None:
    for duration in (4e-4, 5e-4):
        with pytest.raises(
            InputError, match=r"^duration = 0\.000[45]: must be at least a sample \(sampling_time = 0\.001"
        ):
            Experiment(duration=duration, settle=0.0)
    assert Experiment(duration=6e-4, settle=0.0).steps == 1


def test_signals_that_are_kept_for_the_next_run_cannot_be_written_to() -> None:
    experiment = Experiment.from_dict(SHORT)
    first = evaluate(Params(), experiment).metrics.rms
    for array in (*experiment.signals, *experiment.heart, *experiment.scored):
        with pytest.raises(ValueError, match="read-only"):
            array *= 2
    assert np.array_equal(evaluate(Params(), experiment).metrics.rms, first)


def test_segments_behind_a_hold_without_an_end_are_refused() -> None:
    """They would never come: 0 N would be simulated and flown, whatever is wanted after a hold without `duration`."""
    ramp = {"kind": "ramp", "to": -5.0, "rate": 2.0}
    axis = [{"kind": "hold", "duration": 1.0}, {"kind": "hold"}]
    for wrong in ([*axis, ramp], [ramp, *axis, *axis]):
        with pytest.raises(InputError, match=r"^reference\.y\[\d\]\.duration = missing: must be given \[s\] before"):
            Experiment.from_dict({"reference": {"y": wrong}})
    assert len(Experiment.from_dict({"reference": {"y": [ramp, *axis]}}).reference.y) == 3
