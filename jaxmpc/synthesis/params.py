"""What is tuned: the parameters of one controller, or of a batch of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc import described
from jaxmpc.files.errors import InputError, check_table, nearest
from jaxmpc.files.toml import without_arrays
from jaxmpc.quantities import FILTERS, HORIZONS, PARAMETERS, ParameterValues
from jaxmpc.synthesis.listening import Listening
from jaxmpc.synthesis.published import SETS
from jaxmpc.synthesis.structure import SHARED, STRUCTURE, Architecture, Delay, Order, check_knots, check_structure
from jaxmpc.synthesis.values import BATCHES, batch_of, check_values, from_plain, is_number, rows_of, tables


class Params(eqx.Module, ParameterValues):
    """Parameters of one controller; every leaf may have leading batch dimensions (see `stack`).

    `delta` and `R` only set scales: the controller depends on λ/δ and Q/R alone.

    Raises:
        InputError: A value is not finite or out of its bounds, H_u exceeds H_p, arrays are of several shapes,
            or knots are no controllers of the same batch.
    """

    architecture: Architecture = eqx.field(static=True, default="mpc-aob", converter=without_arrays)
    """"mpc-aob", "aob" (u = F_d) or "mpc" (on the open-loop plant)."""
    disturbance_order: Order = eqx.field(static=True, default=1, converter=without_arrays)
    """N, order of the random walk that the active state is taken for: 1 constant, 2 ramp, 3 parabola between samples.
    The same bandwidth needs a lower Q_p the higher N is."""
    designed_delay: Delay = eqx.field(static=True, default=1, converter=without_arrays)
    """After how many samples commands act, as the design assumes: 1, as in the paper, or 2."""

    guarded: bool = eqx.field(static=True, default=False, converter=without_arrays)
    """Whether the gain falls while the force swings faster than a heart can (`law.gain_backoff`); on the arm alone."""

    listening: Listening | None = eqx.field(static=True, default=None)
    """At which stiffness the knots stand, and how it is found; None without knots."""
    knots: tuple["Params", ...] = ()
    """Controllers for tissue whose stiffness is known; these parameters themselves are for tissue where it is not."""

    def __check_init__(self) -> None:
        check_structure(self)
        check_knots(self, Params)
        self._check_numbers()

    def _check_numbers(self) -> None:
        for name in PARAMETERS:
            value = getattr(self, name)
            if not is_number(value) or (value is None and name not in FILTERS):
                raise InputError(name, value, "a number", f"Its unit is [{PARAMETERS[name].unit}].")
        # Other leaves stand for numbers: shapes, axes to be mapped over, marks.
        arrays = self._arrays
        batch = batch_of(arrays)
        for knot in self.knots if arrays else ():
            if knot._arrays and (own := batch_of(knot._arrays)) != batch:
                found, wanted = (f"of the batch {shape}" if shape else "one controller" for shape in (own, batch))
                raise InputError("knots", found, f"{wanted}, as [params]", "Stack whole families with Params.stack.")
        known = {name: value for name, value in arrays.items() if not isinstance(value, jax.core.Tracer)}
        typical = {each.name: each.default for each in fields(self)}
        check_values(jax.device_get(known), typical, len(batch), self.architecture)

    def __repr__(self) -> str:
        return described.as_text(*described.parameters(self))

    def _repr_html_(self) -> str:
        return described.as_html(*described.parameters(self))

    @property
    def numbers(self) -> dict[str, Any]:
        """Its parameters by their names, but for filters that are the experiment's."""
        values = {name: getattr(self, name) for name in PARAMETERS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def _arrays(self) -> dict[str, Any]:
        """Those of its numbers that are arrays, traced or not."""
        return {name: value for name, value in self.numbers.items() if isinstance(value, np.ndarray | jax.Array)}

    @property
    def structure(self) -> dict[str, Any]:
        """Its values of `STRUCTURE`; the same for the whole of a batch."""
        return {name: getattr(self, name) for name in STRUCTURE}

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions; () for one controller."""
        return tuple(self.Khat_s.shape)

    @staticmethod
    def published(name: str) -> "Params":
        """A parameter set of the paper, or one to compare it with.

        Args:
            name: "text" (K̂_s = 900 N/m, as the paper's text says; the default baseline) or "printed"
                (K̂_s = 500 N/m, the one to which its printed gains belong), or "mpc-alone": the architecture "mpc",
                tuned by `jaxmpc tune` to the text design's M_s as it runs, for comparison; the paper prints none.
                "cautious" keeps M_s below 2 from 375 to 1900 N/m, at twice the residual: a first one for a robot.
                "family" begins as that, finds the tissue's stiffness and goes over to gains for it.

        Raises:
            InputError: The name is not one of these.
        """
        if not isinstance(name, str) or name not in SETS:
            raise InputError("published parameters", name, "a known name", nearest(name, list(SETS)))
        return Params.from_dict(SETS[name])

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "Params":
        """Parameters from plain values, or numpy's and JAX's; unnamed ones are the text design's.

        A diagonal may be given up to H_u (λ) or H_p (δ) only: its last entry is repeated.

        Raises:
            InputError: An unknown name, a wrong type, or a value out of bounds.
        """
        check_table("params", values)
        known = [*PARAMETERS, *STRUCTURE, "knots"]
        given: dict[str, Any] = {}
        for name, value in without_arrays(values).items():
            if name not in known:
                raise InputError(name, value, "a known parameter", nearest(name, known))
            given[name] = from_plain(name, value) if name in PARAMETERS else value
        shared: dict[str, Any] = {name: given[name] for name in SHARED if name in given}
        given["knots"] = tuple(Params.from_dict({**shared, **knot}) for knot in tables("knots", given.get("knots", ())))
        if isinstance(listening := given.get("listening"), Mapping):
            given["listening"] = Listening.from_dict(listening)
        elif not isinstance(listening, Listening | None):
            raise InputError("listening", listening, "a table", "Put its keys under [params.listening].")
        return Params(**given)

    @staticmethod
    def from_toml(path: str | Path) -> "Params":
        """Parameters from a `params.toml`, its table [params].

        Raises:
            InputError: The file cannot be read or holds something wrong; names file, line and key.
        """
        from jaxmpc.files.toml import located, meant, read_toml

        data = read_toml(path)
        with located(path):
            if unknown := [key for key in data if key not in ("params", "provenance")]:
                remedy = meant(data, ["params"]) or nearest(unknown[0], ["params"])
                if unknown[0] in PARAMETERS:
                    remedy = "Put the parameters under [params]."
                raise InputError(unknown[0], data[unknown[0]], "a known table", remedy)
            if not isinstance(table := data.get("params"), dict):
                raise InputError("params", "missing", "a table", "Put the parameters under [params].")
            return Params.from_dict(table)

    def to_dict(self) -> dict[str, Any]:
        """Plain values of one controller, as `from_dict` takes them."""
        if self.batch_shape:
            raise InputError("params", f"a batch {self.batch_shape}", "one controller", "Take one with `params[i]`.")
        values = {name: np.asarray(value).tolist() for name, value in self.numbers.items()}
        whole = {name: int(values[name]) for name in HORIZONS if values[name] == int(values[name])}
        found = {**self.structure, **values, **whole}
        if self.designed_delay == 1:  # as in the paper: goes without saying
            del found["designed_delay"]
        if self.listening is None:
            return {name: value for name, value in found.items() if name != "listening"}
        knots = [
            {name: value for name, value in knot.to_dict().items() if name not in STRUCTURE} for knot in self.knots
        ]
        return {**found, "listening": self.listening.to_dict(), "knots": knots}

    @staticmethod
    def stack(batch: Iterable["Params"]) -> "Params":
        """One batch of several controllers of the same structure; scalars beside diagonals are widened.

        Raises:
            InputError: The batch is empty or holds something else, or is no such thing; or it mixes architectures,
                disturbance orders, own filters with none, or batches of several shapes.
        """
        stacked = list(batch) if isinstance(batch, Iterable) and not isinstance(batch, Params) else [batch]
        wrong = [each for each in stacked if not isinstance(each, Params)]
        if wrong or not stacked or isinstance(batch, Params):
            given = "one Params" if isinstance(batch, Params) else wrong[0] if wrong else "empty"
            raise InputError("batch", given, "a list of Params", "Write Params.stack([first, second, …]).")
        if len(shapes := sorted({p.batch_shape for p in stacked})) > 1:
            remedy = "Stack single controllers, or batches of one shape."
            raise InputError("batch", " beside ".join(map(str, shapes)), "of one shape", remedy)
        for name in STRUCTURE:
            found = sorted({str(getattr(p, name)) for p in stacked})
            if len(found) != 1:
                raise InputError(name, ", ".join(found), "one for the whole batch", f"Evaluate each {name} by itself.")
        columns = {}
        for name in PARAMETERS:
            leaves = [getattr(p, name) for p in stacked]
            if all(leaf is None for leaf in leaves):
                continue
            if any(leaf is None for leaf in leaves):
                raise InputError(name, "given for some", "given for all or none", "Evaluate the others by themselves.")
            xp: Any = jnp if any(isinstance(leaf, jax.Array) for leaf in leaves) else np
            shape = max((leaf.shape for leaf in leaves), key=len)
            wide = [leaf[..., None] if leaf.ndim < len(shape) else leaf for leaf in leaves]  # along each row's diagonal
            columns[name] = xp.stack([xp.broadcast_to(leaf, shape) for leaf in wide])
        knots = tuple(Params.stack(alike) for alike in zip(*(p.knots for p in stacked), strict=True))
        return Params(**columns, knots=knots, **stacked[0].structure)

    def with_columns(self, columns: Mapping[str, Any]) -> "Params":
        """A batch of this one controller with some parameters replaced by columns of the same length.

        Args:
            columns: Values per parameter name, shape (n,), or (n, length) for a full diagonal.

        Raises:
            InputError: It is a batch already, a name is unknown, a column of another shape, or a value out of bounds;
                it names the parameter and the first such value.
        """
        if self.batch_shape:
            raise InputError("params", f"a batch {self.batch_shape}", "one controller", "Take one with `params[i]`.")
        rows = rows_of(columns)
        wide: dict[str, Any] = {
            name: np.broadcast_to(value, (rows, *np.shape(value))) for name, value in self.numbers.items()
        }
        given = {name: np.asarray(value, np.float64) for name, value in columns.items()}
        knots = tuple(
            knot.with_columns({"lam": np.broadcast_to(knot.lam, (rows, *knot.lam.shape))}) for knot in self.knots
        )
        return Params(**{**wide, **given}, knots=knots, **self.structure)

    def __getitem__(self, row: int | slice) -> "Params":
        """One controller, or a slice, of a batch.

        Raises:
            InputError: It is no batch.
            IndexError: The batch is shorter.
        """
        if not self.batch_shape:
            raise InputError("params", "one controller", "a batch", BATCHES)
        rows_here = self.batch_shape[0]
        # JAX takes the last row instead, and iteration would never end.
        if isinstance(row, int | np.integer) and not -rows_here <= row < rows_here:
            raise IndexError(f"row {row} of a batch of {rows_here}")
        rows: Params = jax.tree.map(lambda leaf: leaf[row], self)
        return rows


def by_structure(controllers: Sequence[Params]) -> list[list[int]]:
    """Which controllers can be a batch, as their numbers."""
    alike: dict[str, list[int]] = {}
    for i, params in enumerate(controllers):
        alike.setdefault(repr((params.structure, len(params.knots), list(params.numbers))), []).append(i)
    return list(alike.values())
