"""The closed loop over time: against scipy, against central differences, and what it says of bad controllers."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import scipy.signal

from jaxmpc import Experiment, InputError, Params, Status, design, evaluate
from jaxmpc.closed_loops import close_loops
from jaxmpc.engine.base import scalars
from jaxmpc.engine.linear_scan import over_cells, run
from jaxmpc.engine.scenario import scenario_data
from jaxmpc.world.contact import hertz

replace = msgspec.structs.replace
SHORT = replace(Experiment.published("table-1"), duration=4.0, settle=3.0)


@pytest.mark.parametrize("damping", [pytest.param("ideal", marks=pytest.mark.oracle), "sampled"])
@pytest.mark.parametrize(
    "params",
    [
        Params(),
        pytest.param(Params(architecture="aob"), marks=pytest.mark.oracle),
        pytest.param(Params(architecture="mpc", Q_p=1e3, Hp=60, Hu=10), marks=pytest.mark.oracle),
    ],
)
def test_the_loop_is_scipys(independent_loop: Callable[..., Any], params: Params, damping: str) -> None:
    """Every sample of three seconds on three stiffnesses and axes, quantiser off: 1e-9 of the largest force."""
    experiment = replace(
        SHORT,
        damping=damping,
        duration=3.5,
        delay=2,
        stiffness=(375.0, 600.0, 810.0),
        sensor=replace(SHORT.sensor, lsb=(0.0, 0.0, 0.0), lowpass_hz=500.0),
    )
    outcome = evaluate(params, experiment, trace=True)
    gains, signals = design(params), experiment.signals
    for row, K_s in enumerate(experiment.stiffness):
        loop = independent_loop(gains, K_s, float(params.K2), 2, damping == "ideal", hertz(500.0))
        for axis in range(3):
            inputs = np.column_stack([signals.heart[:, axis], signals.noise[:, axis], signals.force_ref[:, axis]])
            _, expected, _ = scipy.signal.dlsim((*loop, 1e-3), inputs)
            ours = np.asarray(outcome.trace.force)[row, axis]
            np.testing.assert_allclose(ours, expected[:, 0], atol=1e-9 * np.abs(expected).max())


def test_metrics_are_those_of_the_trace() -> None:
    outcome = evaluate(Params(), SHORT, trace=True)
    error = np.asarray(outcome.trace.force - outcome.trace.force_ref[..., 0])[:, :, 3000:]
    a = np.asarray(outcome.trace.a)
    np.testing.assert_allclose(outcome.metrics.rms, np.sqrt((error**2).mean(axis=-1)), rtol=1e-9)
    np.testing.assert_allclose(outcome.metrics.peak_to_peak, np.ptp(error, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(outcome.metrics.effort, np.sqrt((a[..., 3000:] ** 2).mean(axis=-1)), rtol=1e-9)
    chatter = np.sqrt((np.diff(a, axis=-1)[..., 2999:] ** 2).mean(axis=-1))
    np.testing.assert_allclose(outcome.metrics.chatter, chatter, rtol=1e-9)
    np.testing.assert_allclose(outcome.metrics.peak_force, np.abs(outcome.trace.force).max(axis=-1), rtol=1e-12)
    true = np.asarray(outcome.trace.true_force - outcome.trace.force_ref[..., 0])[:, :, 3000:]
    np.testing.assert_allclose(outcome.metrics.true_rms, np.sqrt((true**2).mean(axis=-1)), rtol=1e-9)
    np.testing.assert_allclose(outcome.metrics.true_peak_to_peak, np.ptp(true, axis=-1), rtol=1e-9)
    for name in ("clamped", "joint_torque", "torque_step"):
        assert (np.asarray(getattr(outcome.metrics, name)) == 0.0).all()


@pytest.mark.parametrize("physics", ["linear", pytest.param("wam", marks=pytest.mark.oracle)])
def test_who_knows_the_reference_ahead_is_judged_by_that_of_the_sample_itself(physics: str) -> None:
    """Not by the first that it was told, which is of the next sample."""
    fast = {"z": [{"kind": "sweep", "amplitude": 2.0, "start": 2.0, "stop": 4.0, "duration": 1.5}], "preview": True}
    still = {"motion": {"kind": "none"}, "sensor": {"noise": 0.0, "lsb": [0.0, 0.0, 0.0]}, "stiffness": [810.0]}
    experiment = Experiment.from_dict({"physics": physics, "duration": 1.5, "settle": 0.5, "reference": fast, **still})
    outcome = evaluate(Params(), experiment, trace=True)
    assert outcome.trace is not None
    error = (np.asarray(outcome.trace.force)[0] - experiment.signals.force_ref[:1500].T)[2, 500:]
    metrics = outcome.metrics
    assert float(metrics.rms[0, 2]) == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert float(metrics.peak_to_peak[0, 2]) == pytest.approx(np.ptp(error), rel=1e-9)
    told = np.asarray(outcome.trace.force_ref)[0, 2, :-1, 0]
    np.testing.assert_array_equal(told, experiment.signals.force_ref[1:1500, 2])


@pytest.mark.parametrize("damping", ["ideal", "sampled"])
def test_the_measured_force_is_the_true_one_behind_the_sensor(damping: str) -> None:
    """Low-pass by scipy, the noise of the experiment, rounding to the sensor's LSB."""
    experiment = replace(SHORT, damping=damping)
    trace: Any = evaluate(Params(), experiment, trace=True).trace
    cutoff = experiment.loop_path().sensor_cutoff
    pole = float(np.exp(-cutoff * experiment.sampling_time)) if cutoff else 0.0
    felt = scipy.signal.lfilter([1.0 - pole], [1.0, -pole], np.asarray(trace.true_force), axis=-1)
    noise, lsb = experiment.signals.noise[: experiment.steps].T, np.array(experiment.sensor.lsb)[:, None]
    # Where a value lies on the edge between two counts, rounding differently moves it by one.
    off = np.asarray(trace.force) - lsb * np.floor((felt + noise) / lsb + 0.5)
    assert np.count_nonzero(np.abs(off) > 1e-9) < 1e-4 * off.size
    assert (damping == "ideal") == (pole == 0.0)


