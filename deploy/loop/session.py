"""A run from the closed box to the arm that is let go: start, tare, cycle, record.

    start-up ─► posture ─► tare ─► `Loop` ─► recording

Whoever calls this has opened the bus and read the artifact, and closes the bus again.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deploy.bus.bus import Bus
from deploy.controller.artifact import Artifact
from deploy.controller.runtimes import arm_runtime, flown_controller
from deploy.errors import BusError, CalibrationError
from deploy.flight.recorder import FlightRecorder
from deploy.flight.recording_file import RecordingFile, Saved
from deploy.force.sensor import Mounted, mean_force
from deploy.loop.control import TaskController
from deploy.loop.cycle import JOINTS, Cycle, CycleResult, OperatorCommand
from deploy.loop.loop import REASONS, STATES, Loop, RunResult, Watching
from deploy.loop.options import Options
from deploy.loop.statistics import Statistics
from deploy.safety.clamp import Clamp
from deploy.safety.force_estimate import ForceEstimate
from deploy.safety.machine import SafetyState
from deploy.safety.posture import displaced
from deploy.safety.puck_caps import within_caps
from deploy.wam.arm import WamArm
from deploy.wam.dialogue import Clock, Dialogue
from deploy.wam.startup import OTHERS, startup
from deploy.wam.tip_pose import tip_kinematics
from jaxmpc.files.errors import InputError

WANTED = 0.8
"""Largest wanted force over the limit of the measured one [-]."""
HEART = 0.025
"""Way of heart and lungs together, from top to bottom [m]; those of the twin have 14 mm."""
TARING = 1.3
"""Patience for the sensor's own tare [s], which takes about one."""
CHECKED = 200
"""Samples that are read after it."""
STILL = 0.2
"""Mean force that a tared sensor in the air may still read [N]: 0.3 N on the way down are a contact."""


class Session:
    """A started arm with its controller.

    Attributes:
        controller: Of the torques.
        recorder: The last seconds.
    """

    def __init__(
        self, artifact: Artifact, bus: Bus, clock: Clock, options: Options, report: Callable[[str], None]
    ) -> None:
        """Start the arm; nothing moves.

        Args:
            artifact: Of the kind "wam".
            bus: Opened, with the clock's stamps.
            clock: Real, or that of a twin.
            options: How it is run.
            report: Takes what happens, in sentences.

        Raises:
            InputError: The artifact drives no arm, or not at this rate.
            BusError: The arm does not answer as it must.
            CalibrationError: It says what cannot be right, gives too little torque, stands elsewhere, or the sensor is
                not still.
        """
        runtime = arm_runtime(artifact)
        model = artifact.arm
        assert model is not None
        if options.hz is not None and not abs(options.hz * artifact.T_s - 1.0) <= 1e-9:
            remedy = "Freeze a controller for that rate: its gains hold for no other."
            raise InputError("rate", f"{options.hz:g} Hz", f"{1.0 / artifact.T_s:g} Hz, the controller's own", remedy)
        self.artifact, self._clock, self._options = artifact, clock, options
        sensor = Mounted(options.sensor, options.mount)
        self.arm = startup(bus, clock, sensor, home=options.home, report=report, T_s=artifact.T_s)
        limits, less = within_caps(model.limits, self.arm.pucks.caps)
        for said in (less, other_lowpass(artifact, options.lowpass_hz)):
            if said:
                report(said)
        if where := displaced(self.arm.pucks.angles(self.arm.counts), model.posture):
            raise CalibrationError(f"{where}: carry the arm there by hand, idle, then start again")
        if options.tare:
            _tare(self.arm, clock, artifact.T_s)
            report("force sensor tared")
        ahead = len(artifact.gains.mpc_ref) if artifact.preview else 0
        stream = {"rate": options.rate, "largest": largest_wanted(artifact)}
        self.controller = TaskController(runtime, options.source, artifact.T_s, options.contacting, ahead, **stream)
        self.cycle = Cycle(
            self.arm,
            self.controller,
            limits,
            artifact.T_s,
            model.tool_length,
            tip_kinematics(model.chain),
            options.turns,
            options.hook,
            ForceEstimate(model, flown_controller(artifact)[0].measurement),
            deepest(artifact),
            model.posture,
        )
        self._hosts = bus.counters.hosts
        self.recorder = FlightRecorder(seconds=options.seconds, rate=1.0 / artifact.T_s)
        self.statistics = Statistics(round(1e9 * artifact.T_s))

    def unmoved(self) -> None:
        """See, after a pause, that the arm still stands where it was started; nothing moves.

        Raises:
            BusError: A puck does not tell its position any more, or somebody else has begun to command.
            CalibrationError: The arm was moved, or its encoders have forgotten where it is.
        """
        self._alone()
        arm = self.arm
        if (moved := arm.moved(Dialogue(arm.bus, self._clock))) is not None:
            said = f"{JOINTS[moved]} has moved since the arm was started, or its encoder has forgotten its position"
            raise CalibrationError(f"{said}: let nobody touch the arm while the controller is named, then start again")

    def run(
        self, command: OperatorCommand, watchdog: Watching | None, each: Callable[[CycleResult], OperatorCommand]
    ) -> RunResult:
        """Cycle until the arm has been let go.

        Args:
            command: First command of the operator.
            watchdog: Standing by; None only where time is simulated.
            each: Takes the result of every cycle, returns the operator's next command.

        Raises:
            BusError: Somebody else has begun to command while the operator was waited for; nothing was sent.
        """
        self._alone()
        period = round(1e9 * self.artifact.T_s)
        loop = Loop(self.cycle, self._clock, period, self.recorder, watchdog, each, self._options.log)
        self.statistics = loop.statistics
        return loop.run(command)

    def _alone(self) -> None:
        bus = self.arm.bus
        bus.flush()
        if bus.counters.hosts > self._hosts:
            raise BusError(f"{OTHERS}; nothing was sent")

    def save(self, file: RecordingFile, digest: str, safety_state: SafetyState) -> Saved:
        """Write the flight recording into its file, and say what became of it; it never raises.

        Args:
            file: Opened before the arm moved.
            digest: sha256 of the controller.
            safety_state: State in which the run ended.
        """
        try:
            data = self.recorder.sealed(self._header(digest, safety_state))
        except (TypeError, ValueError, MemoryError) as error:
            return Saved(False, f"flight recording: LOST, for it could not be sealed: {error}")
        saved = file.save(data)
        return Saved(saved.ok, f"flight recording: {len(self.recorder)} samples in {saved.sentence}")

    def write(self, path: Path, digest: str, safety_state: SafetyState) -> str:
        """Write the flight recording; a sentence on what became of it.

        Args:
            path: File to write.
            digest: sha256 of the controller.
            safety_state: State in which the run ended.
        """
        return self.recorder.write(path, self._header(digest, safety_state))

    def _header(self, digest: str, safety_state: SafetyState) -> dict[str, Any]:
        return {
            "artifact": digest,
            "reason": str(safety_state.reason),
            "detail": safety_state.detail,
            "T_s": self.artifact.T_s,
            "names": {
                "state": list(map(str, STATES)),
                "reason": list(map(str, REASONS)),
                "clamped": list(Clamp._fields),
            },
        }

    def notes(self) -> list[str]:
        """Notes on what was counted besides cycles."""
        arm, counters = self.arm, self.arm.bus.counters
        bus = f"bus: {counters.sent} frames sent, {counters.received} received, {counters.foreign} foreign"
        bus += f", {counters.malformed + arm.malformed} malformed, {counters.send_errors} refused"
        bus += f", {arm.bus.count_dropped()} dropped unread"
        lost = f"positions: {arm.late} late, {arm.duplicates} twice, {arm.doubtful} doubtful, {arm.jumps} jumps"
        return [bus, lost, f"largest push in contact and on the way out: {self.cycle.pushes}", *self.controller.notes()]


