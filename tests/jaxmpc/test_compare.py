"""`jaxmpc compare`: what it takes, what it finds, what it refuses."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import msgspec
import numpy as np
import pytest
from scipy import stats

from deploy.controller.file import to_bytes
from deploy.controller.frozen_gains import checked
from jaxmpc import Timing, design
from jaxmpc.cli import main
from jaxmpc.cli.compare import SEEDS, check_law, contender_from, named, seeds_of
from jaxmpc.closed_loops import Outcome
from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.files.toml import write_toml
from jaxmpc.law.gains import Gains
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.report.charts import force_charts
from jaxmpc.report.comparison import Comparison, Contender
from jaxmpc.report.side_by_side import PER_AXIS, difference, table
from jaxmpc.report.thinning import thinned
from jaxmpc.stability import Margins
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from jaxmpc.terminal.arguments import experiment_from, name_and_place, params_from
from tests.deploy import made

SHORT = """\
name = "short"
duration = 1.2
settle = 0.4
stiffness = [810.0]
[motion]
kind = "harmonics"
[sensor]
noise = 0.01
"""


@pytest.fixture
def tuned(tmp_path: Path) -> Path:
    folder = tmp_path / "first"
    folder.mkdir()
    write_toml(folder / "params.toml", {"params": Params.published("cautious").to_dict()})
    return folder


def test_the_interval_is_students() -> None:
    random = np.random.default_rng(0)
    first = random.normal(1.0, 0.1, 12)
    other = first + random.normal(0.05, 0.02, 12)
    found = difference(first, other)
    interval = stats.ttest_rel(other, first).confidence_interval(0.95)
    assert (found.mean - found.half_width, found.mean + found.half_width) == pytest.approx(tuple(interval))
    assert found.told
    assert not difference(first, first + np.resize([0.1, -0.1], 12)).told


def test_a_motion_that_one_lost_is_no_pair() -> None:
    first, other = np.array([1.0, np.nan, 2.0, 3.0]), np.array([1.5, 9.0, 2.5, np.nan])
    assert difference(first, other).mean == 0.5
    assert np.isnan(difference(first[:1], other[:1]).half_width)
    assert np.isnan(difference(first[1:2], other[1:2]).mean)


def test_what_lasted_tells_nothing_of_what_was_lost() -> None:
    """Better by far in the five motions that it held; the mean over all is not known to be."""
    first = np.array([0.060, 0.062, 0.058, 0.061, 0.059, 0.2])
    other = np.append(first[:5] - np.array([0.0100, 0.0105, 0.0095, 0.0098, 0.0102]), np.nan)
    assert difference(first[:5], other[:5]).told
    found = difference(first, other)
    assert (found.told, found.pairs, found.motions) == (False, 5, 6)


def test_a_thinned_curve_keeps_its_peaks() -> None:
    time = np.arange(25_000) * 1e-3
    force = np.sin(time)
    force[12_345], force[777] = 5.0, -4.0
    x, y = thinned(time, force)
    assert len(y) <= 700
    assert (y.max(), y.min()) == (5.0, -4.0)
    assert (np.diff(x) >= 0.0).all()
    assert thinned(time[:5], force[:5])[1] is not None


@pytest.mark.parametrize("samples", [701, 25_000, 30_000, 60_000])
def test_a_thinned_curve_keeps_its_end(samples: int) -> None:
    time, force = np.arange(float(samples)), np.zeros(samples)
    force[-1], force[-3] = 50.0, np.nan
    x, y = thinned(time, force)
    assert len(y) <= 700
    assert (x[-1], y[-1], np.nanmax(y)) == (samples - 1, 50.0, 50.0)
    assert (np.diff(x) >= 0.0).all()


def test_a_published_name_is_that_whatever_folder_lies_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("cautious", "table-1", "arm-tune"):
        (tmp_path / name).mkdir()
    assert params_from("cautious").to_dict() == Params.published("cautious").to_dict()
    assert experiment_from("table-1").to_dict() == Experiment.published("table-1").to_dict()
    Path("mine.toml").mkdir()
    with pytest.raises(InputError, match="Is a directory"):
        experiment_from("mine.toml")


def test_controllers_come_from_everywhere(tuned: Path) -> None:
    assert contender_from("text").params.to_dict() == Params.published("text").to_dict()
    folder, file = contender_from(str(tuned)), contender_from(f"mine={tuned / 'params.toml'}")
    assert (folder.name, file.name) == ("first", "mine")
    assert folder.params.to_dict() == file.params.to_dict() == Params.published("cautious").to_dict()
    assert [one.name for one in named([file, folder, file])] == ["mine (1)", "first", "mine (3)"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["txt"], "Did you mean 'text'"),
        (["text", "nowhere.toml"], "nowhere.toml"),
        (["text", "--experiment", "table"], "table-1"),
        (["text", "--seeds", "-1"], "--seeds = -1"),
        (["text", "-o", "report.pdf"], "a file ending in .html"),
        (["text", "-o", "/proc/deeper/report.html"], "a path that can be written"),
        (["text"] * 9, "at most 8"),
    ],
)
def test_wrong_arguments(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["compare", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_runs_that_are_all_the_same_have_no_interval(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight copies of one run gave each difference ± 0.0 and a star."""
    monkeypatch.chdir(tmp_path)
    Path("still.toml").write_text('[motion]\nkind = "none"\n[sensor]\nnoise = 0.0\n')
    still, noisy = experiment_from("still.toml"), experiment_from("table-1")
    assert (len(seeds_of(None, still)), len(seeds_of(0, still)), list(seeds_of(2, noisy))) == (0, 0, [1000, 1001])
    assert len(seeds_of(None, noisy)) == SEEDS
    assert main(["compare", "text", "--experiment", "still.toml", "--seeds", "2"]) == 2
    said, told = capsys.readouterr()
    assert said == ""
    assert "--seeds = 2: must be 0 where neither motion nor noise is drawn" in told


