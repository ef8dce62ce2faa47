"""The convex limit, and whether it is one: independent models of the loop, an LQG, a study, and the law in flight."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import scipy.linalg

from jaxmpc import Params, design, margins
from jaxmpc.cli import main
from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.limit.comparison import LimitCell, flown_by, left_by, told
from jaxmpc.limit.flight import flown
from jaxmpc.limit.judged import Judged
from jaxmpc.limit.law import LinearLaw, response, transfer
from jaxmpc.limit.least import LINES, Demands, Limit, largest_sensitivity, least, limit_of
from jaxmpc.limit.plant import plant_of
from jaxmpc.limit.youla import law_of, signals, stabiliser
from jaxmpc.spectra.effort import acceleration_responses
from jaxmpc.spectra.input_disturbance import uncompensated_acceleration
from jaxmpc.spectra.residual import force_responses, residual_rms
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import closed_around
from jaxmpc.world.contact import hertz
from jaxmpc.world.loop_path import loop_path

pytestmark = pytest.mark.once

T_S = 1e-3
FREE = Demands(M_s=1e3, chatter=np.inf)
"""No bound at all."""


@pytest.fixture(scope="module")
def arm() -> Experiment:
    return Experiment.published("table-1-wam")


@pytest.fixture(scope="module")
def on_arm(arm: Experiment) -> Spectrum:
    return spectrum_of(arm, LINES)


def independent_loop(law: LinearLaw, K_s: float, delay: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closed loop from the noise n to (y, v): A, B, C; scipy's hold, a queue of commands, the sensor's low-pass."""
    hold = scipy.linalg.expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]) * T_S)
    alpha, n = np.exp(-hertz(500.0) * T_S), len(law.B)
    size = 3 + delay + n
    A, B, C = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((2, size))
    measured = np.zeros(size)
    measured[[0, 2]] = (1.0 - alpha) * K_s, alpha
    v = np.concatenate([np.zeros(3 + delay), law.C]) + law.D * measured
    A[:2, :2], A[:2, 2 + delay] = hold[:2, :2], hold[:2, 2]
    A[2], A[3] = measured, v
    for late in range(1, delay):
        A[3 + late, 2 + late] = 1.0
    A[-n:, -n:], B[-n:, 0], B[3] = law.A, law.B, law.D
    A[-n:] += np.outer(law.B, measured)
    C[0], C[1] = measured, v
    return A, B, C


def white(density: float, noise: float, lines: int = 3000) -> Spectrum:
    """A white acceleration of this variance [(m/s²)²] and a noise, on all axes."""
    theta = (np.arange(lines) + 0.5) * np.pi / lines
    push = np.full((3, lines), np.sqrt(2.0 * density / lines), complex)
    return Spectrum(theta, np.zeros_like(push), push, np.full(3, noise))


def test_a_transfer_is_what_solving_at_each_angle_finds() -> None:
    """Of states whose scales lie nine orders of magnitude apart, and with delays, which no eigenvectors tell apart."""
    random, theta = np.random.default_rng(0), np.geomspace(1e-3, 3.1, 50)
    A = random.standard_normal((12, 12))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    A = np.block([[A, random.standard_normal((12, 4))], [np.zeros((4, 12)), np.eye(4, k=1)]])
    scale = np.geomspace(1e-6, 1e3, 16)
    A, B, C = A * scale[:, None] / scale, random.standard_normal((16, 2)) * scale[:, None], np.ones((3, 16)) / scale
    C[1:] *= random.standard_normal((2, 16))
    each = [C @ np.linalg.solve(z * np.eye(16) - A, B) for z in np.exp(1j * theta)]
    np.testing.assert_allclose(transfer(A, B, C, theta), each, rtol=1e-9)


@pytest.mark.parametrize(("stiffness", "damping", "delay"), [(375.0, 0.0, 1), (1900.0, 12.0, 2)])
def test_a_realised_law_answers_as_the_optimiser_thought(stiffness: float, damping: float, delay: int) -> None:
    contact = contact_of(stiffness, damping, loop_path(delay=delay))
    plant, theta = plant_of(contact), np.geomspace(1e-2, 3.0, 40)
    around = stabiliser(plant, stiffness, T_S)
    weights = np.random.default_rng(1).standard_normal(9) * 10.0
    law = law_of(plant, around, 0.8, weights)
    loop = closed_around(response(law, theta), contact, theta)
    expected = force_responses(loop), acceleration_responses(loop)
    for signal, answer in zip(signals(plant, around, 0.8, 8, theta), expected, strict=True):
        # One way through state space, the other through transfer functions, which lose digits near their poles at 1.
        np.testing.assert_allclose(signal.base + signal.per_weight @ weights, np.stack(answer, 1), rtol=1e-6)


