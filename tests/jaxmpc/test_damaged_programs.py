"""JAX's cache of programs on a full disk, and with half a program in it: neither is heard of, neither lasts."""

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from jaxmpc.xla.damaged import forget_damaged
from tests.sources import ROOT

SCRIPT = """
import resource, sys
from pathlib import Path

import jax
from jaxmpc.terminal.process import remember_programs

folder = Path(sys.argv[1])
remember_programs(folder)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

def called(name):
    def function(x):
        return 2.0 * x
    function.__name__ = name
    return jax.jit(function)

def kept(name):
    return {path: path.stat().st_size for path in folder.glob(f"jit_{name}-*-cache")}

called("halved")(1.0)
((path, size),) = kept("halved").items()
path.write_bytes(path.read_bytes()[: size // 2])
jax.clear_caches()
called("halved")(1.0)
# Not to the byte: how long it took to compile is in it.
assert 0.9 * size < kept("halved")[path] < 1.1 * size, "half a program is compiled and kept anew"
resource.setrlimit(resource.RLIMIT_FSIZE, (20, resource.RLIM_INFINITY))
assert called("too_large")(1.0) == 2.0
assert kept("too_large") == {}, "a full disk keeps no part of one"
"""


def test_half_a_program_is_replaced_and_nobody_hears_of_it(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    ran = subprocess.run(command, cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")


@pytest.mark.filterwarnings("always")
def test_other_warnings_are_shown_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = []
    monkeypatch.setattr(warnings, "showwarning", lambda message, *_: shown.append(f"{message}"))
    forget_damaged(tmp_path / "of before")
    forget_damaged(tmp_path)
    damaged, whole = tmp_path / "jit_f-0123-cache", tmp_path / "jit_ff-0123-cache"
    damaged.touch()
    whole.touch()
    for _ in range(2):
        warnings.warn("Error reading persistent compilation cache entry for 'jit_f': OSError: no", stacklevel=1)
    warnings.warn("something else", stacklevel=1)
    assert (damaged.exists(), whole.exists()) == (False, True)
    assert shown == ["something else"]
