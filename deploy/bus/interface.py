"""Which bus: python-can's own flags, opened as the interface that they name."""

import argparse
import re
import time
from collections.abc import Callable

import can
from can.cli import add_bus_arguments, create_bus_from_namespace

from deploy.bus.bus import Bus
from deploy.errors import BusError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags that say which bus: python-can's own, as --interface and --channel."""
    add_bus_arguments(parser)
    for flag in parser._actions:
        if flag.dest in ("fd", "data_bitrate"):  # taken nevertheless: `open_interface` says why they are refused
            flag.help = argparse.SUPPRESS
        elif flag.dest == "bitrate":
            flag.help = "of the bus: 1000000, which the pucks speak, and nothing else"
        elif flag.dest == "interface":  # two dozen names in a row, which no line holds
            flag.metavar = "NAME"
            flag.help = f"{flag.help} One of: {', '.join(flag.choices or ())}."


def open_bus(arguments: argparse.Namespace, now: Callable[[], int] = time.monotonic_ns) -> Bus:
    """The bus that python-can's flags name.

    Raises:
        BusError: As `open_interface`.
    """
    return Bus(open_interface(arguments), now)


def open_interface(arguments: argparse.Namespace) -> can.BusABC:
    """The bus of python-can that its flags name.

    Raises:
        BusError: It cannot be opened, or the flags ask for what the arm does not speak.
    """
    channel = str(getattr(arguments, "channel", ""))
    if not re.fullmatch(r"[\w./:@+-]{0,128}", channel):
        raise BusError(f"{channel!r} is no name of a CAN channel: give one like can0 or /dev/ttyACM0")
    if getattr(arguments, "fd", False):
        raise BusError("the pucks speak classical CAN only: leave --fd out")
    bitrate = getattr(arguments, "bitrate", 1_000_000)
    if bitrate != 1_000_000:
        raise BusError(f"the pucks speak 1 Mbit/s, not {bitrate} bit/s: use --bitrate 1000000")
    try:
        return create_bus_from_namespace(arguments)
    except argparse.ArgumentError as error:
        why = error.__cause__ or error
        name = " ".join(f"{getattr(arguments, key, '')}" for key in ("interface", "channel")).strip()
        if not name.replace("None", "").strip():
            raise BusError(
                f"no bus is named ({why}): name one, as --interface socketcan --channel can0, or fly against the twin, "
                "--lockstep"
            ) from None
        remedy = "check --interface and --channel, that its driver is loaded and that nobody else has it"
        raise BusError(f"the bus {name} cannot be opened ({why}): {remedy}") from None