def test_a_path_with_an_equals_sign_is_a_path(tuned: Path, tmp_path: Path) -> None:
    folder = tmp_path / "T_cl=3"
    folder.mkdir()
    (folder / "params.toml").write_bytes((tuned / "params.toml").read_bytes())
    assert contender_from(f"{folder}").name == "T_cl=3"
    assert contender_from(f"mine={folder}").name == "mine"
    assert name_and_place("mine=text") == ("mine", "text")


def test_a_folder_without_a_result_and_a_file_that_is_no_controller(tmp_path: Path) -> None:
    (tmp_path / "false.npz").write_bytes(b"nothing")
    for path, bound in ((tmp_path, "one with a params.toml"), (tmp_path / "false.npz", "a frozen controller")):
        with pytest.raises(InputError, match=bound):
            contender_from(str(path))


def test_parameters_of_a_frozen_controller_that_this_version_does_not_know_are_told_with_its_file(
    tmp_path: Path,
) -> None:
    path = tmp_path / "other.npz"
    path.write_bytes(to_bytes(replace(made.arm_artifact(), params={"lamb": 1.0})))
    with pytest.raises(InputError, match=r"other.npz: lamb = 1.0: must be a known parameter"):
        contender_from(str(path))


def frozen(params: Params, gains: Gains, T_s: float) -> Contender:
    """What `contender_from` makes of a frozen controller, as far as its law goes."""
    return Contender("mine", params, "", SimpleNamespace(T_s=T_s, gains=checked(jax.tree.map(np.asarray, gains))))


def test_a_frozen_controller_that_would_be_another_one_is_refused() -> None:
    """What is compared is designed anew: one of 2 ms ran at 1 ms as what it is not, under its own name."""
    cautious, experiment = Params.published("cautious"), Experiment.published("table-1")
    gains = design(cautious)
    check_law(frozen(cautious, gains, 1e-3), experiment)
    rounded = gains._replace(K=tuple(k * (1.0 + 1e-12) for k in np.asarray(gains.K)))
    check_law(frozen(cautious, rounded, 1e-3), experiment)
    with pytest.raises(InputError, match=r"sampling time of mine = 0.002 s: must be 0.001 s, as table-1 samples"):
        check_law(frozen(cautious, design(cautious, Timing(2e-3)), 2e-3), experiment)
    with pytest.raises(InputError, match="controller mine = one of other gains"):
        check_law(frozen(cautious, design(Params.published("text")), 1e-3), experiment)
    filtered = msgspec.structs.replace(experiment, sensor=msgspec.structs.replace(experiment.sensor, kalman=1.0))
    with pytest.raises(InputError, match="with its filter of the force"):
        check_law(frozen(cautious, gains, 1e-3), filtered)


