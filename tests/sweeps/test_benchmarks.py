"""Benchmarks begin as their help says: no long run is needed to find out that one does not."""

import sys

import numpy as np
import pytest

from benchmarks import gradient_cost, sweep_overhead, sweep_throughput
from jaxmpc import Experiment
from jaxmpc.engine.scenario import scenario_data


def test_help_measures_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["gradient_cost", "--help"])
    monkeypatch.setattr(gradient_cost, "use_all_cores", lambda: pytest.fail("it began"))
    with pytest.raises(SystemExit) as ended:
        gradient_cost.main()
    assert ended.value.code == 0
    assert "What a gradient costs" in capsys.readouterr().out


@pytest.mark.parametrize("seconds", [0.5, 2.0, sweep_overhead.SECONDS])
def test_the_last_quarter_of_an_episode_is_scored(seconds: float) -> None:
    experiment = sweep_overhead.job(16, seconds).experiment
    assert experiment.scored[1].sum(axis=0).tolist() == [round(250 * seconds)] * 3


@pytest.mark.parametrize("steps", [200, 7000, 30_000])
def test_a_peer_meets_the_same_share_of_scored_samples(steps: int) -> None:
    scene = scenario_data(Experiment.published("table-1"))
    whole, part = scene.signals.score, sweep_throughput.stretch(scene, steps).signals
    assert part.heart.shape[1] == part.score.shape[1] == min(steps, 25_000)
    np.testing.assert_allclose(np.mean(part.score[0]), np.mean(whole[0]), atol=0.51 / steps)
