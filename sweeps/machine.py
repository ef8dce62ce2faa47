"""What the bits and the speed of a result may depend on besides its spec; no host name, no path."""

import os
import platform
from pathlib import Path

import numpy as np

from jaxmpc import __version__


def environment(engine: str) -> dict[str, str]:
    """Versions, processor and devices that compute, and the engine that runs the rows."""
    import jax
    import jaxlib.version

    # Neither a dump of the compiler nor how many devices there are changes a row; only one or several does.
    neutral = ("--xla_force_host_platform_device_count", "--xla_dump")
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(neutral)]
    return {
        "jaxmpc": __version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.version.__version__,
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
        "cpu": processor(),
        "device": jax.local_devices()[0].device_kind,
        "engine": engine,
        "devices": "one" if jax.local_device_count() == 1 else "several",
        "xla_flags": " ".join(flags),
    }


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
