"""What processes make comes whole, in its order, and leaves nothing behind: by shared memory, or by a pipe."""

import os

import numpy as np
import pytest

from tuning.trials import makers
from tuning.trials.makers import made_by_processes
from tuning.trials.program import Met


def block(first):
    heart, between, noise, own = (first + np.arange(24.0).reshape(shape) for shape in ((2, 12), (2, 3, 4), (4, 6), 24))
    return Met(heart.T, between, noise, own)


def the_same(found, wanted):
    return all(np.array_equal(one, other) for one, other in zip(found, wanted, strict=True))


@pytest.mark.parametrize("shared", [True, False])
def test_blocks_come_whole_and_in_order(tmp_path, monkeypatch, shared):
    monkeypatch.setattr(makers, "MEMORY", tmp_path if shared else tmp_path / "none")
    firsts = [720 * i for i in range(9)]
    found = list(made_by_processes(block, firsts))
    assert [the_same(each, block(first)) for each, first in zip(found, firsts, strict=True)] == [True] * 9
    assert [isinstance(each.heart.base, np.memmap) for each in found] == [shared] * 9
    assert list(tmp_path.iterdir()) == []


def test_where_no_memory_is_left_the_pipe_has_to_do(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    assert the_same(makers._handed_over(block, tmp_path, 720), block(720))
    assert list(tmp_path.iterdir()) == []


def test_what_fails_in_a_process_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(makers, "MEMORY", tmp_path)
    with pytest.raises(ZeroDivisionError):
        list(made_by_processes(failing, [0, 1]))
    assert list(tmp_path.iterdir()) == []


def failing(first):
    raise ZeroDivisionError(first)