def test_heart_motion_alone_leaves_the_known_residual() -> None:
    """§1.4: at 810 N/m, Z, motion alone 0.19 N peak to peak and 0.040 N RMS."""
    quiet = Experiment.published("table-1")
    quiet = replace(quiet, sensor=replace(quiet.sensor, noise=0.0, lsb=(0.0, 0.0, 0.0)))
    found = evaluate(Params(), quiet).metrics
    assert float(found.rms[1, 2]) == pytest.approx(0.040, abs=0.0015)
    assert float(found.peak_to_peak[1, 2]) == pytest.approx(0.19, abs=0.01)


@pytest.mark.oracle
def test_unstable_controller_is_a_status_and_spares_its_neighbours() -> None:
    outcome = evaluate(Params.stack([Params(), Params.published("printed")]), SHORT)
    assert outcome.status.tolist() == [[Status.OK] * 3, [Status.OK, Status.OK, Status.UNSTABLE]]
    assert np.isnan(outcome.metrics.rms[1, 2]).all()
    alone = evaluate(Params(), SHORT)
    np.testing.assert_allclose(outcome.metrics.rms[0], alone.metrics.rms, rtol=1e-9)


def test_float32_stepping_tells_the_same() -> None:
    """Rounding moves single samples by a count of the sensor; 1 s of it moves the RMS by less than 1 %."""
    fine, coarse = (evaluate(Params(), SHORT, precision=p) for p in ("float64", "float32"))
    np.testing.assert_allclose(coarse.metrics.rms, fine.metrics.rms, rtol=0.01)
    np.testing.assert_array_equal(coarse.margins.M_s, fine.margins.M_s)


def test_float32_sums_lose_nothing_over_a_whole_experiment() -> None:
    quiet = Experiment.published("table-1")
    quiet = replace(quiet, sensor=replace(quiet.sensor, lsb=(0.0, 0.0, 0.0)))
    fine, coarse = (evaluate(Params(), quiet, precision=p) for p in ("float64", "float32"))
    np.testing.assert_allclose(coarse.metrics.rms, fine.metrics.rms, rtol=1e-4)


