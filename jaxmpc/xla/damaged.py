"""Programs that JAX could keep only in part, on a full disk or in a process that was killed while it wrote."""

import re
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

_FAILED = re.compile(r"Error (?:reading|writing) persistent compilation cache entry for '([\w.<>-]+)'")


class _Forgetting:
    """What shows warnings; those of JAX's cache it takes for an order to forget the programs of that name."""

    def __init__(self, folder: Path, others: Any) -> None:
        """Forget in a folder, and leave every other warning to what showed it before."""
        self._folder, self._others = folder, others

    def __call__(self, message: Any, *more: Any, **named: Any) -> None:
        """Show a warning, or forget."""
        if failed := _FAILED.match(f"{message}"):
            for path in self._folder.glob(f"{failed[1]}-*-cache"):
                # One that may not be removed costs its reader some time, as before.
                with suppress(OSError):
                    path.unlink()
        else:
            self._others(message, *more, **named)


def forget_damaged(folder: Path) -> None:
    """Remove from JAX's cache what it fails to write or to read, without a word.

    JAX writes in place and never over what is there: half a program would be read in vain, compiled anew and warned of
    by every process from then on.

    Args:
        folder: Where JAX keeps compiled programs.
    """
    shown: Any = warnings.showwarning
    warnings.showwarning = _Forgetting(folder, shown._others if isinstance(shown, _Forgetting) else shown)
    # By default a warning is shown once for each place and text: a second program of that name would not be heard of.
    warnings.filterwarnings("always", _FAILED.pattern, UserWarning)
