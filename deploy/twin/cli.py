"""`jaxmpc twin`: the robot as a process of its own, behind a CAN bus on this machine."""

import argparse
import contextlib
import math
import os
import signal
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from jaxmpc.files.errors import InputError

if TYPE_CHECKING:
    from deploy.twin.raw_bus import RawBus
    from deploy.twin.server import Server
    from deploy.twin.twin import Twin

PORT = 28600
KEYS = {"a": "activate", "i": "idle", "e": "e-stop"}
_MODES = ("e-stop", "idle", "active")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    from deploy.bus.interface import add_arguments

    parser.add_argument("--experiment", help="tissue, heart and arm of a TOML file, or of a published experiment")
    parser.add_argument("--stiffness", type=float, metavar="N/m", help="of the tissue (810, or the experiment's)")
    parser.add_argument("--tissue", help="elastic, kelvin-voigt, standard-linear, … (elastic, or the experiment's)")
    parser.add_argument("--touching", action="store_true", help="the tissue does not hold the tip")
    parser.add_argument(
        "--rhythm", help="harmonics, steady, …, or a recording: heart.csv, heart.csv:mm (the experiment's)"
    )
    parser.add_argument("--gap", type=float, default=0.02, metavar="M", help="height above the tissue (0.02)")
    parser.add_argument("--delay", type=int, metavar="MS", help="from a torque frame to its action (1)")
    parser.add_argument(
        "--sensor-frame", choices=("tool", "world"), default="tool", help="what the force sensor is fixed to (tool)"
    )
    parser.add_argument("--cold", action="store_true", help="just switched on: at home, pucks in reset")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="TARGET:WORD",
        help="force:stuck@12, J2:off@3+0.1, … (docs/robot.md); again for more",
    )
    parser.add_argument(
        "--port", type=int, help=f"of socketcand on 127.0.0.1; 0 takes a free one ({PORT}; with -i none)"
    )
    parser.add_argument("--slcan", action="store_true", help="also as a serial adapter at a pseudo-terminal")
    parser.add_argument("--seed", type=int, default=0, help="of noise, heart and faults (0)")
    parser.add_argument("--duration", type=float, metavar="S", help="end after so long; else Ctrl-C ends it")
    parser.add_argument(
        "--activate-after", type=float, metavar="S", help="the pendant's activate button, pressed by itself"
    )
    add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the twin until it is interrupted or over; 1 if the port is taken, or the interface cannot be used.

    Raises:
        InputError: A setting, a fault or a number is wrong.
    """
    from deploy.bus.interface import check_given
    from deploy.errors import BusError
    from deploy.loop.realtime import PRIORITY, prepared
    from deploy.twin.scenario import twin_settings, unlike_the_simulation
    from deploy.twin.server import HOST, Server
    from deploy.twin.twin import Twin

    _positive("--duration", args.duration)
    _positive("--activate-after", args.activate_after)
    check_given(args)
    if not hasattr(args, "interface") and hasattr(args, "channel"):
        remedy = "Name the interface too, as -i socketcan -c can0; without one the twin has a bus of its own, --port."
        raise InputError("--channel", args.channel, "given with --interface", remedy)
    if args.port is None and not hasattr(args, "interface"):
        args.port = PORT
    if args.port is not None and not 0 <= args.port < 65536:
        raise InputError("--port", args.port, "in [0, 65535]", "Choose another one.")
    if args.slcan and find_spec("serial") is None:
        remedy = "Install pyserial, or use the socketcand port, which needs nothing."
        raise InputError("--slcan", "given", "used where pyserial is installed", remedy)
    presses = [f"pendant:activate@{args.activate_after:.9f}"] if args.activate_after is not None else []
    twin = Twin(
        twin_settings(
            args.experiment,
            stiffness=args.stiffness,
            tissue=args.tissue,
            touching=args.touching,
            rhythm=args.rhythm,
            delay=args.delay,
            gap=args.gap,
            frame=args.sensor_frame,
            cold=args.cold,
            seed=args.seed,
            faults=(*presses, *args.fault),
        )
    )
    for sentence in unlike_the_simulation(args.experiment, args.rhythm):
        print(sentence)
    try:
        server = Server(twin, args.port)
    except OSError as error:
        print(f"jaxmpc twin: cannot listen on {HOST}:{args.port}: {error.strerror}", file=sys.stderr)
        return 1
    with contextlib.ExitStack() as stack:
        stack.callback(server.close)
        try:
            bus = _interface(args, server)
        except BusError as error:
            print(f"jaxmpc twin: {error}", file=sys.stderr)
            return 1
        stack.enter_context(_keyboard(twin, server))
        granted = stack.enter_context(prepared(PRIORITY - 5))
        for number in (signal.SIGTERM, signal.SIGINT):  # a shell's background job would ignore the latter
            stack.callback(signal.signal, number, signal.signal(number, lambda *_: server.stop()))
        with contextlib.suppress(KeyboardInterrupt):
            if args.slcan:
                _serial(server, stack)
            print("\n".join(each.sentence for each in granted if each.sentence.startswith(("priority", "memory"))))
            _introduce(twin, server)
            server.run(args.duration, _Status(twin, server))
    _statistics(twin, server)
    if bus is not None and bus.hopeless:
        print(f"jaxmpc twin: {args.interface} {getattr(args, 'channel', '')}: the interface has gone", file=sys.stderr)
        return 1
    return 0


def _interface(args: argparse.Namespace, server: "Server") -> "RawBus | None":
    """Be a node of the bus that the flags name, if they name one.

    Raises:
        BusError: It cannot be opened.
    """
    from deploy.bus.interface import open_interface
    from deploy.twin.raw_bus import RawBus

    if not hasattr(args, "interface"):
        return None
    bus = RawBus(open_interface(args))
    server.join(bus)
    print(f"bus: -i {args.interface}{f' -c {args.channel}' if hasattr(args, 'channel') else ''}")
    return bus


def _positive(flag: str, seconds: float | None) -> None:
    if seconds is not None and not 0.0 <= seconds < float("inf"):
        raise InputError(flag, seconds, "0 s or more", "Choose another time.")


def _introduce(twin: "Twin", server: "Server") -> None:
    from deploy.twin.server import HOST

    settings, tissue, motion = twin.settings, twin.settings.tissue, twin.settings.motion
    holding = "holds the tip once touched" if tissue.attached else "does not hold the tip"
    heart = f"heart {motion.rhythm if motion.kind == 'rhythm' else motion.kind}"
    print(f"twin: {tissue.kind} tissue, {settings.stiffness:g} N/m, {holding}; {heart}; seed {settings.seed}")
    where = (
        "at home, pucks in reset" if settings.cold else f"{1e3 * settings.gap:g} mm above the tissue, homed and awake"
    )
    print(
        f"arm: {where}; torques act {settings.delay} ms after their frame; force sensor fixed to the {settings.frame}"
    )
    for fault in twin.faults:
        value = "" if math.isnan(fault.value) else f" {fault.value:g}"
        lasts = "" if math.isinf(fault.duration) else f" for {fault.duration:g} s"
        print(f"{fault.target}: {fault.word}{value} from {fault.start:g} s{lasts}")
    if server.port:
        print(f"bus: -i socketcand -c can0 --bus-kwargs host={HOST} port={server.port} tcp_tune=True")
    print(
        f"pendant: {', '.join(f'{key} {button}' for key, button in KEYS.items())}; c carries the idle arm", flush=True
    )


class _Status:
    """Status line that is rewritten every second on a terminal; else one every ten seconds."""

    def __init__(self, twin: "Twin", server: "Server") -> None:
        self._twin, self._server, self._terminal = twin, server, sys.stdout.isatty()
        self._every, self._frames, self._longest = 1000 if self._terminal else 10_000, 0, 0

    def __call__(self, twin: "Twin") -> None:
        if twin.tick % self._every:
            return
        truth, counters = twin.truth(), twin.counters
        frames = counters["received"] + counters["sent"]
        rate, self._frames = 1e3 * (frames - self._frames) / self._every, frames
        contact = f"z {truth.force[2]:+.2f} N" if truth.touching else "no contact"
        late = self._server.counters["late ticks"]
        # Short enough for sixty columns: a line that wraps could not be rewritten.
        text = f"{twin.now:.0f} s  {_MODES[twin.safety.mode]}  {contact}  {rate:.0f} frames/s  {late} ticks late"
        self._longest = max(self._longest, len(text))
        over = f"\r{text:<{self._longest}}"
        print(over if self._terminal else text, end="" if self._terminal else "\n", flush=True)


@contextlib.contextmanager
def _keyboard(twin: "Twin", server: "Server") -> Iterator[None]:
    """Keys, or letters through a pipe, press the pendant's buttons."""
    try:
        file = sys.stdin.fileno()
        terminal = os.isatty(file)
        if terminal and os.getpgrp() != os.tcgetpgrp(file):
            raise OSError("in the background")
    except (OSError, ValueError, AttributeError):
        yield
        return

    def read() -> None:
        data = os.read(file, 64)
        if not data:
            server.forget(file)
        for key in data.decode("ascii", "replace").lower():
            if key in KEYS:
                twin.press(KEYS[key])
            elif key == "c" and twin.safety.mode != 2:
                twin.carry()

    with contextlib.ExitStack() as stack:
        if terminal:
            import termios
            import tty

            stack.callback(termios.tcsetattr, file, termios.TCSADRAIN, termios.tcgetattr(file))
            tty.setcbreak(file)
        # A file or /dev/null is always ready, and cannot always be watched.
        with contextlib.suppress(OSError, ValueError):
            server.watch(file, read)
        yield


def _serial(server: "Server", stack: contextlib.ExitStack) -> None:
    """A pseudo-terminal on which the twin speaks slcan; our own end of it stays open while nobody listens."""
    import tty

    from deploy.twin.slcan import Slcan

    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    file: Any = stack.enter_context(os.fdopen(master, "rb", buffering=0))
    stack.callback(os.close, slave)
    server.attach(file, Slcan())
    print(f"bus: -i slcan -c {os.ttyname(slave)} -b 1000000", flush=True)


def _statistics(twin: "Twin", server: "Server") -> None:
    print(f"\n{twin.now:.3f} s; safety module {_MODES[twin.safety.mode]}")
    counts = {"frames " + name if name in ("sent", "received") else name: n for name, n in twin.counters.items()}
    for name, number in sorted({**counts, **server.counters}.items()):
        print(f"  {name:<36} {number}")
    given_up = server.counters["milliseconds given up"]
    if server.counters["late ticks"] > 0.01 * server.counters["ticks"] or given_up:
        print("  this machine is too slow, or too busy, for the twin in real time")
