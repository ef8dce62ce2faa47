"""Whether a run has pressed much more than was wanted, by the sensor's word: then it does not end as if all were well.

A late force, lost frames, a heart whose beats come early or a loop that swings make the tip press more than is wanted
without breaking any limit. Nothing is stopped for that; the run's last line says it.
"""

from typing import NamedTuple

LEAST = 0.55
"""Push beyond the wanted one that counts for nothing, however small that is [N]: at −2 N a healthy loop reads up to
0.46 N more, on an arm with twice the friction and a tenth more mass 0.51 N."""


class Pushes(NamedTuple):
    """Largest pushes of a run, in contact and on the way out."""

    wanted: float = 0.0
    """With the sine by which a family hears the tissue, since that is asked of the tip too [N]."""
    measured: float = 0.0
    """[N]"""

    def beyond(self, ratio: float) -> bool:
        """Whether the tip has pressed much more than was wanted at most.

        Args:
            ratio: Of the two, up to which it is not much [-].
        """
        return self.measured > max(ratio * self.wanted, self.wanted + LEAST)

    def __str__(self) -> str:
        return f"{self.measured:.2f} N measured, {self.wanted:.2f} N wanted"


def pushed(pushes: Pushes, wanted: float, measured: float) -> Pushes:
    """The largest pushes with a sample more.

    Args:
        pushes: Those before.
        wanted: Push that is wanted, the sine in it [N].
        measured: Push that was read [N].
    """
    return Pushes(max(pushes.wanted, wanted), max(pushes.measured, measured))
