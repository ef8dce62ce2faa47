"""A frozen controller: gains, the loop it was judged in, margins and floor, golden trace, the arm that it drives."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from deploy.controller import frozen_gains, judged_loop, margin_floor
from deploy.controller.arm_model import KNOWN, ArmModel
from deploy.controller.checks import AGAIN, array, plain
from deploy.controller.judged_loop import JudgedLoop
from deploy.controller.known_tissue import SAMPLES, beliefs
from deploy.controller.least_rate import CAPPED, IPNM_RANGE, check_rates
from deploy.controller.limits import REACH
from jaxmpc.files.errors import InputError
from jaxmpc.law.gains import Gains, constant_reference
from jaxmpc.law.momentum_observer import fastest

KINDS = ("linear", "wam")
"""The three cascades alone, which only replay; and all that drives an arm."""


@dataclass(frozen=True, eq=False)
class Artifact:
    """A frozen controller; whatever exists is stable, above its floor and well formed.

    Attributes:
        gains: Gains of the law, filter of the measured force included, floats and tuples of floats. A guard takes an
            arm: it watches all axes together, so the cascades alone are refused with one rather than replayed
            without it.
        T_s: Sampling time [s].
        K2: Damping of the tip velocity, subtracted from v outside the law [1/s].
        preview: Whether the runtime takes the future reference along H_p, or a constant.
        loop: Delay and filters that it was judged with and flies with.
        params: Parameters that it was designed from.
        margins: One row per stiffness [N/m]; see `deploy.controller.margin_floor`.
        floor: Most M_s [-] and least other margins that it promises in every row.
        provenance: Who, what and which versions made it.
        golden_force: Measured force of the trace (n, 3) [N]; it begins with a reset to its first row.
        golden_force_ref: Wanted force (n, 3) [N], with preview (n, 3, H).
        golden_v: Command of the JAX law (n, 3) [m/s²].
        arm: What it takes to drive an arm; None only replays.
        family: Of a controller with a schedule: the `band` of K_s/K̂ that its margins hold over, and `rows`, one per
            known stiffness K̂ with the worst margins over the band. None without one.

    Raises:
        InputError: A value is missing, malformed, out of range, unstable or below the floor.
    """

    gains: Gains
    T_s: float
    K2: float
    preview: bool
    loop: JudgedLoop
    params: dict[str, Any]
    margins: list[dict[str, Any]]
    floor: dict[str, float]
    provenance: dict[str, Any]
    golden_force: np.ndarray
    golden_force_ref: np.ndarray
    golden_v: np.ndarray
    arm: ArmModel | None = None
    family: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        gains = frozen_gains.checked(self.gains)
        if gains.guard is not None and self.arm is None:
            remedy = "Freeze it with an experiment on the arm: `--experiment table-1-wam`."
            raise InputError("guard", "given", "left out where no arm is driven", remedy)
        if (gains.schedule is None) != (self.family is None):
            raise InputError("family", self.family, "given for a controller with a schedule, and for no other", AGAIN)
        if gains.schedule is not None and self.arm is None:
            remedy = "Freeze it with an experiment on the arm: `--experiment family-wam`."
            raise InputError("schedule", "given", "left out where no arm is driven", remedy)
        if not isinstance(self.preview, bool):
            raise InputError("preview", self.preview, "true or false", "Say whether the future reference is known.")
        T_s, K2 = margin_floor.number("T_s", self.T_s), margin_floor.number("K2", self.K2)
        if not 1e-4 <= T_s <= 0.1:
            raise InputError("T_s", T_s, "in [1e-4, 0.1] s", "The paper's controller runs at 1e-3.")
        if not 0.0 <= K2 <= 1e4:
            raise InputError("K2", K2, "in [0, 1e4] 1/s", "The paper's controller has 10.")
        if gains.force_filter is not None and gains.force_filter.T_s != T_s:
            raise InputError("force_filter.T_s", gains.force_filter.T_s, f"T_s (= {T_s:g} s)", AGAIN)
        for name in ("params", "provenance"):
            plain(name, getattr(self, name))
        force = array("golden_force", self.golden_force, (None, 3))
        ahead = (len(gains.mpc_ref),) if self.preview else ()
        checked = {
            "gains": gains,
            "T_s": T_s,
            "K2": K2,
            "loop": judged_loop.checked(self.loop),
            "margins": margin_floor.plain_margins(self.margins),
            "floor": margin_floor.plain_floor(self.floor),
            "family": margin_floor.plain_family(self.family),
            "golden_force": force,
            "golden_force_ref": array("golden_force_ref", self.golden_force_ref, (len(force), 3, *ahead)),
            "golden_v": array("golden_v", self.golden_v, (len(force), 3)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not np.any(self.golden_v):
            raise InputError("golden_v", "all zero", "a trace that moves", "Nothing could be told from this one.")
        margin_floor.check(self.margins, self.floor)
        if self.family is not None and gains.schedule is not None:
            band, known = self.family["band"], gains.schedule.identification.band
            if band != known:
                raise InputError(
                    "family.band", band, f"what counts as known, schedule.identification.band (= {known:g})", AGAIN
                )
            margin_floor.check(self.family["rows"], self.floor, "with the tissue known to have about")
        if self.arm is not None:
            self._check_arm(self.arm)

    def _check_arm(self, arm: ArmModel) -> None:
        """What only a controller that drives must keep."""
        if self.loop.ideal:
            remedy = "Freeze it without --ideal: no arm has ideal damping."
            raise InputError("margins", "of the ideal loop", "those of the loop as it runs", remedy)
        if len(arm.golden_q) != len(self.golden_force):
            bound = f"of as many samples as golden_force, {len(self.golden_force)}"
            raise InputError("golden_q", f"{len(arm.golden_q)} samples", bound, AGAIN)
        self._check_known(arm)
        felt = max(math.hypot(*row) for row in self.golden_force.tolist())
        if felt > arm.limits.force:
            remedy = "Choose limits that its own run keeps, or another controller."
            raise InputError("golden_force", f"{felt:.3g} N", f"at most {arm.limits.force:g} N, its limit", remedy)
        # As on the weakest arm that a run takes, so that none refuses it once it is started.
        check_rates(arm.limits, self.T_s, (IPNM_RANGE[0],) * 4, CAPPED)
        most = fastest(self.T_s, self.loop.delay)
        if arm.momentum_observer > most * (1.0 + 1e-9):
            bound = f"at most {most:g} rad/s at T_s = {self.T_s:g} s and a delay of {self.loop.delay}"
            raise InputError("arm.momentum_observer", arm.momentum_observer, bound, "Lower it or sample faster.")
        softest = min(row["stiffness"] for row in self.margins)
        if arm.limits.force > REACH * softest:
            bound = f"at least {arm.limits.force / REACH:g} N/m, into which the force limit sinks the tip by its reach"
            raise InputError("stiffness", softest, bound, "Promise no tissue so soft, or limit the force.")

    def _check_known(self, arm: ArmModel) -> None:
        """A schedule has what it answers at its knots and beyond its bounds, no other controller has any of that."""
        family = self.gains.schedule
        for name in KNOWN:
            if (family is None) != (getattr(arm, name) is None):
                have = "given" if family is None else "missing"
                bound = "given for a controller with a schedule, whose every knot and bound it holds, and for no other"
                raise InputError(name, have, bound, AGAIN)
        if family is not None:
            array(KNOWN[0], arm.golden_known, (len(beliefs(family)), min(SAMPLES, len(self.golden_force)), 4))

    @property
    def flown_gains(self) -> Gains:
        """The gains as they fly: without preview with the weights of the reference summed."""
        return self.gains if self.preview else constant_reference(self.gains)

    @property
    def kind(self) -> str:
        """What it can do; see `KINDS`."""
        return KINDS[self.arm is not None]
