"""`jaxmpc run`: the frozen controller on the arm, over CAN or against the twin in lock-step."""

import argparse
import hashlib
import logging
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from deploy.cli.run_arguments import HASH, check, configure, options
from jaxmpc.files.errors import InputError
from jaxmpc.files.outputs import check_file

if TYPE_CHECKING:
    from deploy.controller.artifact import Artifact

__all__ = ["configure", "run"]

ACTIVATED = 200
"""Cycles after which the twin's pendant is pressed in lock-step."""
TOLD_EVERY = 10.0
"""Seconds in contact after which a flight against the twin says how far it is."""


def run(args: argparse.Namespace) -> int:
    """Run; 0 if it ended as it was to end, 1 for a stop with any other reason.

    Raises:
        InputError: There is no such artifact, or an option is out of range.
    """
    from deploy.controller.file import ArtifactError, check_kind, from_bytes, read
    from deploy.controller.signature import SignatureError, public_key, require
    from deploy.errors import DeployError
    from deploy.loop.watchdog import WatchdogError

    if not args.artifact.exists():
        remedy = "Make one with `jaxmpc freeze PARAMS --experiment table-1-wam -o FILE`."
        raise InputError("artifact", args.artifact, "an existing file", remedy)
    check_kind(args.artifact)
    check_file("--bus-log", args.bus_log)
    if args.bus_log is not None and args.bus_log.is_file() and args.bus_log.stat().st_size:
        raise InputError(
            "--bus-log", args.bus_log, "a new file", "It exists, and nothing is written over: choose another."
        )
    key = None if args.require_signature is None else public_key(args.require_signature)
    try:
        data = read(args.artifact)
        if key is not None:
            print(f"{args.artifact}: signed by {require(args.artifact, data, key).fingerprint}")
        artifact = from_bytes(data)
    except (ArtifactError, SignatureError) as error:
        print(f"jaxmpc run: refused: {args.artifact}: {error}", file=sys.stderr)
        return 1
    if artifact.arm is None:
        remedy = "Freeze it with an experiment on the arm: `jaxmpc freeze PARAMS --experiment table-1-wam`."
        raise InputError("kind", artifact.kind, "wam: a linear controller only replays", remedy)
    check(args)
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
    from deploy.bus.bus import Bus
    from deploy.bus.candump import BusLog
    from deploy.bus.interface import open_bus
    from deploy.flight.recorder import FlightRecorder
    from deploy.flight.recording_file import RecordingFile
    from deploy.loop.operator import Console, Operator
    from deploy.loop.realtime import MonotonicClock, prepared
    from deploy.loop.session import Session
    from deploy.loop.signals import EndingSignals
    from deploy.loop.watchdog import TIMEOUT_MS, Watchdog, bus_flags
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
        changes = {"turns": False, "hook": clock.twin.force_hook, "lowpass_hz": None}
    else:
        # Who watches the loop does not wait for its processor.
        others = frozenset(os.sched_getaffinity(0) - {args.cpu}) if args.cpu is not None else frozenset()
        # Before any thread is started: each takes over its priority.
        for granted in stack.enter_context(prepared(cpu=args.cpu)):
            print(granted.sentence)
        if getattr(args, "interface", None) == "socketcand":
            args.bus_kwargs = {"tcp_tune": True, **getattr(args, "bus_kwargs", {})}
        clock, bus = MonotonicClock(), open_bus(args)
        timeout_ms = max(TIMEOUT_MS, 3e3 * artifact.T_s)
        watchdog = stack.enter_context(Watchdog(bus_flags(args), timeout_ms, processors=others))
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
    session = Session(artifact, bus, clock, replace(options(args, artifact), **changes), print)
    # In lock-step nobody need arm it, but who names a controller means that one.
    if (args.arm is not None or not args.lockstep) and not _armed(args.arm, digest):
        print("jaxmpc run: not armed; nothing moved", file=sys.stderr)
        return 1
    if not args.lockstep:
        session.unmoved()
    auto = args.lockstep or args.start == "auto"
    keys = _keys(args)
    if not auto:
        print("Enter lets the approach begin" if keys else "the approach begins once the arm is active")
    console = Console()
    ready = auto or not keys
    operator = Operator(console, signals, lambda: session.controller.contact_time, args.duration, ready, keys)
    each: Callable[[Any], Any] = operator.each
    told: Callable[[bool], list[str]] | None = None
    if args.lockstep:
        each, told = _watched(args, clock, session, operator.each, console.say)
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
    from deploy.twin.scenario import twin_settings, unlike_the_simulation
    from deploy.twin.twin import Twin

    world = {"stiffness": args.stiffness, "rhythm": args.rhythm, "seed": args.seed, "faults": tuple(args.fault)}
    clock = LockstepClock(Twin(twin_settings(args.experiment, **world)))
    for sentence in unlike_the_simulation(args.experiment, args.rhythm):
        print(sentence)
    return clock, LockstepBus(clock)


