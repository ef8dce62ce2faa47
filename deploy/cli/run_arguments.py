"""The arguments of `jaxmpc run`: what they are, what they may be, and the options of a session that they ask for."""

import argparse
from collections.abc import Mapping
from math import cos, isfinite, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmpc.files.errors import InputError

if TYPE_CHECKING:
    from deploy.controller.artifact import Artifact
    from deploy.force.sensor import ForceSensor
    from deploy.loop.options import Options

HASH = 8
"""Characters of the controller's sha256 that arm it."""
LONGEST = 50.0
"""Longest recording of 1 kHz that can be read again [s]."""
ONE_PROGRAM = ("slcan", "serial", "robotell")
"""Interfaces of python-can that are a serial line, which two programs read to pieces."""
A_NETWORK = "Make a network of it by `slcand -o -s8 DEVICE can0`, then --interface socketcan --channel can0."
OF_THE_TWIN: Mapping[str, Any] = {"experiment": None, "stiffness": None, "rhythm": None, "fault": [], "seed": 0}
"""Arguments of a twin in this process, and what they are where nobody gives them."""
OF_THE_BUS: Mapping[str, Any] = {
    "interface": None,
    "channel": None,
    "bitrate": None,
    "timing": None,
    "bus_kwargs": {},
    "cpu": None,
    "home": False,
}
"""Those of a bus and of the computer on it."""
CONTACTS = {
    "approach_speed": (0.1, 50.0, "mm/s", "The tissue is soft: go slowly."),
    "approach_limit": (1.0, 200.0, "mm", "60 is usual."),
    "retract": (1.0, 200.0, "mm", "30 is usual."),
}
"""Bounds, their unit, and what to do about a value beyond them."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    from deploy.bus.interface import add_arguments

    parser.add_argument("artifact", type=Path, help="a controller frozen for the arm")
    wanted = parser.add_argument_group("wanted force")
    help_text = (
        "X,Y,Z [N], 'ramps:X,Y,Z@RATE hold@S sweep@X,Y,Z@HZ@HZ@S …', an experiment's TOML file, a file t,x,y,z, "
        "or - for lines on standard input (-5 N in Z)"
    )
    wanted.add_argument("--reference", default="ramps:0,0,-5@2", help=help_text)
    wanted.add_argument("--rate", type=float, default=5.0, metavar="N/S", help="fastest change of it (5)")
    wanted.add_argument("--duration", type=float, default=30.0, metavar="S", help="time in contact (30)")
    operator = parser.add_argument_group("operator")
    operator.add_argument("--arm", metavar="SHA256", help=f"its first {HASH} characters arm the controller; else asked")
    operator.add_argument(
        "--require-signature", type=Path, metavar="KEY.pub", help="take only what this Ed25519 key has signed"
    )
    operator.add_argument(
        "--start", choices=("enter", "auto"), default="enter", help="what begins the approach (enter)"
    )
    operator.add_argument("--home", action="store_true", help="the arm stands at home, if it does not know where it is")
    contact = parser.add_argument_group("contact")
    contact.add_argument("--approach-speed", type=float, default=5.0, metavar="MM/S", help="downwards (5)")
    contact.add_argument("--approach-limit", type=float, default=60.0, metavar="MM", help="farthest way down (60)")
    contact.add_argument("--retract", type=float, default=30.0, metavar="MM", help="way up at the end (30)")
    sensor = parser.add_argument_group("force sensor")
    sensor.add_argument("--sensor", default="can", help="can, or jr3:/dev/comedi0 (can)")
    sensor.add_argument(
        "--mount", default="0,0,0", metavar="R,P,Y", help="its roll, pitch and yaw in the frame (0,0,0) [deg]"
    )
    sensor.add_argument("--sensor-frame", choices=("tool", "world"), default="tool", help="what it is fixed to (tool)")
    sensor.add_argument("--no-tare", action="store_true", help="leave its zero as it is")
    machine = parser.add_argument_group("machine")
    machine.add_argument("--hz", type=float, help="refused unless it is the controller's own rate")
    machine.add_argument("--cpu", type=int, help="processor to run on")
    machine.add_argument(
        "-o", "--output", type=Path, default=Path("flights"), metavar="DIR", help="recordings (flights)"
    )
    machine.add_argument("--record", action="store_true", help="write the flight recording even if all went well")
    machine.add_argument(
        "--recorded",
        type=float,
        default=10.0,
        metavar="S",
        help=f"how much of the end is kept (10, at most {LONGEST:g}); of a family replay needs approach and contact",
    )
    machine.add_argument("--bus-log", type=Path, metavar="FILE.log", help="the torque frames, as candump logs them")
    twin = parser.add_argument_group("a twin instead of a bus (needs mujoco)")
    twin.add_argument("--lockstep", action="store_true", help="run against a twin in this process, in its own time")
    twin.add_argument("--experiment", help="its tissue, heart and arm: a TOML file, or a published experiment")
    twin.add_argument("--stiffness", type=float, metavar="N/M", help="of its tissue (810, or the experiment's)")
    twin.add_argument("--rhythm", help="of its heart, or a recording: heart.csv, heart.csv:mm (the experiment's)")
    twin.add_argument(
        "--fault", action="append", default=[], metavar="FAULT", help="as for `jaxmpc twin`; again for more"
    )
    twin.add_argument("--seed", type=int, default=0, help="of its noise and faults (0)")
    add_arguments(parser)


def check(args: argparse.Namespace) -> None:
    """Refuse what no run can be asked for.

    Raises:
        InputError: An argument is out of range, or of no effect in such a run.
    """
    from deploy.bus.interface import check_flags

    idle, remedy = OF_THE_TWIN, "`jaxmpc twin` takes it, where that is on the bus; --lockstep flies against one here."
    if args.lockstep:
        idle, remedy = OF_THE_BUS, "Leave it out: a twin in this process has neither a bus nor a time of its own."
    for name, nothing in idle.items():
        if (given := getattr(args, name, nothing)) != nothing:
            bound = "left out with --lockstep" if args.lockstep else "given with --lockstep"
            said = " ".join(given) if isinstance(given, list) else given
            raise InputError(f"--{name.replace('_', '-')}", said, bound, remedy)
    if not args.lockstep:
        check_flags(args, ", or fly against the twin, --lockstep")
    for name, (low, high, unit, remedy) in CONTACTS.items():
        if not low <= getattr(args, name) <= high:
            bound = f"in [{low:g}, {high:g}] {unit}"
            raise InputError(f"--{name.replace('_', '-')}", getattr(args, name), bound, remedy)
    if not 0.0 < args.duration <= 86400.0:
        raise InputError("--duration", args.duration, "in (0, 86400] s", "Ctrl-C ends a run at any time.")
    if not 0.0 < args.rate <= 100.0:
        raise InputError("--rate", args.rate, "in (0, 100] N/s", "The paper's fastest reference has 12.6.")
    if not 1.0 <= args.recorded <= LONGEST:
        raise InputError(
            "--recorded", args.recorded, f"in [1, {LONGEST:g}] s", "A recording lies in memory as a whole."
        )
    if not args.lockstep and getattr(args, "interface", None) in ONE_PROGRAM:
        raise InputError("--interface", args.interface, "one that the watchdog can open, too", A_NETWORK)
    if args.reference == "-" and args.arm is None and not args.lockstep:
        raise InputError("--arm", "left out", "given with --reference -", "Standard input is the wanted force there.")
    kind, _, device = args.sensor.partition(":")
    if args.lockstep and kind == "jr3":
        raise InputError("--sensor", args.sensor, "left out with --lockstep", "The twin's tip has a sensor of its own.")
    if kind not in ("can", "jr3") or (kind == "can" and device):
        raise InputError("--sensor", args.sensor, "can or jr3:DEVICE", "For example jr3:/dev/comedi0.")
    _mount(args.mount)


def options(args: argparse.Namespace, artifact: "Artifact") -> "Options":
    """What the arguments ask for.

    Raises:
        InputError: The reference is malformed, or asks for more than the limits allow.
    """
    from deploy.force import can_sensor, jr3
    from deploy.loop.control import Contacting
    from deploy.loop.options import Options
    from deploy.loop.session import largest_wanted
    from deploy.reference.parse import from_text

    longest = LONGEST * min(1.0, 1e3 * artifact.T_s)
    if args.recorded > longest:
        remedy = f"The controller runs at {1.0 / artifact.T_s:g} Hz, and a recording lies in memory as a whole."
        raise InputError("--recorded", args.recorded, f"in [1, {longest:g}] s", remedy)
    contacting = Contacting(
        approach_speed=1e-3 * args.approach_speed,
        approach_limit=1e-3 * args.approach_limit,
        retract_distance=1e-3 * args.retract,
    )
    kind, _, device = args.sensor.partition(":")
    sensor: ForceSensor
    if kind == "can":
        sensor = can_sensor.CanSensor(T_s=artifact.T_s)
    else:
        sensor = jr3.Jr3(jr3.open_comedi(device or "/dev/comedi0"))
    return Options(
        from_text(args.reference, rate=args.rate, largest=largest_wanted(artifact)),
        rate=args.rate,
        contacting=contacting,
        sensor=sensor,
        lowpass_hz=can_sensor.LOWPASS_HZ if kind == "can" else jr3.LOWPASS_HZ,
        mount=_mount(args.mount),
        turns=args.sensor_frame == "tool",
        tare=not args.no_tare,
        home=args.home,
        hz=args.hz,
        seconds=args.recorded,
    )


def _mount(text: str) -> Any:
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    try:
        roll, pitch, yaw = (radians(float(word)) for word in text.split(","))
        if not isfinite(roll + pitch + yaw):
            raise ValueError
    except ValueError:
        raise InputError("--mount", text, "three angles R,P,Y [deg]", "For example 0,0,90.") from None
    (a, b), (c, d), (e, f) = ((cos(angle), sin(angle)) for angle in (roll, pitch, yaw))
    return (
        (e * c, e * d * b - f * a, e * d * a + f * b),
        (f * c, f * d * b + e * a, f * d * a - e * b),
        (-d, c * b, c * a),
    )
