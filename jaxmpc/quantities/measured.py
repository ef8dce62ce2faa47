"""What a run measures, and how far a loop is from instability."""

import math
from collections.abc import Mapping

from jaxmpc.quantities.row import Metric, Quantity, table

METRICS = table(
    Metric(
        "rms", "N", "residual force, root mean square", "RMS", "ceiling", "RMS", "mN", 1e3, 1, True, float32_error=0.01
    ),
    # 5.7 to 6.6 times the RMS on Table I's arm.
    Metric("peak_to_peak", "N", "residual force, peak to peak", "pp", "ceiling", "pp", "mN", 1e3, 1, crest=6.0),
    Metric(
        "true_rms",
        "N",
        "true residual, root mean square",
        "true RMS",
        head="true RMS",
        shown_unit="mN",
        times=1e3,
        digits=1,
        spectral=True,
        float32_error=0.01,
    ),
    Metric(
        *("true_peak_to_peak", "N", "true residual, largest span", "true pp", "ceiling", "true pp", "mN", 1e3, 1),
        crest=6.0,
        follows="true_rms",
    ),
    Metric(
        "effort", "m/s²", "acceleration asked of the robot, root mean square", "$a$", spectral=True, float32_error=0.05
    ),
    Metric(
        "chatter",
        "m/s²",
        "its change from sample to sample, root mean square",
        r"$\Delta a$",
        spectral=True,
        float32_error=0.05,
    ),
    Metric("peak_force", "N", "largest force over the whole run", "$|y|$", head="peak force", float32_error=0.05),
    Metric("peak_error", "N", "largest residual force", "$|e|$", "ceiling", "peak error", "mN", 1e3, 1, crest=3.0),
    Metric(
        *("clamped", "-", "share of samples at which a torque limit acted", "clamped", "ceiling", "clamped", "%"),
        times=100.0,
        limits=(0.0, 1.0),
        follows="chatter",
        arm_only=True,
        float32_error=1.0,
    ),
    Metric(
        *("joint_torque", "N m", "largest torque wanted of a joint", r"$|\tau|$"),
        head="joint torque",
        follows="chatter",
        arm_only=True,
    ),
    Metric(
        *("torque_step", "N m", "largest change of it per sample", r"$|\Delta\tau|$"),
        head="torque step",
        follows="chatter",
        arm_only=True,
        float32_error=0.4,
    ),
    Metric(
        *("swing", "N", "true force above 12 Hz", "swing", "ceiling", "swing", "mN", 1e3, 1, True),
        float32_error=0.05,
    ),
)
"""Fields of `jaxmpc.metrics.Metrics`."""

MARGINS = table(
    Quantity("M_s", "-", "peak sensitivity", "$M_s$", limits=(1.0, math.inf)),
    Quantity("gain_margin_db", "dB", "gain increase to instability", "GM", "floor", "GM"),
    Quantity("gain_reduction_db", "dB", "gain decrease to instability", "GR", "floor", "GR"),
    Quantity("phase_margin_deg", "deg", "smallest lag to instability", "PM", "floor", "PM", "°", limits=(0.0, 180.0)),
    Quantity("delay_margin_s", "s", "smallest added delay to instability", "DM", "floor", "DM", "ms", 1e3),
    Quantity(
        *("spectral_radius", "-", "largest eigenvalue of the closed loop", r"$\rho$"),
        head="radius",
        digits=4,
        limits=(0.0, 1.0),
    ),
)
"""Fields of `jaxmpc.stability.Margins`, but for the status."""
FLOOR_FLAGS: Mapping[str, str] = {
    "M_s": "--max-ms",
    "gain_margin_db": "--min-gain-db",
    "gain_reduction_db": "--min-reduction-db",
    "phase_margin_deg": "--min-phase-deg",
    "delay_margin_s": "--min-delay-ms",
    "spectral_radius": "--max-radius",
}
"""Flags of `jaxmpc freeze` for the margins that a controller may promise, in the units of tables."""
HIGHEST_M_S = 2.0
"""Held by the tuner and promised by a frozen controller unless told otherwise [-]."""
