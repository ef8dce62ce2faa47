"""A mistake in a TOML file is told with the line and the key where it stands."""

from pathlib import Path

import pytest

from jaxmpc.files.errors import InputError
from sweeps import SweepSpec

SPEC = """\
[experiment]
published = "table-1"
duration = 25.0

[sweep]
kind = "grid"

[sweep.axes]
lam = [0.1, 0.2]
"""


@pytest.mark.parametrize(
    ("added", "line", "key"),
    [
        # The experiment's own duration, on line 3, is right.
        ('[refine]\nmethod = "halving"\n[[refine.stages]]\nkeep = 5\nexperiment = { duration = -1.0 }', 14, "duration"),
        ("[refine.rerun]\nexperiment = { duration = -1.0 }", 11, "duration"),
        ("[refine.rerun.experiment]\nduration = -1.0", 11, "duration"),
        ('[sweep.constraints]\nM_s = 1.8\nrms = "small"', 12, "sweep.constraints.rms"),
        ('[sweep.stiffness_sets]\nsoft = [200.0]\nstiff = [1500.0, "x"]', 12, "sweep.stiffness_sets.stiff[1]"),
    ],
)
def test_a_mistake_is_placed(tmp_path: Path, added: str, line: int, key: str) -> None:
    (tmp_path / "spec.toml").write_text(SPEC + added + "\n")
    with pytest.raises(InputError) as told:
        SweepSpec.from_toml(tmp_path / "spec.toml")
    assert f"spec.toml:{line}: " in f"{told.value}"
    assert key in told.value.key
    assert "[...]" not in told.value.key


def test_a_value_under_a_name_that_the_user_chose_is_shown(tmp_path: Path) -> None:
    (tmp_path / "spec.toml").write_text(SPEC + '[sweep.constraints]\nrms = "small"\n')
    with pytest.raises(InputError) as told:
        SweepSpec.from_toml(tmp_path / "spec.toml")
    assert told.value.value == "small"
