"""`jaxmpc run`: the frozen controller on the arm, over CAN or against the twin in lock-step."""

import argparse
import hashlib
import logging
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from math import cos, isfinite, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmpc.files.errors import InputError
from jaxmpc.files.outputs import check_file

if TYPE_CHECKING:
    from deploy.controller.artifact import Artifact
    from deploy.loop.session import Options

HASH = 8
"""Characters of the controller's sha256 that arm it."""
ACTIVATED = 200
"""Cycles after which the twin's pendant is pressed in lock-step."""
LONGEST = 50.0
"""Longest recording that can be read again [s]."""
CONTACTS = {"approach_speed": (0.1, 50.0), "approach_limit": (1.0, 200.0), "retract": (1.0, 200.0)}
"""Bounds [mm/s], [mm], [mm]."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    from deploy.bus.bus import add_arguments

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
    machine.add_argument("--recorded", type=float, default=10.0, metavar="S", help="how much of the end is kept (10)")
    machine.add_argument("--bus-log", type=Path, metavar="FILE.log", help="the torque frames, as candump logs them")
    twin = parser.add_argument_group("a twin instead of a bus (needs mujoco)")
    twin.add_argument("--lockstep", action="store_true", help="run against a twin in this process, in its own time")
    twin.add_argument("--experiment", help="its tissue, heart and arm: a TOML file, or a published experiment")
    twin.add_argument("--stiffness", type=float, metavar="N/M", help="of its tissue (810, or the experiment's)")
    twin.add_argument("--rhythm", help="of its heart, or a recording: heart.csv, heart.csv:mm (the experiment's)")
    twin.add_argument(
        "--fault", action="append", default=[], metavar="FAULT", help="as of `jaxmpc twin`, again for more"
    )
    twin.add_argument("--seed", type=int, default=0, help="of its noise and faults (0)")
    add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run; 0 if it ended as it was to end, 1 for a stop with any other reason.

    Raises:
        InputError: There is no such artifact, or an option is out of range.
    """
    from deploy.controller.file import ArtifactError, check_kind, from_bytes, read
    from deploy.errors import DeployError
    from deploy.loop.watchdog import WatchdogError

    if not args.artifact.exists():
        remedy = "Make one with `jaxmpc freeze PARAMS --experiment table-1-wam -o FILE`."
        raise InputError("artifact", args.artifact, "an existing file", remedy)
    check_kind(args.artifact)
    check_file("--bus-log", args.bus_log)
    try:
        data = read(args.artifact)
        artifact = from_bytes(data)
    except ArtifactError as error:
        print(f"jaxmpc run: refused: {args.artifact}: {error}", file=sys.stderr)
        return 1
    if artifact.arm is None:
        remedy = "Freeze it with an experiment on the arm: `jaxmpc freeze PARAMS --experiment table-1-wam`."
        raise InputError("kind", artifact.kind, "wam: a linear controller only replays", remedy)
    _check(args)
    digest = hashlib.sha256(data).hexdigest()
    print(f"{args.artifact}: sha256 {digest}")
    logging.getLogger("can").setLevel(logging.ERROR)  # socketcand's client warns of every frame that comes in two parts
    try:
        with ExitStack() as stack:
            return _fly(args, artifact, digest, stack)
    except (DeployError, WatchdogError) as error:
        print(f"jaxmpc run: {error}", file=sys.stderr)
        return 1


