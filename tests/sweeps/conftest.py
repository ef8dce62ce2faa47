"""Short sweeps, run once and shared: their programs take longer to compile than their rows to compute."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from jaxmpc.xla import blocks as xla
from sweeps import blocks, compute
from sweeps.result import Result
from sweeps.run import run
from sweeps.spec import SweepSpec
from tests.sweeps.drawn_rows import DATA, drawn_rows

SPEC = """\
[experiment]
published = "table-1"
duration = 1.0
settle = 0.3
stiffness = [375.0, 1900.0]
reference = { z = -5.0 }

[params]
published = "text"

[sweep]
kind = "grid"
decide = 0

[sweep.axes]
lam = { log = [0.001, 10.0], points = 40 }
T_cl = { log = [0.001, 0.02], points = 3 }
Hp = [3, 10]
"""
"""240 rows, of which the half with H_p = 3 < H_u = 5 is left out."""


@pytest.fixture(scope="session")
def spec_text() -> str:
    return SPEC


@pytest.fixture
def write_spec(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "spec.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture(scope="session")
def spec(tmp_path_factory: pytest.TempPathFactory) -> SweepSpec:
    path = tmp_path_factory.mktemp("spec") / "spec.toml"
    path.write_text(SPEC)
    return SweepSpec.from_toml(path)


@contextmanager
def small_blocks() -> Iterator[None]:
    """Blocks of 64 rows instead of 256: sweeps here are of some hundred rows in chunks of some dozens."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (xla, blocks, compute):
            patch.setattr(module, "BLOCK", 64)
        yield


@pytest.fixture(scope="module", autouse=True)
def in_small_blocks() -> Iterator[None]:
    """Each file here; what the session shares is made beforehand, and asks for them itself."""
    with small_blocks():
        yield


@pytest.fixture(scope="session")
def finished(spec: SweepSpec, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """The folder of the sweep, done in one go, and its result. Nobody changes the folder."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    with small_blocks():
        return folder, run(spec, folder)


@pytest.fixture(scope="session")
def drawn() -> SweepSpec:
    """The job of `drawn_rows`."""
    return SweepSpec.from_dict(DATA)


@pytest.fixture(scope="session")
def exact() -> Result:
    """Every row of `drawn_rows` in float64."""
    with small_blocks():
        return drawn_rows("float64")


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., int]:
    """`jaxmpc` in this process, from an empty folder; the number of devices is fixed already."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> int:
        from jaxmpc.cli import main

        return main([str(argument) for argument in arguments])

    return call
