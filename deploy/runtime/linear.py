"""The frozen controller at run time: the recorded law of three axes, one straight-line function."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.runtime.straightline import compile_straightline
from jaxmpc.law import cascade
from jaxmpc.law.vectors import Vector3

if TYPE_CHECKING:
    from deploy.controller.artifact import Artifact


class Runtime:
    """Measured and wanted force in, acceleration out; three independent axes with the same gains.

    This is the pure law. It limits nothing and judges nothing: a force that is not finite makes its
    axis NaN until the next `init`. The safety layer above it holds such values back, clamps what comes
    out, and reports through `applied` what was left of it.
    """

    def __init__(self, artifact: "Artifact") -> None:
        """Record the law with the gains of an artifact.

        Args:
            artifact: What `deploy.controller.artifact.load` returned.
        """
        gains = artifact.gains if artifact.preview else cascade.constant_reference(artifact.gains)
        horizon, self._order = len(gains.mpc_ref), cascade.order(gains)

        def law(states: Any, applied: Any, force: Any, force_ref: Any) -> Any:
            axes = [
                cascade.step(gains, state._replace(v=v), y, wanted if artifact.preview else (wanted,))
                for state, v, y, wanted in zip(states, applied, force, force_ref, strict=True)
            ]
            return tuple(state for state, _ in axes), tuple(v for _, v in axes)

        axis_ref = (0.0,) * horizon if artifact.preview else 0.0
        self.recorded = compile_straightline(
            law, ((cascade.init(0.0, self._order),) * 3, (0.0,) * 3, (0.0,) * 3, (axis_ref,) * 3)
        )
        self._law = self.recorded.function
        self.init((0.0, 0.0, 0.0))

    def init(self, force: Sequence[float] | np.ndarray) -> None:
        """Start at rest, in contact with a measured force (3,) [N]."""
        x, y, z = _plain(force)
        self._states: Any = tuple(cascade.init(each, self._order) for each in (x, y, z))
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


def replay(artifact: "Artifact") -> float:
    """Largest deviation from the golden trace, relative to its largest |v| [-].

    The trace begins with `init` at its first force; every force comes from the trace, not from a loop
    that reacts, so no feedback amplifies rounding. What remains is that XLA may fuse a multiplication
    with an addition, and may sum the weights of the reference in another order: about 1e-15 a step.
    A load therefore asks for 1e-9, far above rounding and far below any other law or changed gain.
    """
    runtime = Runtime(artifact)
    runtime.init(artifact.golden_force[0])
    v = [runtime.step(*row) for row in zip(artifact.golden_force, artifact.golden_force_ref, strict=True)]
    return float(np.max(np.abs(np.array(v) - artifact.golden_v))) / float(np.max(np.abs(artifact.golden_v)))