def test_without_a_heart_the_least_is_the_noise_itself() -> None:
    # ∫ ln|S| ≥ 0 for every law with two samples of delay, so mean|S|² ≥ 1.
    silent = Spectrum(np.ones(2), np.zeros((3, 2), complex), np.zeros((3, 2), complex), np.full(3, 0.010))
    least_of_all = least(silent, loop_path(), 810.0, "x", FREE).reached
    # The class has integral action, which costs a little.
    assert 0.010 * (1.0 - 1e-4) <= least_of_all.rms <= 0.010 * 1.01


@pytest.mark.oracle
def test_a_sensor_without_noise_is_as_one_with_hardly_any() -> None:
    """Noise is also the solver's unit, which must not be nothing."""
    none, some = (least(white(1.0, noise), loop_path(), 810.0, "x").reached.rms for noise in (0.0, 1e-6))
    assert 0.0 < none == pytest.approx(some, rel=1e-3)


@pytest.mark.parametrize("density", [0.01, 1.0])
def test_without_bounds_it_is_the_linear_quadratic_gaussian_optimum(density: float) -> None:
    K_s, sigma = 810.0, 0.01
    path = loop_path(lowpass_hz=0.0)
    found = least(white(density, sigma), path, K_s, "x", FREE).reached

    hold = scipy.linalg.expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]) * T_S)[:2]
    A = np.vstack([hold, np.zeros(3)])
    B, C = np.array([[0.0], [0.0], [1.0]]), np.array([[K_s, 0.0, 0.0]])
    W = density * np.outer(np.append(hold[:, 2], 0.0), np.append(hold[:, 2], 0.0))
    cheap = np.array([[1e-9]])
    S = scipy.linalg.solve_discrete_are(A, B, C.T @ C, cheap)
    K = np.linalg.solve(B.T @ S @ B + cheap, B.T @ S @ A)
    before = scipy.linalg.solve_discrete_are(A.T, C.T, W, np.array([[sigma**2]]))
    after = before - before @ C.T @ C @ before / (C @ before @ C.T + sigma**2)
    optimum = np.sqrt(np.trace(S @ W) + np.trace(K @ after @ K.T @ (B.T @ S @ B + cheap)) + sigma**2)
    # Never below the optimum but by the grid of the noise; 40 functions come within a percent.
    assert 0.999 * optimum <= found.rms <= 1.01 * optimum


@pytest.mark.oracle
@pytest.mark.parametrize("delay", [1, 2])
def test_stability_sensitivity_and_noise_by_another_model_of_the_loop(on_arm: Spectrum, delay: int) -> None:
    found = least(on_arm, loop_path(delay=delay), 1900.0, "x")
    A, B, C = independent_loop(found.law, 1900.0, delay)
    assert np.abs(np.linalg.eigvals(A)).max() < 1.0

    system = control.ss(A, B, C[:1], [[1.0]], T_S)
    theta = np.concatenate([np.geomspace(1e-3, 0.2, 3000), np.linspace(0.2, np.pi, 6000)])
    peak = np.abs(np.squeeze(control.frequency_response(system, theta / T_S).complex)).max()
    # Between the angles of the optimiser it may rise a little.
    assert found.reached.M_s == pytest.approx(peak, rel=1e-3)
    assert peak <= 2.0 * 1.005

    spread = scipy.linalg.solve_discrete_lyapunov(A, B @ B.T)
    variance = C[0] @ spread @ C[0] + 1.0
    # Exact against trapezoids.
    assert found.reached.noise == pytest.approx(on_arm.noise[0] * np.sqrt(variance), rel=2e-3)


@pytest.mark.parametrize(("axis", "stiffness"), [("x", 1900.0), ("z", 375.0)])
def test_what_is_handed_out_keeps_its_promise_in_flight(
    arm: Experiment, on_arm: Spectrum, axis: str, stiffness: float
) -> None:
    found = least(on_arm, arm.loop_path(), stiffness, axis)
    pushed = uncompensated_acceleration(arm)[:, "xyz".index(axis)]
    flight = flown(found.law, stiffness, arm, axis, pushed)
    promised = found.reached.rms, found.reached.true_rms, found.reached.chatter
    # The bar is 3 % for what is measured; a single seed of noise is good to one percent.
    np.testing.assert_allclose(flight, promised, rtol=0.03)
    assert found.reached.chatter <= 1.2 * (1.0 + 1e-3)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["table-1", "table-1-wam", "rhythm-fibrillation", "rhythm-variability"])