def _fly(args: argparse.Namespace, artifact: "Artifact", digest: str, stack: ExitStack) -> int:
    from deploy.bus.bus import Bus, open_bus
    from deploy.bus.candump import BusLog
    from deploy.flight.recorder import FlightRecorder
    from deploy.flight.recording_file import RecordingFile
    from deploy.loop.operator import Console, Operator
    from deploy.loop.realtime import MonotonicClock, prepared
    from deploy.loop.session import Session
    from deploy.loop.signals import EndingSignals
    from deploy.loop.watchdog import Watchdog, bus_flags
    from deploy.safety.machine import OperatingState, SafetyState
    from deploy.safety.reasons import Reason

    signals = stack.enter_context(EndingSignals())
    # Before anything else is touched: what cannot be recorded is not flown.
    file = RecordingFile(args.output, FlightRecorder.largest(args.recorded, 1.0 / artifact.T_s))
    stack.callback(file.close)
    clock: Any
    changes: dict[str, Any] = {}
    if args.lockstep:
        clock, made = _twin(args)
        bus, watchdog = Bus(made, clock.now), None
        changes = {"turns": False, "hook": clock.twin.force_hook}
    else:
        # Before any thread is started: each takes over its priority.
        for granted in stack.enter_context(prepared(cpu=args.cpu)):
            print(granted.sentence)
        if getattr(args, "interface", None) == "socketcand":
            args.bus_kwargs = {"tcp_tune": True, **getattr(args, "bus_kwargs", {})}
        clock, bus = MonotonicClock(), open_bus(args)
        watchdog = stack.enter_context(Watchdog(bus_flags(args)))
    stack.callback(bus.close)
    log = None
    if args.bus_log is not None:
        try:
            log = BusLog(args.bus_log)
        except OSError as error:
            bound = f"a file that can be written ({error.strerror})"
            raise InputError("--bus-log", args.bus_log, bound, "Choose another one.") from None
        stack.callback(log.close)
        changes["log"] = log.add
    session = Session(artifact, bus, clock, replace(_options(args, artifact), **changes), print)
    # In lock-step nobody need arm it, but who names a controller means that one.
    if (args.arm is not None or not args.lockstep) and not _armed(args.arm, digest):
        print("jaxmpc run: not armed; nothing moved", file=sys.stderr)
        return 1
    auto = args.lockstep or args.start == "auto"
    keys = not auto and args.reference != "-"
    if not auto:
        print("Enter lets the approach begin" if keys else "the approach begins once the arm is active")
    console = Console()
    ready = auto or not keys
    operator = Operator(console, signals, lambda: session.controller.contact_time, args.duration, ready, keys)
    each: Callable[[Any], Any] = operator.each
    told: Callable[[bool], list[str]] | None = None
    if args.lockstep:
        each, told = _watched(args, clock, session, operator.each)
    signals.begin()
    try:
        ended = session.run(operator.command, watchdog, each)
    except BaseException:
        failed = session.save(file, digest, SafetyState(OperatingState.FAULT, Reason.ERROR))
        console.close()
        print(failed.sentence)
        raise
    # Before anything is printed: who reads may be gone, or as slow as he likes.
    saved = session.save(file, digest, ended.safety_state) if args.record or not ended.well else None
    console.close()
    # The twin's own time is never late; how long this computer took for it says nothing.
    print(session.statistics.report(lockstep=args.lockstep))
    print("\n".join([*session.notes(), *(told(ended.well) if told else [])]))
    if log is not None:
        print(log.close())
    if saved is not None:
        print(saved.sentence)
    print(f"ended: {ended.safety_state.state}, {ended.safety_state.reason} {ended.safety_state.detail}".rstrip())
    kept = (saved is None or saved.ok) and (log is None or log.complete)
    if not kept:
        print("jaxmpc run: what was to be recorded is not where it was to be; see above", file=sys.stderr)
    return 0 if ended.well and kept else 1


def _twin(args: argparse.Namespace) -> tuple[Any, Any]:
    """A twin's clock and bus."""
    from deploy.twin.lockstep import LockstepBus, LockstepClock
    from deploy.twin.scenario import twin_settings
    from deploy.twin.twin import Twin

    world = {"stiffness": args.stiffness, "rhythm": args.rhythm, "seed": args.seed, "faults": tuple(args.fault)}
    clock = LockstepClock(Twin(twin_settings(args.experiment, **world)))
    return clock, LockstepBus(clock)


