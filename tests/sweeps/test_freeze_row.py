"""`jaxmpc freeze DIR --row N`: a row of a sweep becomes the controller that it was, judged where it was judged."""

from pathlib import Path

import numpy as np
import pytest

from deploy.controller.file import load
from jaxmpc import margins
from jaxmpc.cli import main
from jaxmpc.files.sealed import digest
from jaxmpc.synthesis.params import Params
from sweeps.result import Result

Finished = tuple[Path, Result]


@pytest.mark.oracle
def test_a_row_is_frozen_as_it_was_swept(finished: Finished, tmp_path: Path) -> None:
    folder, result = finished
    place = int(np.flatnonzero(result.ok & (result.worst("M_s") < 6.0))[0])
    row, path = int(result["row"][place]), tmp_path / "c.npz"
    assert main(["freeze", str(folder), "--row", str(row), "-o", str(path), "--max-ms", "6"]) == 0
    artifact, met = load(path), result.experiment(place)
    assert Params.from_dict(artifact.params).to_dict() == result.controller(place).to_dict()
    assert artifact.provenance["experiment_sha256"] == digest(met.to_dict())
    by_tissue = {each["stiffness"]: each["M_s"] for each in artifact.margins}
    # As it runs, which no loop with the ideal damping of this experiment does.
    runs = margins(result.controller(place), list(met.stiffness), path=met.loop_path(ideal=False))
    np.testing.assert_allclose([by_tissue[K] for K in met.stiffness], runs.M_s, rtol=1e-9)


def test_what_is_no_row_is_refused(finished: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, path = str(finished[0]), tmp_path / "c.npz"
    spaced = tmp_path / "my sweep"
    spaced.symlink_to(folder)
    for words, told in (
        ([folder], ["--row", "missing", f"jaxmpc sweep best {folder}"]),
        ([str(spaced)], [f"jaxmpc sweep best '{spaced}'"]),
        ([folder, "--row", "999999"], ["row", "999999"]),
        (["text", "--row", "1"], ["--row", "folder of a sweep"]),
        ([str(tmp_path)], ["tuning folder", "params.toml"]),
    ):
        assert main(["freeze", *words, "-o", str(path)]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert all(word in said for word in told), said
    assert not path.exists()