def test_every_law_keeps_its_promise_in_flight(name: str) -> None:
    experiment = Experiment.published(name)
    spectrum, path = spectrum_of(experiment, LINES), experiment.loop_path()
    on_the_arm = experiment.physics != "linear"
    pushed = uncompensated_acceleration(experiment) if on_the_arm else np.zeros((experiment.steps, 3))
    for stiffness in experiment.stiffness:
        for index, axis in enumerate("xyz"):
            found = least(spectrum, path, stiffness, axis)
            flight = flown(found.law, stiffness, experiment, axis, pushed[:, index])
            assert flight.rms == pytest.approx(found.reached.rms, rel=0.03), (stiffness, axis)


@pytest.mark.oracle
def test_a_study_with_other_models_found_the_same(arm: Experiment, on_arm: Spectrum) -> None:
    # 17.0 and 21.6 mN on the worst axis, 40 functions of another basis, friction of a MuJoCo arm.
    for stiffness, studied in ((375.0, 0.0170), (1900.0, 0.0216)):
        worst = max(least(on_arm, arm.loop_path(), stiffness, axis).reached.rms for axis in "xz")
        assert worst == pytest.approx(studied, rel=0.05)


@pytest.mark.oracle
def test_a_band_holds_what_it_promises_and_costs(on_arm: Spectrum) -> None:
    path = loop_path()
    narrow, wide = (least(on_arm, path, 810.0, "z", Demands(band=band)) for band in (0.0, 0.15))
    assert wide.reached.rms > narrow.reached.rms
    for gain in np.linspace(0.85, 1.15, 13):
        A, B, C = independent_loop(wide.law, gain * 810.0)
        assert np.abs(np.linalg.eigvals(A)).max() < 1.0
        theta = np.linspace(0.01, np.pi, 4000)
        answers = control.frequency_response(control.ss(A, B, C[:1], [[1.0]], T_S), theta / T_S)
        assert np.abs(np.squeeze(answers.complex)).max() <= 2.0 * 1.005


@pytest.mark.oracle
def test_tighter_bounds_leave_more(on_arm: Spectrum) -> None:
    path = loop_path()
    order = [Demands(chatter=np.inf), Demands(chatter=6.0), Demands(), Demands(M_s=1.5), Demands(M_s=1.5, chatter=0.6)]
    residuals = [least(on_arm, path, 1900.0, "x", demands).reached.rms for demands in order]
    assert residuals == sorted(residuals)
    assert residuals[-1] > 1.2 * residuals[0]


@pytest.mark.oracle
def test_a_damping_is_held_at_both_cuts(on_arm: Spectrum) -> None:
    found = least(on_arm, loop_path(), 810.0, "z", damping=60.0)
    contact, theta = contact_of(810.0, 60.0, loop_path()), np.linspace(0.01, np.pi, 4000)
    loop = closed_around(response(found.law, theta), contact, theta)
    cut_at_a, cut_at_v = np.abs(1.0 / loop.whole).max(), np.abs((1.0 + loop.damping) / loop.whole).max()
    assert max(cut_at_a, cut_at_v) == pytest.approx(found.reached.M_s, rel=1e-2)
    assert found.reached.M_s <= 2.0 * 1.005


@pytest.mark.parametrize(("damping", "worse_at_a"), [(10.0, False), (300.0, True)])
def test_the_largest_sensitivity_is_that_of_either_cut(damping: float, worse_at_a: bool) -> None:
    """In state space: what is added to v, or to a, comes to the arm by one way, and S is what is seen there of it."""
    contact = contact_of(810.0, damping, loop_path())
    plant = plant_of(contact)
    law = law_of(plant, stabiliser(plant, 810.0, T_S), 0.8, np.zeros(3))
    state = [
        [plant.A + law.D * np.outer(plant.B, plant.C), np.outer(plant.B, law.C)],
        [np.outer(law.B, plant.C), law.A],
    ]
    v, nothing = np.append(law.D * plant.C, law.C), np.zeros(len(law.B))
    seen = np.stack([v, v + np.append(plant.C_a, nothing)])
    system = control.ss(np.block(state), np.append(plant.B, nothing)[:, None], seen, np.ones((2, 1)), T_S)
    theta = np.geomspace(1e-3, np.pi, 4000)
    at_v, at_a = np.abs(np.squeeze(control.frequency_response(system, theta / T_S).complex)).max(axis=1)
    assert (at_a > 1.2 * at_v) == worse_at_a
    assert largest_sensitivity(law, contact, 0.0) == pytest.approx(max(at_v, at_a), rel=1e-3)


def test_a_controller_with_a_low_pass_of_its_own_is_judged_behind_it() -> None:
    """As in an experiment that has it; what the heart leaves of the force is told, too, not M_s alone."""
    strong, spectrum = Params(K2=100.0, Khat_s=970.0), white(1.0, 0.01, 50)
    own = replace(strong, velocity_cutoff=400.0)
    there = left_by(strong, spectrum, loop_path().with_cutoff(400.0), 810.0, "x")
    np.testing.assert_allclose(left_by(own, spectrum, loop_path(), 810.0, "x"), there, rtol=1e-9)
    assert abs(left_by(strong, spectrum, loop_path(), 810.0, "x").rms / there.rms - 1.0) > 1e-3