def made_up(rms: float, random: np.random.Generator) -> tuple[Outcome, Metrics]:
    """A run on two tissues, and on five drawn motions."""
    own = Metrics(*(np.full((2, 3), rms) for _ in Metrics._fields))
    drawn = Metrics(*(rms + random.normal(0.0, 1e-3, (5, 2, 3)) for _ in Metrics._fields))
    margins = Margins(*(np.full(2, 10.0 * rms) for _ in Margins._fields[:-1]), np.zeros(2, int))
    return Outcome(own, margins, np.zeros(2, int), np.full(2, np.nan), None), drawn


def test_motions_on_which_one_was_lost_are_no_pairs() -> None:
    """Contact was lost, or the force left its limit: the run has metrics all the same."""
    random = np.random.default_rng(1)
    (first, motions), (second, others) = made_up(0.1, random), made_up(0.2, random)
    experiment = msgspec.structs.replace(Experiment.published("table-1"), stiffness=(375.0, 810.0))
    contenders = [Contender(name, Params(), "made up") for name in "AB"]
    drawn = Metrics(*(np.stack(pair) for pair in zip(motions, others, strict=True)))
    statuses = np.zeros((2, 5, 2), int)
    statuses[0, 1, 1], statuses[1, 3, 1] = Status.LOST_CONTACT, Status.FORCE_LIMIT
    found = Comparison(experiment, contenders, [first, second], drawn, [None, None], seeds=range(5), statuses=statuses)
    told = {tuple(row[:2]): row[-1] for row in table(found).rows}
    held = [0, 2, 4]
    mean = 1e3 * (others.rms - motions.rms)[held, 1, 2].mean()
    assert told["RMS [mN]", "810 N/m, Z"].startswith(f"{mean:+.1f} ± ")
    assert told["RMS [mN]", "810 N/m, Z"].endswith(" (3 of 5)")
    assert told["RMS [mN]", "375 N/m, Z"].endswith(" *")
    assert told["chatter [m/s²]", "810 N/m"].endswith(" (3 of 5)")


def test_the_table_has_everything_and_the_differences() -> None:
    random = np.random.default_rng(1)
    (first, motions), (second, others) = made_up(0.1, random), made_up(0.2, random)
    experiment = msgspec.structs.replace(Experiment.published("table-1"), stiffness=(375.0, 810.0))
    contenders = [Contender(name, Params(), "made up") for name in "AB"]
    drawn = Metrics(*(np.stack(pair) for pair in zip(motions, others, strict=True)))
    ratios = np.full((2, 2, 3), 1.5)
    found = table(Comparison(experiment, contenders, [first, second], drawn, [None, None], ratios))
    assert found.head == ["", "K_s, axis", "A", "B", "B − A"]
    by_axis, worst = len(PER_AXIS) * 2 * 3, (len(METRICS) - len(PER_AXIS)) * 2
    assert len(found.rows) == by_axis + worst + len(MARGINS) * 2 + 2 * 3
    rms = next(row for row in found.rows if row[:2] == ["RMS [mN]", "810 N/m, Z"])
    apart = stats.ttest_rel(others.rms[:, 1, 2], motions.rms[:, 1, 2])
    interval = apart.confidence_interval(0.95)
    half = 0.5e3 * (interval.high - interval.low)
    middle = 1e3 * (others.rms - motions.rms)[:, 1, 2].mean()
    assert rms[2:] == ["100.0", "200.0", f"{middle:+.1f} ± {half:.1f} *"]
    M_s = next(row for row in found.rows if row[0] == "M_s")
    assert M_s[2:] == ["1.00", "2.00", "+1.00"]