@pytest.mark.slow
def test_preview_follows_a_known_reference_better() -> None:
    moving = Experiment.published("figure-3")
    still = replace(moving, motion=replace(moving.motion, kind="none"), settle=9.5, duration=19.0)
    known = replace(still, reference=replace(still.reference, preview=True))
    blind, told = (evaluate(Params(T_cl=2e-2), e).metrics.rms[0, 2] for e in (still, known))
    assert told < 0.5 * blind


def test_aob_alone_takes_the_reference_as_it_is() -> None:
    outcome = evaluate(Params(architecture="aob"), SHORT, trace=True)
    np.testing.assert_allclose(outcome.trace.u, outcome.trace.force_ref[..., 0], atol=1e-9)


def test_cascade_beats_the_observer_alone() -> None:
    cascade, observer = (evaluate(Params(architecture=a), SHORT).metrics.rms for a in ("mpc-aob", "aob"))
    # On Z, where the heart moves most; on X and Y the sensor's noise is a good part of the residual.
    assert (np.asarray(cascade)[:, 2] < 0.75 * np.asarray(observer)[:, 2]).all()


def test_classical_mpc_runs_and_is_stable() -> None:
    outcome = evaluate(Params(architecture="mpc", Q_p=1e3, Hp=60, Hu=10, Khat_s=1500.0), SHORT)
    assert outcome.status.tolist() == [Status.OK] * 3


def test_unknown_physics_is_refused() -> None:
    with pytest.raises(InputError, match="physics"):
        evaluate(Params(), SHORT, physics="wamm")  # type: ignore[arg-type]  # what is refused


NAMES = ("lam", "Q_p", "Q_x", "T_cl", "K2", "Khat_s")
POINT = np.log([0.3, 2.0, 1e-3, 1.5e-3, 25.0, 700.0])


def residual(experiment: Experiment) -> Callable[[jax.Array], jax.Array]:
    scene = scenario_data(experiment)

    def total(x: jax.Array) -> jax.Array:
        params = Params(**dict(zip(NAMES, jnp.exp(x), strict=True)))
        one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], params)
        gains, _, contacts, *_ = close_loops(one, scene.stiffness, scene.path)
        batch = scalars(gains, False), contacts
        return jnp.sum(over_cells(run, *batch, scene.lsb, scene.signals)[0].rms)

    return jax.jit(total)


def central(function: Callable[[jax.Array], jax.Array], step: float) -> np.ndarray:
    shifts = step * np.eye(len(POINT))
    return np.array([float(function(POINT + s) - function(POINT - s)) / (2.0 * step) for s in shifts])


@pytest.mark.parametrize(
    ("damping", "mode"),
    [
        ("sampled", "reverse"),
        ("ideal", "reverse"),
        ("sampled", "forward"),
        ("ideal", "forward"),
    ],
)
@pytest.mark.oracle
def test_gradient_through_design_and_loop_is_the_central_difference(damping: str, mode: str) -> None:
    experiment = replace(
        SHORT,
        damping=damping,
        duration=0.5,
        settle=0.2,
        sensor=replace(SHORT.sensor, lsb=(0.0, 0.0, 0.0)),
        reference=replace(SHORT.reference, z=-1.0),
    )
    function = residual(experiment)
    gradient = {"forward": jax.jacfwd, "reverse": jax.grad}[mode](function)(POINT)
    expected = central(function, 1e-5)
    np.testing.assert_allclose(gradient, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.oracle
def test_gradient_sees_through_the_quantiser() -> None:
    """A plain derivative of the quantiser would cut the feedback; a step of 1e-3 averages over its counts.

    Motion 50 times the heart's only raises the residual above the counts, which the difference still feels.
    """
    experiment = replace(SHORT, duration=6.0, settle=0.5, motion=replace(SHORT.motion, scale=50.0))
    experiment = replace(experiment, reference=replace(experiment.reference, z=-1.0))
    function = residual(experiment)
    gradient, expected = np.asarray(jax.grad(function)(POINT)), central(function, 1e-3)
    assert gradient @ expected / np.linalg.norm(gradient) / np.linalg.norm(expected) > 0.99
