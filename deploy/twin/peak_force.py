"""The largest forces of a flight against the twin, as read and true, and the faults that went unnoticed."""

from collections.abc import Sequence
from math import hypot, isfinite

from deploy.twin.faults import Fault
from jaxmpc.law.vectors import Vector3


class PeakForces:
    """Largest forces on the tissue [N].

    A tissue that holds the tip pulls at it in the retraction by up to what it bears: so pushes, along −Z, stand apart.

    Attributes:
        true: Euclidean norm of the force that only the twin knows.
        measured: That of the force as it was read.
        true_push: Push of the former.
        measured_push: Push of the latter.
    """

    def __init__(self) -> None:
        """Begin without any."""
        self.true = self.measured = self.true_push = self.measured_push = 0.0

    def add_true(self, force: Vector3) -> None:
        """Count a true force, once a millisecond [N]."""
        self.true, self.true_push = max(self.true, hypot(*force)), max(self.true_push, -force[2])

    def add_measured(self, force: Vector3 | None) -> None:
        """Count a force that was read [N]; None or one that is not finite counts for nothing."""
        if force is not None and isfinite(size := hypot(*force)):
            self.measured, self.measured_push = max(self.measured, size), max(self.measured_push, -force[2])

    def report(self, faults: Sequence[Fault], texts: Sequence[str], well: bool, end: float, limit: float) -> list[str]:
        """Both peaks, and each fault that never began, or began without ending the run.

        Args:
            faults: Of the twin.
            texts: The words that they were asked for by.
            well: Whether the run ended as it was to end.
            end: When it ended [s].
            limit: Of the force on the tissue [N].
        """
        beyond = ", BEYOND THE LIMIT" if self.true > limit else ""
        lines = [
            f"largest push on the tissue: true {self.true_push:.2f} N, measured {self.measured_push:.2f} N",
            f"largest force in any direction: true {self.true:.2f} N{beyond}, measured {self.measured:.2f} N, "
            f"limit {limit:g} N",
        ]
        for fault, text in zip(faults, texts, strict=True):
            if fault.start >= end:
                lines.append(f"NEVER BEGAN: fault {text}; the run ended {end:.1f} s after the twin began")
            elif well:
                lines.append(f"NOT NOTICED: fault {text}; the run ended as if there were none")
        return lines
