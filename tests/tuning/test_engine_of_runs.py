"""Which engine runs a job's loops: the fastest where they are only evaluated, or the one that somebody names."""

import jax
import pytest
from msgspec.structs import replace

from tuning import TuneSpec
from tuning.objective.problem import _engined


@pytest.mark.parametrize(("published", "engine"), [("table-1-wam", "kernel"), ("table-1", "scan")])
def test_the_arm_is_evaluated_in_the_kernel_where_there_is_a_gpu(
    published: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The linear loop, whose runs are differentiated in reverse, keeps the scan."""
    spec = TuneSpec.from_dict({"experiment": {"published": published}})
    assert _engined(spec, spec.experiment).engine == "scan"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert _engined(spec, spec.experiment).engine == engine


def test_who_names_the_scan_gets_it_and_the_same_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    spec = TuneSpec.from_dict({"experiment": {"published": "table-1-wam"}})
    named = replace(spec, engine="scan")
    assert _engined(named, named.experiment).engine == "scan"
    assert named.digest == spec.digest
