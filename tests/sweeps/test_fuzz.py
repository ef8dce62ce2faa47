"""Malformed specs: exit code 2, one sentence with a place and a remedy, nothing written."""

import copy
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from jaxmpc.files.errors import InputError
from sweeps.spec import SweepSpec

GOOD: dict[str, Any] = {
    "experiment": {
        "published": "table-1-wam",
        "duration": 1.0,
        "settle": 0.3,
        "stiffness": [375.0, 1900.0],
        "reference": {"z": -5.0},
    },
    "params": {"published": "text", "Q_p": 0.5},
    "sweep": {
        "kind": "grid",
        "precision": "float32",
        "best": "rms",
        "on_error": "keep",
        "columns": ["rms", "M_s"],
        "constraints": {"M_s": 2.0},
        "axes": {
            "lam": {"log": [0.001, 10.0], "points": 40},
            "Hp": [5, 10],
            "arm.coulomb": {"linear": [0.5, 2.0], "points": 3, "relative": True},
            "stiffness": ["paper", "paper-like"],
        },
        "stiffness_sets": {"paper-like": [300.0, 800.0, 2000.0]},
        "zip": [{"T_cl": [0.001, 0.002], "K2": [5.0, 10.0]}],
    },
    "refine": {"method": "halving", "stages": [{"keep": 20, "experiment": {"duration": 0.5}}]},
}
# No value of these kinds is right anywhere in the spec above.
WRONG: tuple[Any, ...] = (float("nan"), float("inf"), -1e300, [[[]]], {"nobody": {"knows": 1}}, "\x00nonsense", 10**30)


def places(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every key and entry of the spec."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [found for key, value in items for found in ((*path, key), *places(value, (*path, key)))]


def at(data: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        data = data[key]
    return data


def broken(seed: int) -> dict[str, Any]:
    """The spec with one mistake: an unknown key, or a value that is nowhere right."""
    chosen = random.Random(seed)
    data = copy.deepcopy(GOOD)
    path = chosen.choice(places(data))
    parent, key = at(data, path[:-1]), path[-1]
    if isinstance(parent, dict) and chosen.random() < 0.4:
        parent[f"{key}x"] = parent.pop(key)
    else:
        parent[key] = chosen.choice(WRONG)
    return data


def test_the_spec_itself_is_right() -> None:
    assert SweepSpec.from_dict(copy.deepcopy(GOOD)).space.count == 2 * 40 * 2 * 3 * 2


@pytest.mark.parametrize("seed", range(120))
def test_a_mistake_is_named_and_nothing_is_written(
    seed: int, command: Callable[..., int], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "spec.toml"
    path.write_text(tomli_w.dumps(broken(seed)), encoding="utf-8")
    code = command("sweep", path, "-o", "out")
    said = capsys.readouterr().err
    assert code == 2, path.read_text()
    assert said.count("\n") == 1
    assert "spec.toml" in said
    assert "must be" in said
    assert said.rstrip().endswith((".", "?", "…"))
    assert [entry.name for entry in tmp_path.iterdir()] == ["spec.toml"]


def test_text_that_is_no_toml_is_refused(command: Callable[..., int], tmp_path: Path) -> None:
    for number, content in enumerate((b"\xff\xfe[sweep]", b"[sweep", b"", b"sweep = 3", b"[sweep]\nkind = grid")):
        path = tmp_path / f"{number}.toml"
        path.write_bytes(content)
        assert command("sweep", path) == 2


def test_an_input_error_is_what_library_users_get() -> None:
    with pytest.raises(InputError):
        SweepSpec.from_dict(broken(3))