def _watched(
    args: argparse.Namespace, clock: Any, session: Any, each: Callable[[Any], Any]
) -> tuple[Callable[[Any], Any], Callable[[bool], list[str]]]:
    """Somebody at the twin's pendant, who activates it once it is armed, and what the twin tells of true forces."""
    from deploy.safety.machine import OperatingState
    from deploy.twin.peak_force import PeakForces
    from deploy.twin.residual import FlownResiduals

    twin, controller = clock.twin, session.controller
    residuals, peaks = FlownResiduals(), PeakForces()
    clock.every_tick = lambda now: peaks.add_true(now.truth().force)

    def watched(result: Any) -> Any:
        now = result.safety_state
        if now.state is OperatingState.ARMED and now.cycles == ACTIVATED:
            twin.press("activate")
        if now.state is OperatingState.CONTACT:
            residuals.add(controller.contact_time, controller.force_ref, result.force, twin.truth().force)
        peaks.add_measured(result.force)
        return each(result)

    def told(well: bool) -> list[str]:
        limit = session.artifact.arm.limits.force
        guard = _guarded(session.recorder.signals())
        return [*residuals.report(), *peaks.report(twin.faults, args.fault, well, twin.now, limit), guard]

    return watched, told


def _guarded(signals: Any) -> str:
    """What a guard did to the gain in the stretch that the recorder holds."""
    gain, time = signals["gain"][:, 0], signals["time"][:, 0]
    known = gain == gain
    if not known.any() or gain[known].min() > 0.99:
        return "guard: at rest, the gain stayed whole"
    lowest = gain[known].argmin()
    return (
        f"guard: lowest gain {gain[known][lowest]:.2f} at {time[known][lowest]:.1f} s, {gain[known][-1]:.2f} at the end"
    )


def _armed(given: str | None, digest: str) -> bool:
    """Whether the operator names this very controller."""
    if given is None:
        print(f"to arm it, type the first {HASH} characters of its sha256: ", end="", flush=True)
        given = sys.stdin.readline().strip()
    return len(given) >= HASH and digest.startswith(given.lower())


def _check(args: argparse.Namespace) -> None:
    """Refuse what no run can be asked for.

    Raises:
        InputError: An argument is out of range.
    """
    for name, (low, high) in CONTACTS.items():
        if not low <= getattr(args, name) <= high:
            bound = f"in [{low:g}, {high:g}]"
            raise InputError(
                f"--{name.replace('_', '-')}", getattr(args, name), bound, "The tissue is soft: go slowly."
            )
    if not 0.0 < args.duration <= 86400.0:
        raise InputError("--duration", args.duration, "in (0, 86400] s", "Ctrl-C ends a run at any time.")
    if not 0.0 < args.rate <= 100.0:
        raise InputError("--rate", args.rate, "in (0, 100] N/s", "The paper's fastest reference has 12.6.")
    if not 1.0 <= args.recorded <= LONGEST:
        raise InputError(
            "--recorded", args.recorded, f"in [1, {LONGEST:g}] s", "A recording lies in memory as a whole."
        )
    if args.sensor.partition(":")[0] not in ("can", "jr3"):
        raise InputError("--sensor", args.sensor, "can or jr3:DEVICE", "For example jr3:/dev/comedi0.")
    _mount(args.mount)


def _options(args: argparse.Namespace, artifact: "Artifact") -> "Options":
    """What the arguments ask for.

    Raises:
        InputError: The reference is malformed, or asks for more than the limits allow.
    """
    from deploy.force.can_sensor import CanSensor
    from deploy.force.jr3 import Jr3, open_comedi
    from deploy.loop.control import Contacting
    from deploy.loop.session import Options, largest_wanted
    from deploy.reference.parse import from_text

    contacting = Contacting(
        approach_speed=1e-3 * args.approach_speed,
        approach_limit=1e-3 * args.approach_limit,
        retract_distance=1e-3 * args.retract,
    )
    kind, _, device = args.sensor.partition(":")
    return Options(
        from_text(args.reference, rate=args.rate, largest=largest_wanted(artifact)),
        rate=args.rate,
        contacting=contacting,
        sensor=CanSensor() if kind == "can" else Jr3(open_comedi(device or "/dev/comedi0")),
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
