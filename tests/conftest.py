"""Settings of every test; the robot's tests run where neither jax nor hypothesis is installed."""

import os
from importlib.util import find_spec

if find_spec("jax"):
    # What another run compiled would hide what this one does, and the user's cache is not ours to fill.
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    import jax

    if jax.__version_info__ < (0, 11):
        # Tests compile more than they run, and this XLA takes twice as long without its older code generator.
        os.environ["XLA_FLAGS"] = "--xla_cpu_use_fusion_emitters=false " + os.environ.get("XLA_FLAGS", "")
    jax.config.update("jax_enable_x64", True)
    # As the command line does: one device compiles to other last bits than several.
    jax.config.update("jax_num_cpu_devices", 2)

if find_spec("jaxtyping") and find_spec("beartype"):
    from jaxtyping import install_import_hook

    from tests.shapes import with_shapes

    # Before anything of the product is imported. Pytest's option for it would take packages, and all that is in them.
    install_import_hook(with_shapes(), "tests.shapes.checked")

if find_spec("hypothesis"):
    import hypothesis

    # No deadline: a first example compiles. Derandomised: the same tree gives the same verdict.
    hypothesis.settings.register_profile("jaxmpc", deadline=None, derandomize=True, database=None)
    hypothesis.settings.load_profile("jaxmpc")
