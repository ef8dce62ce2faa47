"""Reports made of random numbers, as large as asked for."""

import numpy as np

from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS
from jaxmpc.report.content import Candidates, Chart, Detail, Mark, Report, Section, Series, Swept, Table, measure
from jaxmpc.report.influence import influence

FOREIGN = "</script><img src=x onerror=alert(1)>\"'&amp;"
"""Nobody's name, but anybody may write a file that has it."""
HASH = "cdf83348" * 8
"""As long as a sweep's, and no place to break it."""
SWEPT = ("lam", "T_cl", "K2", "Q_p", "Hp")
SHOWN = ("rms", "true_rms", "peak_to_peak", "effort", "chatter", "clamped")
TISSUES = (375.0, 810.0, 1900.0)


def candidates(count: int, seed: int = 0) -> Candidates:
    """Rows of a made-up sweep whose residual falls and whose M_s grows with speed; a tenth is unstable."""
    random = np.random.default_rng(seed)
    values = {
        "lam": np.exp(random.uniform(-6.0, 2.0, count)),
        "T_cl": np.exp(random.uniform(-7.0, -4.0, count)),
        "K2": random.uniform(5.0, 100.0, count),
        "Q_p": np.exp(random.uniform(-3.0, 3.0, count)),
        "Hp": random.integers(5, 40, count).astype(float),
    }
    fast = -0.5 * np.log(values["T_cl"] / 0.01) - 0.2 * np.log(values["lam"])
    noise = random.normal(0.0, 0.1, (count, 3))
    stiff = np.array([0.0, 0.2, 0.4])
    M_s = 1.2 + np.exp(0.8 * (fast[:, None] + stiff - 1.5) + noise)
    status = np.where(M_s > 12.0, 1, np.where(random.random((count, 3)) < 0.02, 2, 0)).astype(np.uint8)
    M_s = np.where(status == 1, np.inf, M_s)
    rms = np.where(status > 0, np.nan, 0.02 + 0.08 * np.exp(-fast[:, None] + noise))
    margins = {
        name: np.where(status == 1, np.nan, 10.0 * random.random((count, 3)) + 20.0 / np.where(status == 1, 1.0, M_s))
        for name in MARGINS
        if name != "M_s"
    }
    measures = [measure(PARAMETERS[name], values[name]) for name in SWEPT]
    for k, name in enumerate(SHOWN):
        measures.append(
            measure(METRICS[name], (rms * (1.0 + 0.3 * k) * np.exp(noise[:, ::-1]))[..., None] * [0.8, 0.9, 1])
        )
    measures += [measure(MARGINS["M_s"], M_s, limit=2.0)]
    measures += [measure(MARGINS[name], found) for name, found in margins.items()]
    goals = ("rms", "M_s", "chatter")
    time = np.linspace(0.0, 2.0, 300)
    chart = Chart(
        "force after a step",
        "time [s]",
        "force [N]",
        [Series(FOREIGN, time, 1.0 - np.exp(-5.0 * time)), Series("dashed", time, np.sin(9.0 * time), 1, "dash")],
        [Mark("limit", y=1.2)],
    )
    return Candidates(
        names=[f"row {3 * k}" for k in range(count)],
        measures=measures,
        status=status,
        tissues=[f"{K_s:g} N/m" for K_s in TISSUES],
        goals=goals,
        toml=["# ", Swept("row"), "\n[params]\nlam = ", *_pieces()],
        details={k: Detail([chart, chart]) for k in range(min(3, count))},
        note="the first three rows, their step.",
        influence=influence(measures[:5], [each for each in measures if each.role in ("metric", "margin")]),
    )


def _pieces() -> list[str | Swept]:
    pieces: list[str | Swept] = [Swept("lam")]
    for name in SWEPT[1:]:
        pieces += [f"\n{name} = ", Swept(name)]
    return [*pieces, "\nKhat_s = 900.0\n"]


def report(count: int, seed: int = 0) -> Report:
    """The rows, and a section whose every text is hostile."""
    frequency = np.geomspace(0.1, 500.0, 200)
    loop = 10.0 / (1j * frequency) / (1.0 + 0.01j * frequency)
    charts = [
        Chart("|S|", "f [Hz]", "|S|", [Series("A", frequency, np.abs(1.0 / (1.0 + loop)))], x_log=True, y_log=True),
        Chart(
            "Nyquist", "Re L", "Im L", [Series("A", loop.real, loop.imag)], [Mark("-1", -1.0, 0.0)],
            x_range=(-3.0, 1.0), y_range=(-2.0, 2.0), square=True,
        ),
        Chart("bars", "", "mN", [Series(n, [], [3.0, 4.0], k, "bars") for k, n in enumerate("ab")], categories="xy"),
    ]  # fmt: skip
    section = Section(f"Loops {FOREIGN}", [FOREIGN], [Table(["a", FOREIGN], [[FOREIGN, "1"]], FOREIGN)], charts)
    lead = [f"Made up of {count} rows.", f"hash {HASH}"]
    return Report(f"Sweep {FOREIGN}", lead, candidates(count, seed), [section])
