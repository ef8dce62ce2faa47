import math
import random
import statistics

import pytest

from deploy.loop.statistics import Histogram, Statistics

MS = 1_000_000


def test_histogram_against_the_standard_library():
    draw = random.Random(3)
    times = [int(draw.lognormvariate(4.0, 0.7) * 1000) for _ in range(5000)]
    histogram = Histogram()
    for ns in times:
        histogram.add(ns)
    us = [ns / 1e3 for ns in times]
    assert histogram.least == min(us)
    assert histogram.most == max(us)
    assert histogram.mean == pytest.approx(statistics.fmean(us), rel=1e-12)
    assert histogram.stdev == pytest.approx(statistics.pstdev(us), rel=1e-9)
    ordered = sorted(us)
    for share in (0.5, 0.99):
        exact = ordered[math.ceil(share * len(us)) - 1]
        assert exact <= histogram.quantile(share) <= exact + 1.0  # a bin is 1 µs wide


def test_histogram_of_nothing_of_zero_and_of_what_is_beyond():
    histogram = Histogram()
    assert histogram.rows() == []
    assert "-" in histogram.summary()
    histogram.add(0)
    assert histogram.quantile(0.99) == 0.0
    histogram.add(9_000_000)
    assert histogram.quantile(0.99) == 9000.0
    assert "over 5000" in histogram.rows()[-1]
    assert len(histogram.bins) == 5001


def test_counters_do_not_grow():
    counted = Statistics(MS)
    before = len(counted.periods.bins), len(counted._recent)
    deadline = 0
    for _ in range(1000):
        deadline, _ = counted.cycle(deadline, deadline + 1000, deadline + 5 * MS)
        counted.tally("clamps", f"reason {deadline}")
    assert (len(counted.periods.bins), len(counted._recent)) == before
    assert len(counted.counts["clamps"]) == 33
    assert sum(counted.counts["clamps"].values()) == 1000


def test_a_single_overrun_is_counted_and_never_made_up_for():
    counted = Statistics(MS)
    deadline, late = counted.cycle(0, 10_000, 3 * MS + 1)
    assert (deadline, late) == (4 * MS, False)
    assert (counted.overruns, counted.missed) == (1, 3)
    deadline, late = counted.cycle(deadline, deadline, deadline + 500_000)
    assert (deadline, late) == (5 * MS, False)
    assert counted.overruns == 1


@pytest.mark.parametrize(("gap", "late"), [(400 * MS, True), (499 * MS, True), (501 * MS, False), (2000 * MS, False)])
def test_three_overruns_within_a_second_are_late(gap, late):
    counted = Statistics(MS)
    for i in range(3):
        _, found = counted.cycle(i * gap, i * gap, i * gap + MS)
        assert found == (late and i == 2)


def test_the_first_overruns_of_a_young_clock_are_not_late():
    counted = Statistics(MS)
    assert not counted.cycle(0, 0, 2 * MS)[1]
    assert not counted.cycle(3 * MS, 3 * MS, 5 * MS)[1]
    assert counted.cycle(6 * MS, 6 * MS, 8 * MS)[1]


def test_report():
    counted = Statistics(MS)
    assert "0 cycles" in counted.report()
    deadline = 7 * MS
    for lateness in (3_000, 30_000, 3_000):
        deadline, _ = counted.cycle(deadline, deadline + lateness, deadline + lateness + 80_000)
    counted.tally("clamps", "torque rate")
    counted.tally("clamps", "torque rate")
    counted.tally("clamps", "J2/J3 motors")
    counted.tally("bus", "foreign")
    lines = counted.report().splitlines()
    assert lines[0] == "3 cycles of 1000 µs wanted, 1000.00 Hz achieved"
    compute = next(line for line in lines if line.startswith("compute"))
    assert compute.split() == ["compute", "80.0", "80.0", "80.0", "0.0", "80.0", "80.0"]
    assert "clamps torque rate 2, J2/J3 motors 1" in lines
    assert "bus foreign 1" in lines
    assert [line.split()[:4] for line in lines[-4:-1:3]] == [["2", "to", "5", "2"]]
    assert lines[-1].split()[:4] == ["20", "to", "50", "1"]
