"""The sample recording: it comes with the program, is what the twin makes, and tells of the twin's friction."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import msgspec
import numpy as np
import pytest

from deploy.twin.own_motion import EVERY, own_motion, settings
from deploy.twin.world import TICK
from jaxmpc.cli import main
from jaxmpc.cli.identify import EXAMPLES, SAMPLE
from jaxmpc.experiment.tables import ArmSettings
from jaxmpc.files.errors import InputError
from jaxmpc.files.toml import read_toml
from jaxmpc.identify.friction_fit import smooth
from jaxmpc.identify.identification import HEAVIEST, LIGHTEST, identify, read_recording, write


def test_it_is_the_twins() -> None:
    """Printed to 1e-5 rad and 1e-3 N m; a second is enough, as an arm that moves otherwise does so at once."""
    t, q, tau = read_recording(EXAMPLES / f"{SAMPLE}.csv")
    again = own_motion(1.0)
    rows = slice(len(again))
    np.testing.assert_allclose(t[rows], again[:, 0], atol=1e-9)
    np.testing.assert_allclose(q[rows], again[:, 1:5], atol=2e-5)
    np.testing.assert_allclose(tau[rows], again[:, 5:], atol=2e-3)
    assert np.diff(t) == pytest.approx(EVERY * TICK)


def test_what_it_tells_is_what_the_twin_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["identify", "twin-motion"]) == 0
    assert "made by the twin" in capsys.readouterr().out
    found, truth = read_toml(tmp_path / "friction.toml")["arm"], settings()
    # Encoder steps and the low-pass leave some percent of the friction, more of the presliding.
    np.testing.assert_allclose(found["coulomb"], truth.coulomb, rtol=0.03)
    np.testing.assert_allclose(found["viscous"], truth.viscous, rtol=0.12)
    assert found["presliding"] == pytest.approx(truth.presliding, rel=0.15)
    # The links are heavier, the tool is not: the one scale of both lies between.
    assert 1.0 < 1.0 / (1.0 + found["mass_error"]) < truth.mass_scale


def test_friction_is_never_less_than_none(tmp_path: Path) -> None:
    """What is written goes into an experiment, also where a joint has no viscous friction that could be told."""
    recording = read_recording(EXAMPLES / f"{SAMPLE}.csv")
    _, qdot, _ = smooth(recording.t, recording.q, 60.0)
    taken = 1.1 * np.array(settings().viscous)
    found = identify(recording._replace(tau=recording.tau - qdot * taken))
    write(tmp_path / "friction.toml", found)
    table = read_toml(tmp_path / "friction.toml")["arm"]
    arm = msgspec.convert(table, ArmSettings)
    assert 0.0 <= min(arm.viscous) < 1e-6


def test_masses_that_are_taken_are_those_that_an_experiment_can_have() -> None:
    for mass_scale, taken in ((LIGHTEST, True), (0.99 * LIGHTEST, False), (0.99 * HEAVIEST, True), (HEAVIEST, False)):
        with nullcontext() if taken else pytest.raises(msgspec.ValidationError):
            msgspec.convert({"mass_error": 1.0 / mass_scale - 1.0}, ArmSettings)


def test_degrees_and_torques_of_the_other_sign_are_told() -> None:
    recording = read_recording(EXAMPLES / f"{SAMPLE}.csv")
    for wrong in (recording._replace(q=np.rad2deg(recording.q)), recording._replace(tau=-recording.tau)):
        with pytest.raises(InputError, match=r"masses = .* q must be in rad, tau in N m"):
            identify(wrong)


@pytest.mark.parametrize("joint", range(4))
def test_a_torque_of_the_other_sign_in_one_joint_is_told(joint: int) -> None:
    recording = read_recording(EXAMPLES / f"{SAMPLE}.csv")
    tau = recording.tau.copy()
    tau[:, joint] *= -1.0
    name = f"tau{joint + 1}"
    told = rf"^{name} = explained to R² = -[12]\.\d\d: must be at least 0\.5\. Does a positive {name} turn J{joint + 1}"
    with pytest.raises(InputError, match=told):
        identify(recording._replace(tau=tau))


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (lambda head, *rows: [head, *(f"7,{row}" for row in rows)], r"csv:2: row = 7,0\.000,.*: must be 9 numbers"),
        (lambda head, *rows: [head, *(row.replace(".", ",") for row in rows)], r"csv:2: row = 0,000,.*must be 9 num"),
        (
            lambda head, *rows: [f"{head},q2", *(f"{row},1" for row in rows)],
            r"csv:1: columns = .*: must be .* once each",
        ),
    ],
)
def test_a_file_that_is_not_what_its_head_says_is_told(
    changed: Callable[..., list[str]], told: str, tmp_path: Path
) -> None:
    """Of a row with more numbers than names each column was read as another, of two `q2` the second was ignored."""
    path = tmp_path / "motion.csv"
    path.write_text("\n".join(changed(*(EXAMPLES / f"{SAMPLE}.csv").read_text().splitlines()[:40])))
    with pytest.raises(InputError, match=told):
        identify(read_recording(path))


@pytest.mark.parametrize("cutoff", [0.05, 0.2, 0.5])
def test_a_cutoff_that_leaves_too_little_to_fit_is_told_as_that(cutoff: float) -> None:
    """Joints were said to move one way only, or their friction came out at a twenty-fifth."""
    with pytest.raises(InputError, match=r"^cutoff = .* high enough to fit 100 samples .* Raise it or record"):
        identify(read_recording(EXAMPLES / f"{SAMPLE}.csv"), cutoff=cutoff)


def test_a_cutoff_of_1_hz_still_tells_friction() -> None:
    found = identify(read_recording(EXAMPLES / f"{SAMPLE}.csv"), cutoff=1.0)
    np.testing.assert_allclose(found.coulomb.value, settings().coulomb, rtol=0.05)


def test_a_gap_is_told_and_lost_samples_are_none() -> None:
    """Splined over, half a second without samples moved the masses by seven of their standard errors."""
    recording = read_recording(EXAMPLES / f"{SAMPLE}.csv")

    def without(samples: slice) -> float:
        return identify(type(recording)(*(np.delete(column, samples, axis=0) for column in recording))).mass_scale

    with pytest.raises(InputError, match=r"t = a gap of 0.504 s after 5.328 s, sample 1333: must be without gaps"):
        without(slice(1333, 1458))
    whole = identify(recording)
    assert without(slice(1333, 1340)) == pytest.approx(whole.mass_scale, abs=whole.mass_scale_error)
