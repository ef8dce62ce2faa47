"""The table [tune] of a job, and its checks."""

from typing import Annotated, Literal

import msgspec

from jaxmpc import described
from jaxmpc.files.errors import InputError
from jaxmpc.world.heart.bounds import Seed

Count = Annotated[int, msgspec.Meta(ge=1, le=100_000)]


class TuneSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [tune]."""

    steps: Count = 150
    """Gradient steps at most, half of them with soft horizons: on the linear loop, for the arm on the spectra."""
    orders: tuple[Annotated[int, msgspec.Meta(ge=1, le=3)], ...] = ()
    """Disturbance orders of the active observer to compare by it, the best of which goes on; none given: as in the
    parameters."""
    starts: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 8
    """The given parameters and the best of many random ones; on the spectra eight times as many, and twice as many
    controllers run on the arm side by side."""
    seed: Seed = 0
    """Draws the random starts."""
    train_seeds: tuple[Seed, ...] = (0, 1)
    """Scenarios that the tuner sees; each seed draws one."""
    validation_seeds: tuple[Seed, ...] = ()
    """Scenarios that choose among the starts at the end; none: those of training."""
    heldout_seeds: tuple[Seed, ...] = tuple(range(1000, 1020))
    """Scenarios that only the final comparison sees."""
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 6.0
    """Length of a training run [s]; validation and held-out runs have the experiment's own."""
    settle: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 1.5
    """What is left out of its residual at the start [s]."""
    margin_points: Annotated[int, msgspec.Meta(ge=0, le=1000)] = 33
    """Stiffnesses, evenly spaced in their logarithm from the experiment's softest to its hardest, at which margins are
    judged besides the experiment's own."""
    mapping: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 24
    """Rounds of space mapping on the arm, at most: runs correct the spectra, which propose what to run next."""
    learning_rate: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.4
    """Step length of Adam, in units of the parameters' scales."""
    precision: Literal["float64", "float32"] = "float64"
    """Precision of the time stepping. Float64 is also faster on a CPU: adjoints of float32 end in subnormals."""
    diagonals: tuple[Literal["lam", "delta"], ...] = ()
    """Free parameters of which each diagonal entry is tuned by itself."""
    tied: tuple[str, ...] = ()
    """Free parameters of the knots that all knots have in common; of the stiffness assumed, the ratio to their own."""

    def __repr__(self) -> str:
        return described.as_text(*described.settings(self, {"duration": "s", "settle": "s"}))

    def check(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            InputError: Names key, value, bound and remedy.
        """
        lists = {key: getattr(self, key) for key in ("train_seeds", "validation_seeds", "heldout_seeds")}
        for key, seeds in lists.items():
            if not seeds and key != "validation_seeds":
                raise InputError(
                    f"tune.{key}", "[]", "at least one scenario's seed", "Give some, such as [1000, 1001]."
                )
            if len(set(seeds)) < len(seeds):
                raise InputError(f"tune.{key}", list(seeds), "without repetition", "Name each seed once.")
        for later, earlier in (
            ("validation_seeds", "train_seeds"),
            ("heldout_seeds", "train_seeds"),
            ("heldout_seeds", "validation_seeds"),
        ):
            if common := sorted(set(lists[later]) & set(lists[earlier])):
                remedy = "A seed that the tuner has seen proves nothing; remove it from one list."
                raise InputError(f"tune.{later}", common[0], f"unknown to {earlier}", remedy)
        if self.settle >= self.duration:
            remedy = "Lower settle or raise duration."
            raise InputError("tune.settle", self.settle, f"below duration (= {self.duration:g} s)", remedy)
        if len(set(self.orders)) < len(self.orders):
            raise InputError("tune.orders", list(self.orders), "without repetition", "Name each order once.")
