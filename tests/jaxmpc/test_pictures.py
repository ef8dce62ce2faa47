"""Figures that several threads draw."""

from pathlib import Path
from threading import Event, Thread

import matplotlib as mpl

from jaxmpc.pictures.figures import figure


def test_one_thread_draws_at_a_time(tmp_path: Path) -> None:
    """Settings are those of all threads: one that ends first would take them from the one that still draws."""
    own, drawn = mpl.rcParams["font.size"], Event()

    def draw(name: str) -> None:
        with figure(tmp_path / name) as axes:
            axes.plot([0.0, 1.0], label="line")
            axes.legend()
        if name == "other.png":
            drawn.set()

    draw("alone.png")
    with figure(tmp_path / "first.png") as axes:
        other = Thread(target=draw, args=("other.png",))
        other.start()
        assert not drawn.wait(0.5)
        axes.plot([0.0, 1.0], label="line")
        axes.legend()
    other.join()
    assert drawn.is_set()
    assert mpl.rcParams["font.size"] == own
    alone, first, second = ((tmp_path / f"{name}.png").read_bytes() for name in ("alone", "first", "other"))
    assert alone == first == second
