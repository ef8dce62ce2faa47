"""A frozen controller with the paper's text gains (K̂_s = 900 N/m), made without any simulator."""

import math
import random
from types import SimpleNamespace

import numpy as np
import pytest

from jaxmpc.law import cascade

K_HAT, K2, T_S = 900.0, 10.0, 1e-3


def text_gains() -> cascade.Gains:
    decay = (1.0 - math.exp(-K2 * T_S)) / K2
    # 30 weights that differ, so that a wrong order of the preview shows, and 34 beyond the horizon
    shape = [1.0 + 0.1 * i for i in range(30)]
    mpc_ref = [1.98311185836792 * w / sum(shape) for w in shape] + [0.0] * 34
    L = (89.72993333, 0.66057566, 0.55698721)
    return cascade.Gains(
        phi=(0.000995016625083195, 0.9900498337491681),
        gamma=(K_HAT * (T_S - decay) / K2, K_HAT * decay),
        K=(0.14991379, 12.16723884, 0.6519533, 0.6519533),
        L=L,
        input_gain=L[0],
        mpc_ref=tuple(mpc_ref),
        mpc_x=(1.40035089, 0.00208595),
        mpc_u=0.58276126,
    )


def run_law(gains, force, force_ref):
    """Commands of the law itself on floats, one axis at a time; force_ref (n, 3, H)."""
    v = np.empty(np.shape(force))
    for axis in range(3):
        state = cascade.init(float(force[0][axis]), cascade.order(gains))
        for k in range(len(force)):
            state, v[k, axis] = cascade.step(gains, state, float(force[k][axis]), force_ref[k][axis])
    return v


def trace(gains, n, preview, seed=1):
    """Forces, references and what the law on floats answers: (n, 3), (n, 3[, H]), (n, 3)."""
    draw = random.Random(seed)
    force = np.array([[draw.gauss(-5.0, 1.0) for _ in range(3)] for _ in range(n)])
    width = len(gains.mpc_ref) if preview else 1
    force_ref = np.array([[[draw.gauss(-5.0, 1.0) for _ in range(width)] for _ in range(3)] for _ in range(n)])
    law_gains = gains if preview else cascade.constant_reference(gains)
    v = run_law(law_gains, force, force_ref.tolist())
    return force, force_ref if preview else force_ref[..., 0], v


def margin_row(stiffness, **changes):
    row = {
        "stiffness": stiffness,
        "delay": 1,
        "ideal": False,
        "M_s": 1.6,
        "gain_margin_db": 8.0,
        "gain_reduction_db": math.inf,
        "phase_margin_deg": 40.0,
        "delay_margin_s": 2e-3,
        "spectral_radius": 0.98,
    }
    return row | changes


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
        "params": {"Khat_s": 900.0, "lam": 0.1, "architecture": "mpc-aob", "delta": [0.9, 0.9]},
        "margins": [margin_row(375.0), margin_row(810.0, M_s=1.4), margin_row(1900.0, M_s=1.9)],
        "floor": {"M_s": 2.0, "gain_reduction_db": 6.0},
        "golden": trace(gains, 12, preview=False),
        "provenance": {"jaxmpc": "0.1.0"},
    }
