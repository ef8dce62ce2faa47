"""The residual of a flight against the twin: as the force sensor read it, and of the force that the twin knows."""

from math import inf, isfinite, sqrt

from jaxmpc.law.vectors import Vector3

SETTLE = 5.0
"""What is left out of the time in contact, as in the paper's Table I [s]."""
LEAST = 1.0
"""Shorter than this no residual is told: a heart has not beaten once [s]."""


class _Residual:
    """Extremes and squares of an error per axis."""

    def __init__(self) -> None:
        self.count, self.squares, self.least, self.most = 0, [0.0] * 3, [inf] * 3, [-inf] * 3

    def add(self, force: Vector3, wanted: Vector3) -> None:
        self.count += 1
        for i, (value, ref) in enumerate(zip(force, wanted, strict=True)):
            error = value - ref
            self.squares[i] += error * error
            self.least[i], self.most[i] = min(self.least[i], error), max(self.most[i], error)

    def text(self) -> str:
        """Peak to peak and RMS per axis."""
        each = zip(self.squares, self.least, self.most, strict=True)
        return "".join(f"{most - least:10.3f} / {sqrt(total / self.count):.4f}" for total, least, most in each)


class FlownResiduals:
    """Both residuals of a flight, gathered cycle by cycle."""

    def __init__(self) -> None:
        """Begin without any."""
        self.measured, self.true = _Residual(), _Residual()
        self._last = 0.0

    def add(self, contact_time: float, wanted: Vector3, measured: Vector3 | None, true: Vector3) -> None:
        """Count a cycle in contact.

        Args:
            contact_time: How long the law has been in control [s].
            wanted: Force wanted (3,) [N].
            measured: Force that the sensor read [N]; None or NaN where it gave none.
            true: Force on the tissue [N].
        """
        self._last = contact_time
        if contact_time < SETTLE:
            return
        self.true.add(true, wanted)
        if measured is not None and all(map(isfinite, measured)):
            self.measured.add(measured, wanted)

    def report(self) -> list[str]:
        """Measured first, true second; of a flight that was too short, that it was."""
        if not (self.measured.count and self.true.count) or self._last < SETTLE + LEAST:
            return [f"no residual: it is told of what follows {SETTLE:g} s in contact, {LEAST:g} s of it at least"]
        head = f"residual after {SETTLE:g} s in contact, pp / RMS [N]"
        return [f"{head}  X, Y, Z", f"  measured  {self.measured.text()}", f"  true force{self.true.text()}"]
