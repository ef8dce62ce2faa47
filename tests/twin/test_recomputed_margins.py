"""Margins that the robot computes from the gains alone, against those of the design."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.controller.recomputed_margins import _contact, _cut, _margins, differences, margins_at
from jaxmpc import Experiment, Params, margins
from jaxmpc.export.freezing import _rows, freeze_controller
from jaxmpc.quantities import MARGINS
from tests.deploy import made


@pytest.fixture(scope="module")
def frozen(tmp_path_factory):
    """An artifact by parameters, experiment and whether the damping is ideal."""

    def freeze(params, experiment="table-1-wam", ideal=False, **changes):
        path = tmp_path_factory.mktemp("frozen") / "controller.npz"
        chosen = replace(Params.published(params), **changes) if changes else Params.published(params)
        return freeze_controller(path, chosen, Experiment.published(experiment), {"M_s": 50.0}, ideal=ideal)

    return freeze


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("params", "experiment", "ideal", "delay"),
    [
        ("cautious", "table-1-wam", False, 1),
        ("text", "table-1-wam", False, 1),
        ("text", "table-1", True, 1),
        ("cautious", "table-1", False, 1),
        ("cautious", "table-1", False, 2),
    ],
)
def test_they_are_those_of_the_design(frozen, params, experiment, ideal, delay):
    artifact = frozen(params, experiment, ideal, designed_delay=delay)
    assert differences(artifact) == []
    for row in artifact.margins[:: max(1, len(artifact.margins) // 6)]:
        again = margins_at(artifact, row["stiffness"])
        for key in set(MARGINS) - {"delay_margin_s"}:
            assert again[key] == pytest.approx(row[key], rel=1e-4), (key, row["stiffness"])


@pytest.mark.oracle
def test_so_are_those_of_a_slow_observer(frozen):
    """Its answer crosses the real axis at 4e-4 rad and below."""
    artifact = frozen("text", "table-1", Q_p=1e-11)
    assert all(20.0 < row["gain_reduction_db"] < 80.0 for row in artifact.margins)
    assert differences(artifact) == []


@pytest.mark.oracle
def test_on_any_stiffness_they_are_those_of_the_public_function(frozen):
    artifact = frozen("text")
    for stiffness in np.geomspace(60.0, 9000.0, 12).tolist():
        design, again = margins(Params.published("text"), stiffness), margins_at(artifact, stiffness)
        assert again["spectral_radius"] == pytest.approx(float(design.spectral_radius), rel=1e-6)
        assert again["M_s"] == pytest.approx(float(design.M_s), rel=1e-3)


def test_a_second_sample_of_delay_is_a_pure_one():
    """Where all that acts on the tip is cut, L has another z⁻¹; both cuts count, the worse of them."""
    artifact = made.arm_artifact()
    late = replace(artifact, loop=artifact.loop._replace(delay=2))
    theta = np.geomspace(1e-4, 3.0, 50)
    one, two = (_cut(each.flown_gains, _contact(each, 810.0), at_a=True).response(theta) for each in (artifact, late))
    assert two == pytest.approx(one * np.exp(-1j * theta), rel=1e-9)
    assert margins_at(late, 810.0)["delay_margin_s"] < margins_at(artifact, 810.0)["delay_margin_s"] - 0.5e-3
    cuts = [_margins(_cut(artifact.flown_gains, _contact(artifact, 810.0), at_a), 1e-3) for at_a in (False, True)]
    both = margins_at(artifact, 810.0)
    assert both["M_s"] == max(cut["M_s"] for cut in cuts)
    assert both["delay_margin_s"] == min(cut["delay_margin_s"] for cut in cuts)
    assert cuts[0] != cuts[1]


def test_a_tissue_alone_is_judged_once():
    """Between 810 and 810 there is nothing, whatever a geometric series rounds to."""
    experiment = Experiment.from_dict({"stiffness": [810.0]})
    rows = _rows(Params.published("cautious"), experiment, experiment.loop_path())
    assert [row["stiffness"] for row in rows] == [810.0]


@pytest.mark.oracle
def test_a_frozen_controller_has_the_margins_that_it_declares(cautious):
    assert differences(cautious) == []
    worse = [row | {"M_s": row["M_s"] - 0.05} for row in cautious.margins]
    assert len(differences(replace(cautious, margins=worse))) == len(worse)
