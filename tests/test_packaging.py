"""What a stranger installs: pinned, hashed, from no particular host, and complete."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxmpc", "tuning", "sweeps", "deploy")
PINS = ("requirements.txt", "requirements-dev.txt", "requirements-robot.txt")


def entries(text: str) -> list[str]:
    """Each requirement with its hashes, on one line."""
    return text.replace("\\\n", " ").splitlines()


def pins(file: str) -> dict[str, set[str]]:
    """Pinned versions with their markers, by package."""
    found: dict[str, set[str]] = {}
    for entry in entries((ROOT / file).read_text()):
        requirement = Requirement(entry.partition("--hash")[0])
        found.setdefault(requirement.name, set()).add(f"{requirement.specifier} ; {requirement.marker}")
    return found


def mistakes(text: str) -> list[str]:
    """Entries that are not exactly `name==version`, perhaps a marker, and hashes: options and addresses too."""
    entry = r"[a-z0-9-]+==[\w.+!]+( ; [^:@]+?)?( +--hash=sha256:[0-9a-f]{64})+"
    return [line for line in entries(text) if not re.fullmatch(entry, line)]


@pytest.mark.parametrize("file", PINS)
def test_pins_are_exact_hashed_and_name_no_host(file: str) -> None:
    assert mistakes((ROOT / file).read_text()) == []


@pytest.mark.parametrize(
    "line",
    [
        "numpy==2.4.6",
        f"numpy>=2 --hash=sha256:{'0' * 64}",
        "--index-url host --hash=sha256:" + "0" * 64,
        f"numpy @ file:///numpy.whl --hash=sha256:{'0' * 64}",
        f"numpy==2.4.6 \\\n    --hash=md5:{'0' * 32}",
    ],
)
def test_a_wrong_pin_is_seen(line: str) -> None:
    assert mistakes(line)


@pytest.mark.parametrize("file", ["requirements.txt", "requirements-robot.txt"])
def test_pin_files_agree(file: str) -> None:
    dev = pins("requirements-dev.txt")
    assert {name: dev.get(name) for name in pins(file)} == pins(file)


def test_pins_keep_up_with_pyproject() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())
    lists = [table["project"]["dependencies"], *table["project"]["optional-dependencies"].values()]
    wanted = [Requirement(text) for texts in [*lists, table["dependency-groups"]["build"]] for text in texts]
    dev = pins("requirements-dev.txt")
    for requirement in wanted:
        if requirement.name != "jaxmpc":
            versions = [re.match(r"==(\S+)", pin)[1] for pin in dev[requirement.name]]
            assert all(requirement.specifier.contains(version) for version in versions), requirement


def test_robot_pins_hold_no_jax() -> None:
    assert pins("requirements-robot.txt").keys() >= {"numpy", "python-can", "pytest"}
    assert pins("requirements-robot.txt").keys().isdisjoint({"jax", "jaxlib", "equinox", "optax", "scipy"})


def test_wheel_holds_the_four_packages_and_nothing_else(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = [path for package in PACKAGES for path in ROOT.glob(f"{package}/**/*") if path.is_file()]
    assert held == {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}
