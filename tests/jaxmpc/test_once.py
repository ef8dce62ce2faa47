"""Programs that run once: this XLA must still have a way to compile them quickly."""

import jax
import numpy as np

from jaxmpc.xla.once import OPTIONS, JitOnce, _options


def test_this_version_of_xla_knows_how_to_compile_quickly() -> None:
    """An option that is gone is passed over in silence, and every command then takes twice as long to begin."""
    assert _options("cpu") in OPTIONS


def test_a_gpu_is_given_no_option_of_the_cpu() -> None:
    assert _options("gpu") is None


def test_a_quick_program_computes_what_a_plain_one_does() -> None:
    x = np.linspace(0.1, 3.0, 7)
    np.testing.assert_allclose(JitOnce(wave)(x), jax.jit(wave)(x), rtol=1e-12)


def wave(x: jax.Array) -> jax.Array:
    return jax.numpy.sin(x) / x


def test_a_program_is_traced_and_then_compiled() -> None:
    seen: list[int] = []

    def told(x: jax.Array) -> jax.Array:
        seen.append(len(x))
        return wave(x)

    x = np.linspace(0.1, 3.0, 5)
    program = JitOnce(told)
    finish = program.traced(x)
    assert seen == [5]
    finish()
    np.testing.assert_allclose(program(x), jax.jit(wave)(x), rtol=1e-12)
    assert seen == [5]
