"""The inverse of `deploy.puck.pendant.decode_pendant`, which no program needs."""

from deploy.puck.pendant import BUTTONS, CONDITIONS, DIGITS, LAMPS, Pendant


def encode_pendant(pendant: Pendant) -> int:
    """The value of PEN that shows this."""
    lamp = {word: bits for bits, word in LAMPS.items()}
    segments = next((bits for bits, digit in DIGITS.items() if digit == pendant.digit), 0)
    lights = pendant.activate_light << 25 | pendant.idle_light << 24
    conditions = sum(lamp[getattr(pendant, name)] << 3 * i for i, name in enumerate(CONDITIONS))
    return BUTTONS.index(pendant.button) << 26 | lights | segments << 16 | conditions