def other_lowpass(artifact: Artifact, sensor_hz: float | None) -> str:
    """What is to be said where the sensor's low-pass is not the one that the margins hold with; empty if it is.

    Args:
        artifact: Of the controller.
        sensor_hz: Low-pass of the sensor [Hz]; None is not known.
    """
    judged = artifact.loop.sensor_cutoff / (2.0 * math.pi)
    if sensor_hz is None or abs(judged - sensor_hz) <= 0.02 * sensor_hz:
        return ""
    held = f"a low-pass of {judged:g} Hz in the force sensor" if judged else "no low-pass in the force sensor"
    remedy = f"freeze it with sensor.lowpass_hz = {sensor_hz:g} in its experiment, and see what margins are left"
    return f"OTHER MARGINS: those of this controller hold with {held}, and this kind has {sensor_hz:g} Hz: {remedy}"


def largest_wanted(artifact: Artifact) -> float:
    """Largest force that may be wanted [N]: what is measured must have room to sway below its limit."""
    assert artifact.arm is not None
    return WANTED * artifact.arm.limits.force


def deepest(artifact: Artifact) -> float:
    """How far the tip may go down in contact [m]: the softest promised tissue at the limit, and a heart's way."""
    assert artifact.arm is not None
    return float(artifact.arm.limits.force / min(row["stiffness"] for row in artifact.margins) + HEART)


def _tare(arm: WamArm, clock: Clock, T_s: float) -> None:
    """Call the force in the air zero, and see that it then is.

    Raises:
        CalibrationError: It is not, or the sensor gives nothing sound.
    """
    for frame in arm.sensor.tare():
        arm.bus.send(frame)
    clock.wait_until(clock.now() + round(1e9 * TARING))
    period, taken = round(1e9 * T_s), []
    for _ in range(CHECKED):
        deadline = clock.now() + period
        for frame in arm.sensor.request():
            arm.bus.send(frame)
        while not arm.sensor.ready and (left := deadline - clock.now()) > 0:
            if (got := arm.bus.receive(left * 1e-9)) is None:
                break
            arm.sensor.feed(got[0])
        if (wrench := arm.sensor.read()) is not None:
            taken.append(wrench)
        clock.wait_until(deadline)
    force = mean_force(taken)
    if not math.hypot(*force) <= STILL:
        x, y, z = force
        raise CalibrationError(f"the tared force sensor reads {x:.2f}, {y:.2f}, {z:.2f} N: let nothing touch the tool")
