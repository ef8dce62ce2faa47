"""Which bus: python-can's own flags, opened as the interface that they name."""

import argparse
import re
import time
from collections.abc import Callable

import can
import can.util
from can.cli import add_bus_arguments, create_bus_from_namespace

from deploy.bus.bus import Bus
from deploy.errors import BusError
from jaxmpc.files.errors import InputError

BITRATE = 1_000_000
"""Bit rate of the pucks [bit/s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags that say which bus: python-can's own, as --interface and --channel."""
    add_bus_arguments(parser)
    for flag in parser._actions:
        if flag.dest in ("fd", "data_bitrate"):  # taken nevertheless: `check_flags` says why they are refused
            flag.help = argparse.SUPPRESS
        elif flag.dest == "bitrate":
            flag.help = f"of the bus: {BITRATE}, which the pucks speak, and nothing else"
        elif flag.dest == "interface":  # two dozen names in a row, which no line holds
            flag.metavar = "NAME"
            flag.help = f"{flag.help} One of: {', '.join(flag.choices or ())}."


def check_given(arguments: argparse.Namespace) -> None:
    """Refuse flags that fit no bus of an arm, whether or not they name one.

    Raises:
        InputError: The channel's name is none, or the bus speaks what the arm does not.
    """
    channel = str(getattr(arguments, "channel", ""))
    if not re.fullmatch(r"[\w./:@+-]{0,128}", channel):
        raise InputError("--channel", channel, "the name of a CAN channel", "Give one like can0 or /dev/ttyACM0.")
    if getattr(arguments, "fd", False):
        raise InputError("--fd", "given", "left out", "The pucks speak classical CAN only.")
    bitrate = getattr(arguments, "bitrate", BITRATE)
    if bitrate != BITRATE:
        raise InputError("--bitrate", bitrate, f"{BITRATE} bit/s", "The pucks speak 1 Mbit/s and nothing else.")


def check_flags(arguments: argparse.Namespace, otherwise: str = "") -> None:
    """Refuse flags that name no bus of an arm, before anything is opened.

    Args:
        arguments: Flags of python-can.
        otherwise: What else the verb can do, said where no bus is named.

    Raises:
        InputError: As `check_given`, or no bus is named.
    """
    check_given(arguments)
    if not hasattr(arguments, "interface"):
        try:  # python-can's environment variables and files may name one
            can.util.load_config()
        except can.CanInterfaceNotImplementedError:
            remedy = f"Name one, as --interface socketcan --channel can0{otherwise}."
            raise InputError("--interface", "left out", "given", remedy) from None
        except Exception:  # a file or variable of any wrong kind: told where the bus is opened, which reads it again
            return


def open_bus(arguments: argparse.Namespace, now: Callable[[], int] = time.monotonic_ns) -> Bus:
    """The bus that python-can's flags name.

    Raises:
        BusError: It cannot be opened.
        InputError: As `check_flags`.
    """
    return Bus(open_interface(arguments), now)


def open_interface(arguments: argparse.Namespace) -> can.BusABC:
    """The bus of python-can that its flags name.

    Raises:
        BusError: It cannot be opened.
        InputError: As `check_flags`.
    """
    check_flags(arguments)
    try:
        return create_bus_from_namespace(arguments)
    except argparse.ArgumentError as error:
        name = " ".join(f"{getattr(arguments, key, '')}" for key in ("interface", "channel")).strip()
        name = name or "that python-can's own settings name"
        remedy = "check --interface and --channel, that its driver is loaded and that nobody else has it"
        raise BusError(f"the bus {name} cannot be opened ({error.__cause__ or error}): {remedy}") from None
