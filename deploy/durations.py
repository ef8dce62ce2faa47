"""Bounds that are times, in cycles of a controller's own period: no slower one waits longer by them."""


def cycles(duration: float, T_s: float, least: int = 1) -> int:
    """A time in cycles.

    Args:
        duration: [s]
        T_s: Time between two cycles [s].
        least: Fewest that do, however long a cycle lasts.
    """
    return max(round(duration / T_s), least)
