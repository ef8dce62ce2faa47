"""Benchmarks begin as their help says: no long run is needed to find out that one does not."""

import sys

import pytest

from benchmarks import gradient_cost, sweep_overhead


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
