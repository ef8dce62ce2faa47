"""Frozen controllers of `made`, as fixtures."""

import os
import random
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.controller.freeze import freeze
from jaxmpc.law import cascade
from jaxmpc.law.gains import constant_reference
from tests.deploy import made
from tests.deploy.made import K2, LOOP, T_S, margin_row, text_gains


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """CI has run them where no more is than on the robot; what was skipped there runs beside the workstation's."""
    tested = "ROBOT_TESTED" in os.environ and collection_path.match("test_*.py")
    return True if tested and "importorskip" not in collection_path.read_text() else None


def run_law(gains, force, force_ref):
    """Commands of the law itself on floats, one axis at a time; force_ref (n, 3, H)."""
    v = np.empty(np.shape(force))
    for axis in range(3):
        state = cascade.init(gains, float(force[0][axis]))
        for k in range(len(force)):
            state, v[k, axis] = cascade.step(gains, state, float(force[k][axis]), force_ref[k][axis])
    return v


def trace(gains, n, preview, seed=1):
    """Forces, references and what the law on floats answers: (n, 3), (n, 3[, H]), (n, 3)."""
    draw = random.Random(seed)
    force = np.array([[draw.gauss(-5.0, 1.0) for _ in range(3)] for _ in range(n)])
    width = len(gains.mpc_ref) if preview else 1
    force_ref = np.array([[[draw.gauss(-5.0, 1.0) for _ in range(width)] for _ in range(3)] for _ in range(n)])
    law_gains = gains if preview else constant_reference(gains)
    v = run_law(law_gains, force, force_ref.tolist())
    return force, force_ref if preview else force_ref[..., 0], v


@pytest.fixture
def law():
    return SimpleNamespace(gains=text_gains(), trace=trace, run=run_law, row=margin_row)


@pytest.fixture
def arguments():
    """Keyword arguments of `freeze`, fresh for every test; change them to see it refuse."""
    gains = text_gains()
    return {
        "gains": gains,
        "T_s": T_S,
        "K2": K2,
        "loop": LOOP,
        "params": {"Khat_s": 900.0, "lam": 0.1, "architecture": "mpc-aob", "delta": [0.9, 0.9]},
        "margins": [margin_row(375.0), margin_row(810.0, M_s=1.4), margin_row(1900.0, M_s=1.9)],
        "floor": {"M_s": 2.0, "gain_reduction_db": 6.0},
        "golden": trace(gains, 12, preview=False),
        "provenance": {"jaxmpc": "0.1.0"},
    }


@pytest.fixture
def data(arguments, tmp_path):
    """Bytes of a frozen controller."""
    freeze(tmp_path / "good.npz", **arguments)
    return (tmp_path / "good.npz").read_bytes()


@pytest.fixture(scope="session")
def arm_artifact():
    """A controller that drives the WAM."""
    return made.arm_artifact()
