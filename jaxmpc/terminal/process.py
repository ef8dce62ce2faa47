"""What an entry point may do to the process, and a library may not: 64-bit JAX, a device per core, a compile cache."""

import logging
import os
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from jaxmpc.files.errors import InputError, check_type

REPEATABLE = {"xla_gpu_autotune_level": "0", "xla_gpu_deterministic_ops": "true", "xla_gpu_enable_triton_gemm": "false"}
"""Flags of XLA, by which a GPU computes the same bits every time."""


def one_thread_for_blas() -> None:
    """Keep the BLAS of NumPy and SciPy from threads of its own, unless the user has said how many.

    Their matrices are small here, of a dozen rows, and many threads of Python multiply them at once. The number is read
    when NumPy is first imported.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def silence_libraries() -> None:
    """Keep remarks from the middle of a progress bar: XLA's of slow compiling, matplotlib's of a home without a cache.

    XLA's level is read when JAX is first imported, as some verbs do while they are imported themselves: call it before
    any of them. What fails is raised.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


def memory_as_needed() -> None:
    """Take of a GPU's memory what is needed when it is, unless the user has said otherwise; call before JAX computes.

    JAX takes three quarters of it when it begins, which on an H200 takes two seconds: as much as a small job's work.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def may_have_a_gpu() -> bool:
    """Whether JAX has a plugin for one, told before JAX is imported."""
    return find_spec("jax_plugins") is not None


def repeat_to_the_bit() -> None:
    """Have a GPU compute the same bits every time, where the user has not said otherwise; call before JAX computes.

    XLA tries which of its algorithms is the fastest otherwise, and on every host of a kind another may be; and it adds
    up in whatever order threads arrive. Products by Triton have no algorithm that is chosen by rule. Nothing is slower
    without (docs/gpu.md). Only where JAX has a plugin for a GPU: programs are kept by these flags, too.
    """
    if not may_have_a_gpu():
        return
    flags = os.environ.get("XLA_FLAGS", "")
    ours = (f"--{flag}={value}" for flag, value in REPEATABLE.items() if flag not in flags)
    os.environ["XLA_FLAGS"] = " ".join([*flags.split(), *ours])


def use_all_cores(cores: int | None = None) -> None:
    """Switch 64-bit JAX on and give every CPU core a device of its own; call before JAX computes anything.

    Of a GPU's memory it takes what is needed when it is, and has it repeat; see `memory_as_needed`,
    `repeat_to_the_bit`.

    There are two devices at least: a program for one device compiles to other last bits than one for
    several, and results must not depend on the number of cores. A device count set before, in XLA_FLAGS
    or by JAX's own option, is respected.

    Args:
        cores: Number of devices wanted; None is the number of cores this process may use.

    Raises:
        InputError: The environment asks for a single device.
    """
    import jax

    config: Any = jax.config
    config.update("jax_enable_x64", True)
    memory_as_needed()
    repeat_to_the_bit()
    remember_programs()
    if (set_before := _devices_asked_for(config)) is None:
        config.update("jax_num_cpu_devices", max(2, cores or len(os.sched_getaffinity(0))))
    elif set_before.number < 2:
        remedy = "Leave it out: one device computes other last bits than several, so results would have another hash."
        raise InputError(set_before.key, set_before.number, "at least 2 devices", remedy)


class _Devices(NamedTuple):
    """What somebody else has set."""

    key: str
    number: int


def _devices_asked_for(config: Any) -> _Devices | None:
    """The device count of XLA_FLAGS, whose last one counts, or of JAX's own option; None where nobody set it."""
    if found := re.findall(r"--xla_force_host_platform_device_count=(\d+)", os.environ.get("XLA_FLAGS", "")):
        return _Devices("XLA_FLAGS --xla_force_host_platform_device_count", int(found[-1][:9]))
    if config.jax_num_cpu_devices >= 0:
        return _Devices("JAX_NUM_CPU_DEVICES", config.jax_num_cpu_devices)
    return None


def users_cache() -> Path | None:
    """Where what saves time is kept for the next process; None where the user has no home, as in many containers."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return cache / "jaxmpc" if cache.is_absolute() else None


def remember_programs(folder: str | Path | None = None) -> None:
    """Keep programs for the next process, compiled and traced, whose first `evaluate` then takes seconds.

    The command line calls it; a library keeps nothing unless asked to. JAX_COMPILATION_CACHE_DIR names another place,
    JAX_ENABLE_COMPILATION_CACHE=0 keeps none.

    Args:
        folder: Where to; None is the user's cache, or nowhere where the user has no home.

    Raises:
        InputError: It is no name of a folder.
    """
    check_type("folder", folder, str | Path | None, "Name one, or leave it out for the user's cache.")
    import jax

    from jaxmpc.xla import store
    from jaxmpc.xla.damaged import forget_damaged

    config: Any = jax.config
    if folder is not None:
        config.update("jax_compilation_cache_dir", str(folder))
    elif config.jax_compilation_cache_dir is None:
        if (cache := users_cache()) is None:
            config.update("jax_enable_compilation_cache", False)
            return
        config.update("jax_compilation_cache_dir", str(cache / "programs"))
    config.update("jax_persistent_cache_min_compile_time_secs", 0.05)
    forget_damaged(Path(config.jax_compilation_cache_dir))
    store.keep_in(Path(config.jax_compilation_cache_dir) / "traced" if config.jax_enable_compilation_cache else None)
