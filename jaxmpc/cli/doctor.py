"""`jaxmpc doctor`: may this machine run the robot (`deploy.cli.doctor`), and which engine would simulate where."""

import argparse
from importlib.util import find_spec

from deploy.cli import doctor


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    doctor.configure(parser)


def run(args: argparse.Namespace) -> int:
    """Look at everything and print it; 1 if something prevents a run.

    Raises:
        InputError: The rate is none, or the flags of the bus name none of an arm.
    """
    code = doctor.run(args)
    # Last: JAX takes memory and threads that the clock was to be measured without.
    print("\n" + "\n".join(engine_lines()))
    return code


def engine_lines() -> list[str]:
    """One line per engine: where it would run and for what, or why not."""
    if find_spec("jax") is None:
        return ["engines: none; simulation needs the workstation, jaxmpc[sim]"]
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    import jax

    from jaxmpc.engine.base import ProgramSpec
    from jaxmpc.engine.registry import ENGINES, fastest

    here, backend = jax.local_devices(), jax.default_backend()
    where = f"{len(here)} CPU cores" if backend == "cpu" else f"{len(here)} × {here[0].device_kind}"
    quickest = fastest(ProgramSpec("scan", False, None)).engine
    lines = []
    for name, engine in ENGINES.items():
        what = f"{name:<7}{engine.text}"
        if why := engine.unfit():
            lines.append(f"{what}: not here, it {why}")
            continue
        if "mjx" in engine.physics:
            use = 'physics = "mjx", for comparison'
        elif name == quickest == "scan":
            use = "sweep, tune, trials, simulate"
        elif name == quickest:
            use = "sweep, trials, runs of tune on the arm: the fastest here"
        else:
            use = "slopes of tune, simulate, and sweeps whose rows have worlds of their own"
        lines.append(f"{what}: on {where}; {use}")
    return ["engines", *lines]
