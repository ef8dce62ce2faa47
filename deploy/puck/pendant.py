"""What the pendant shows and which of its buttons is pressed: the safety module's property PEN (wam.md §3.5)."""

from typing import Final, Literal, NamedTuple

Button = Literal["none", "idle", "activate", "e-stop"]
Word = Literal["SAFE", "WARNING", "FAULT"]

BUTTONS: Final[tuple[Button, ...]] = ("e-stop", "activate", "idle", "none")
LAMPS: Final[dict[int, Word]] = {1: "SAFE", 2: "WARNING", 4: "FAULT"}
DIGITS: Final = {
    0x3F: "0", 0x06: "1", 0x5B: "2", 0x4F: "3", 0x66: "4", 0x6D: "5",
    0x7D: "6", 0x07: "7", 0x77: "A", 0x79: "E", 0x76: "H", 0x38: "L",
}  # fmt: skip
CONDITIONS: Final = ("velocity", "torque", "voltage", "heartbeat", "other")


class Pendant(NamedTuple):
    """Buttons, lights, the digit, and the five conditions that the safety module watches."""

    button: Button
    activate_light: bool
    idle_light: bool
    digit: str
    velocity: Word
    torque: Word
    voltage: Word
    heartbeat: Word
    other: Word

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the conditions in FAULT."""
        return tuple(name for name in CONDITIONS if getattr(self, name) == "FAULT")


def decode_pendant(value: int) -> Pendant:
    """The pendant from the value of PEN; a condition with no lamp or several counts as a fault."""
    words = (LAMPS.get(value >> 3 * i & 0b111, "FAULT") for i in range(5))
    digit = DIGITS.get(value >> 16 & 0xFF, " ")
    return Pendant(BUTTONS[value >> 26 & 0b11], bool(value >> 25 & 1), bool(value >> 24 & 1), digit, *words)