def _watched(
    args: argparse.Namespace, clock: Any, session: Any, each: Callable[[Any], Any], say: Callable[[str], None]
) -> tuple[Callable[[Any], Any], Callable[[bool], list[str]]]:
    """Somebody at the twin's pendant, who activates it once it is armed, and what the twin tells of true forces."""
    from deploy.safety.machine import OperatingState
    from deploy.twin.peak_force import PeakForces
    from deploy.twin.residual import FlownResiduals

    twin, controller = clock.twin, session.controller
    residuals, peaks = FlownResiduals(), PeakForces()
    due = TOLD_EVERY
    clock.every_tick = lambda now: peaks.add_true(now.truth().force)

    def watched(result: Any) -> Any:
        nonlocal due
        now = result.safety_state
        if now.state is OperatingState.ARMED and now.cycles == ACTIVATED:
            twin.press("activate")
        if now.state is OperatingState.CONTACT:
            residuals.add(controller.contact_time, controller.force_ref, result.force, twin.truth().force)
            if controller.contact_time >= due:
                say(f"{due:g} of {args.duration:g} s in contact")
                due += TOLD_EVERY
        peaks.add_measured(result.force)
        return each(result)

    def told(well: bool) -> list[str]:
        limit = session.artifact.arm.limits.force
        guard = _guarded(session.recorder.signals()) if session.artifact.gains.guard else "guard: none"
        return [*residuals.report(), *peaks.report(twin.faults, args.fault, well, twin.now, limit), guard]

    return watched, told


def _guarded(signals: Any) -> str:
    """What a guard did to the gain in the stretch that the recorder holds."""
    gain, time = signals["gain"][:, 0], signals["time"][:, 0]
    known = (gain == gain) & (time == time)
    if not known.any():
        return "guard: no gain was recorded"
    gain, time = gain[known], time[known]
    stretch, lowest = f"in the last {time[-1] - time[0]:.1f} s", gain.argmin()
    if gain[lowest] > 0.99:
        return f"guard: at rest {stretch}, the gain stayed whole"
    return f"guard: lowest gain {stretch} {gain[lowest]:.2f} at {time[lowest]:.1f} s, {gain[-1]:.2f} at the end"


def _keys(args: argparse.Namespace) -> bool:
    """Whether Enter is heard: where nobody need type it, at a terminal alone, for lines of a script are no hand."""
    if args.lockstep or args.reference == "-":
        return False
    return args.start != "auto" or (sys.stdin is not None and sys.stdin.isatty())


def _armed(given: str | None, digest: str) -> bool:
    """Whether the operator names this very controller."""
    if given is None:
        print(f"to arm it, type the first {HASH} characters of its sha256: ", end="", flush=True)
        try:
            given = sys.stdin.readline().strip() if sys.stdin is not None else ""
        except OSError:  # in the background of its terminal, or the terminal is gone
            given = ""
    return len(given) >= HASH and digest.startswith(given.lower())
