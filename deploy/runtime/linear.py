"""The frozen controller at run time: the recorded law of three axes, one straight-line function."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from deploy.runtime.straightline import compile_straightline
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains
from jaxmpc.law.vectors import Vector3


class Runtime:
    """Measured and wanted force in, acceleration out; three independent axes with the same gains.

    This is the pure law. It limits nothing and judges nothing: a force that is not finite makes its
    axis NaN until the next `init`. The safety layer above it holds such values back, clamps what comes
    out, and reports through `applied` what was left of it.
    """

    def __init__(self, gains: Gains, preview: bool) -> None:
        """Record the law.

        Args:
            gains: Floats; without preview with one weight of the reference.
            preview: Whether the wanted force is known ahead, as many samples as the reference has weights.
        """
        self._gains = gains

        def law(states: Any, applied: Any, force: Any, force_ref: Any) -> Any:
            axes = [
                cascade.step(gains, state._replace(v=v), y, wanted if preview else (wanted,))
                for state, v, y, wanted in zip(states, applied, force, force_ref, strict=True)
            ]
            return tuple(state for state, _ in axes), tuple(v for _, v in axes)

        axis_ref = (0.0,) * len(gains.mpc_ref) if preview else 0.0
        self.recorded = compile_straightline(law, ((cascade.init(gains),) * 3, (0.0,) * 3, (0.0,) * 3, (axis_ref,) * 3))
        self._law = self.recorded.function
        self.init((0.0, 0.0, 0.0))

    def init(self, force: Sequence[float] | np.ndarray) -> None:
        """Start at rest, in contact with a measured force (3,) [N]."""
        x, y, z = _plain(force)
        self._states: Any = tuple(cascade.init(self._gains, each) for each in (x, y, z))
        self._applied: Vector3 = (0.0, 0.0, 0.0)

    def step(
        self, force: Sequence[float] | np.ndarray, force_ref: Sequence[float] | Sequence[Sequence[float]] | np.ndarray
    ) -> Vector3:
        """Advance by one sample.

        Args:
            force: Measured force on the tissue (3,) [N].
            force_ref: Wanted force (3,) [N]; with preview 1…H samples ahead (3, H), H weights in `mpc_ref`.

        Returns:
            Acceleration command v of each axis [m/s²]; damping is not yet subtracted.

        Raises:
            ValueError: A wrong number of forces or of references; the state has not changed.
        """
        self._states, v = self._law(self._states, self._applied, _plain(force), _plain(force_ref))
        self._applied = v
        return v  # type: ignore[no-any-return]  # a cast would cost time in the loop

    def applied(self, v: Sequence[float] | np.ndarray) -> None:
        """Tell the observer what was really applied (3,) [m/s²] since the last `step`, where it was clamped."""
        x, y, z = _plain(v)
        self._applied = (x, y, z)


def _plain(values: Any) -> Any:
    # numpy numbers would stay in the state and make every later step several times slower
    return values.tolist() if isinstance(values, np.ndarray) else values