@pytest.mark.oracle
def test_a_controller_is_judged_as_everywhere_and_leaves_more(arm: Experiment, on_arm: Spectrum) -> None:
    path, cautious = arm.loop_path(), Params.published("cautious")
    gains = design(cautious)
    usual = np.asarray(residual_rms(gains, contact_of(810.0, cautious.K2, path), on_arm))
    yours = left_by(cautious, on_arm, path, 810.0, "z")
    # The usual sum over the noise is good to 0.5 %.
    assert yours.rms == pytest.approx(usual[2], rel=5e-3)
    assert yours.M_s <= 2.0
    same_bounds = least(on_arm, path, 810.0, "z", Demands(yours.M_s, yours.chatter), damping=float(cautious.K2))
    assert yours.rms > 1.2 * same_bounds.reached.rms


def test_a_controller_that_is_unstable_has_no_residual(on_arm: Spectrum) -> None:
    yours = left_by(Params(Khat_s=200.0), on_arm, loop_path(), 1900.0, "x")
    assert np.isnan(yours.rms)
    assert yours.M_s == np.inf


def test_a_controller_is_held_to_its_sensitivity_in_the_whole_band(on_arm: Spectrum) -> None:
    within = margins(Params(), 1900.0 * np.array([0.92, 1.0, 1.08])).M_s
    assert left_by(Params(), on_arm, loop_path(), 1900.0, "x", 0.08).M_s == pytest.approx(float(np.max(within)))
    assert np.max(within) > 1.05 * within[1]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"axis": "q"}, "axis"),
        ({"axis": 0}, "axis"),
        ({"stiffness": -1.0}, "stiffness"),
        ({"M_s": 1.0}, "M_s"),
        ({"chatter": 0.0}, "chatter"),
        ({"band": 1.0}, "band"),
        ({"M_s": 1.02, "chatter": 0.01, "band": 0.5}, "limit"),
    ],
)
def test_what_makes_no_sense_is_refused(change: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as refused:
        limit_of(Experiment.published("table-1"), **({"stiffness": 810.0, "axis": "x"} | change))
    assert refused.value.key == key


def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text('name = "short"\nduration = 8.0\nsettle = 4.0\nstiffness = [810.0]\ndamping = "sampled"\n')
    return path


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "limit.json"
    assert main(["limit", str(short(tmp_path)), "--params", "cautious", "--fly", "-o", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "× the limit" in printed
    found = json.loads(file.read_text())
    assert [cell["axis"] for cell in found["cells"]] == ["x", "y", "z"]
    for cell in found["cells"]:
        assert cell["ratio"] == pytest.approx(cell["yours"]["rms"] / cell["limit"]["rms"])
        assert cell["flown"]["rms"] == pytest.approx(cell["limit"]["rms"], rel=0.1)
        assert len(cell["law"]["B"]) == len(cell["law"]["A"])


def test_without_the_extra_it_says_how_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    assert main(["limit", str(short(tmp_path))]) == 2
    assert "pip install 'jaxmpc[limit]'" in capsys.readouterr().err


def test_what_learns_the_beat_is_told_as_flown() -> None:
    judged = Judged(0.030, 0.01, 0.02, 0.01, 0.028, 1.1, 1.9)
    law = LinearLaw(np.zeros((1, 1)), np.zeros(1), np.zeros(1), 0.0)
    cell = LimitCell(810.0, "x", Limit(judged._replace(rms=0.020), law), judged)
    assert cell.ratio == pytest.approx(1.5)
    assert cell._replace(flown=0.024).ratio == pytest.approx(1.2)
    assert np.isnan(cell._replace(yours=None).ratio)
    nothing = cell._replace(limit=Limit(judged._replace(rms=0.0), law))
    assert np.isnan(nothing.ratio)
    assert "nothing disturbs the loop" in told([nothing])
    assert "1.50 to 1.50 × the limit" in told([nothing, cell])
    assert "unstable" in told([cell, cell._replace(yours=judged._replace(rms=np.nan, M_s=np.inf))])
    assert flown_by(Params.published("cautious"), Experiment.published("table-1-wam")) is None


@pytest.mark.parametrize(("flag", "value"), [("--sensitivity", "1"), ("--chatter", "0"), ("--band", "1")])
def test_a_demand_that_makes_no_sense_is_told_by_its_flag(
    flag: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["limit", "table-1", flag, value]) == 2
    assert capsys.readouterr().err.startswith(f"jaxmpc limit: {flag} = {value}")