@pytest.mark.parametrize(
    ("own", "on_drawn", "rows"), [(0.0, 0.01, 2), (np.nan, 0.01, 2), (0.0, 0.0, 0), (0.01, 0.0, 2)]
)
def test_what_happens_on_drawn_motions_alone_has_its_rows(own: float, on_drawn: float, rows: int) -> None:
    """Whose samples were clamped there, and not on the experiment itself, had none, and no difference."""
    random = np.random.default_rng(1)
    (first, motions), (second, others) = made_up(0.1, random), made_up(0.2, random)
    experiment = msgspec.structs.replace(Experiment.published("table-1"), stiffness=(375.0, 810.0))
    contenders = [Contender(name, Params(), "made up") for name in "AB"]
    drawn = Metrics(*(np.stack(pair) for pair in zip(motions, others, strict=True)))
    drawn = drawn._replace(clamped=np.stack([0.0 * motions.clamped, np.full_like(others.clamped, on_drawn)]))
    outcomes = [
        one._replace(metrics=one.metrics._replace(clamped=np.full((2, 3), value)))
        for one, value in ((first, min(own, 0.0)), (second, own))
    ]
    found = table(Comparison(experiment, contenders, outcomes, drawn, [None, None]))
    clamped = [row for row in found.rows if row[0] == METRICS["clamped"].heading]
    assert len(clamped) == rows
    assert all("+" in row[-1] for row in clamped if on_drawn)


def test_who_is_lost_on_a_drawn_motion_is_told() -> None:
    random = np.random.default_rng(1)
    (first, motions), (second, others) = made_up(0.1, random), made_up(0.2, random)
    for field in others:
        field[3:, 1] = np.nan
    statuses = np.zeros((2, 5, 2), int)
    statuses[1, 3:, 1] = Status.DIVERGED, Status.FORCE_LIMIT
    experiment = msgspec.structs.replace(Experiment.published("table-1"), stiffness=(375.0, 810.0))
    contenders = [Contender(name, Params(), "made up") for name in "AB"]
    drawn = Metrics(*(np.stack(pair) for pair in zip(motions, others, strict=True)))
    both = Comparison(
        experiment, contenders, [first, second], drawn, [None, None], seeds=range(1000, 1005), statuses=statuses
    )
    told = sorted(both.failures())
    assert [line.split(":")[:2] for line in told] == [
        ["B, 810 N/m, 1 of 5 drawn, first seed 1003", " DIVERGED"],
        ["B, 810 N/m, 1 of 5 drawn, first seed 1004", " FORCE_LIMIT"],
    ]
    rows = {row[1]: row[-1] for row in table(both).rows if row[0] == "RMS [mN]"}
    assert rows["810 N/m, Z"].endswith(" (3 of 5)")
    assert rows["375 N/m, Z"].endswith(" *")


def test_a_folder_in_the_reports_place_is_seen_before_anything_is_computed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "compare.html").mkdir()
    assert main(["compare", "text", "-o", str(tmp_path / "compare.html")]) == 2
    said, told = capsys.readouterr()
    assert said == ""
    assert "A folder or a device is in its place" in told


def test_a_force_that_leaves_the_frame_leaves_the_others_theirs() -> None:
    time = np.arange(6) * 1e-3
    calm, wild = np.full((1, 3, 6), 0.01), np.full((1, 3, 6), 0.01)
    wild[0, 1, 3] = -21.0
    charts = force_charts(time, [810.0], [("calm", calm), ("wild", wild)], np.zeros((6, 3)))
    assert [[one.name for one in chart.series] for chart in charts] == [
        ["calm", "wild"],
        ["calm", "wild (beyond 20 N, not drawn)"],
        ["calm", "wild"],
    ]
    np.testing.assert_allclose(charts[1].series[0].y, 10.0)
    assert np.isnan(charts[1].series[1].y).all()


@pytest.mark.slow
def test_a_comparison(tuned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    report = tmp_path / "out" / "compare.html"
    arguments = ["text", str(tuned), "--experiment", str(tmp_path / "short.toml"), "--seeds", "3", "-o", str(report)]
    assert main(["compare", *arguments]) == 0
    said = capsys.readouterr().out
    lines = [line for line in said.splitlines() if line.strip().startswith("RMS [mN]")]
    assert len(lines) == 3
    # Of 97 and 30 mN on Table I the difference is many times its interval.
    assert all("±" in line and line.rstrip().endswith("*") for line in lines)
    page = report.read_text(encoding="utf-8")
    assert page.count('class="chart"') == 3 + 5 + 6
    assert "first − text" in page
