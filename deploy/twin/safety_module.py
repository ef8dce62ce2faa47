"""The safety module, node 10: modes, pendant, limits of speed and torque, heartbeat.

It alone activates, and only by its pendant: then it sets the pucks' MODE itself, in a broadcast from node 10 to group
0 (0x540; the real one's contents are unpublished, hosts must ignore it). It listens to torques and positions on the
bus. A speed or torque above its fault level, or a silent bus, makes it idle; if the arm is then still too fast half a
second later, it cuts the power.
"""

import math
from collections import deque
from collections.abc import Sequence

from deploy.twin.compiled import joint_angles
from deploy.twin.device import Device
from deploy.twin.settings import TwinSettings
from jaxmpc.files.errors import InputError, nearest

VERSION = 200
ESTOP, IDLE, ACTIVE = 0, 1, 2
"""MODE."""
BUTTONS = ("activate", "idle", "e-stop")
SAFE, WARNING, FAULT = 0b001, 0b010, 0b100
WORDS = ("velocity", "torque", "voltage", "heartbeat", "other")
ELBOW, BEYOND = 0.55, 0.35
"""Points whose speed it watches: the elbow from the shoulder, and one beyond the elbow [m]."""
HISTORY = 5
"""Velocities that it averages."""
STILL_TOO_FAST_S = 0.5
_BUTTON_BITS = {"none": 0b11, "idle": 0b10, "activate": 0b01, "e-stop": 0b00}
_PRESSED_S = 0.2
_DIGITS = (0x3F, 0x06, 0x5B, 0x4F, 0x66, 0x6D)


class SafetyModule(Device):
    """The board with its pendant."""

    def __init__(self, settings: TwinSettings) -> None:
        values = {
            **{"ZERO": 0 if settings.cold else 1, "PEN": 0, "SAFE": 0, "VL1": 2048, "VL2": 4096, "TL1": 4731},
            **{"TL2": 5204, "VOLTL1": 36, "VOLTL2": 30, "VOLTH1": 54, "VOLTH2": 57, "PWR": 30, "MAXPWR": 600},
            **{"IFAULT": 0, "VNOM": 48, "GRPA": 1, "GRPB": 2, "GRPC": 3, "TEMP": 30},
        }
        super().__init__(10, "safety", VERSION, 2, values, True)
        self.values[self.number["MODE"]] = IDLE
        self._count = 2.0 * math.pi / settings.counts
        self._heartbeat = settings.heartbeat_s
        self._words = dict.fromkeys(WORDS, SAFE)
        self._button, self._released = "none", 0.0
        self._heard: dict[int, int] = {}
        self._angles: tuple[float, tuple[float, ...]] | None = None
        self._speeds: deque[float] = deque([0.0] * HISTORY, HISTORY)
        self._torque_at = self._position_at = -math.inf
        self._idled: float | None = None  # when it made the arm idle, until it has looked again

    @property
    def mode(self) -> int:
        """MODE."""
        return self.values[self.number["MODE"]]

    def words(self) -> dict[str, int]:
        """State of each word: `SAFE`, `WARNING` or `FAULT`."""
        return dict(self._words)

    def press(self, button: str, now: float) -> None:
        """Press a button of the pendant ("activate" with Shift, "idle" with Shift, "e-stop" latches until "idle").

        Raises:
            InputError: There is no such button.
        """
        if button not in BUTTONS:
            raise InputError("button", button, "on the pendant", nearest(button, list(BUTTONS)))
        self._button, self._released = button, now + _PRESSED_S
        if button == "e-stop":
            self._go(ESTOP, now)
        elif button == "idle":
            self._words = dict.fromkeys(WORDS, SAFE)
            self._go(IDLE, now)
        elif self.mode == IDLE:
            self._words = dict.fromkeys(WORDS, SAFE)
            # Whoever is to be heard has the usual time from now on.
            self._torque_at = self._position_at = now
            self._go(ACTIVE, now)

    def get(self, prop: int) -> int | None:
        """As `Device.get`."""
        if prop == self.number["PEN"]:
            return self._pendant()
        return super().get(prop)

    def set(self, prop: int, value: int, now: float) -> None:
        """As `Device.set`, but that software can only lower MODE and not press buttons."""
        if prop == self.number["MODE"]:
            if value < self.mode:
                self._go(max(value, ESTOP), now)
        elif prop != self.number["PEN"]:
            super().set(prop, value, now)

    def heard_torques(self, units: Sequence[int], now: float) -> None:
        """Take a packed torque frame that went by [units]."""
        self._torque_at = now
        largest = max(map(abs, units))
        warning, fault = (self.values[self.number[name]] for name in ("TL1", "TL2"))
        if fault and largest > fault:
            self._fault("torque", now)
        elif (largest > warning or not largest) and self._words["torque"] != FAULT:
            self._words["torque"] = WARNING if largest else SAFE

    def heard_position(self, node: int, counts: int, now: float) -> None:
        """Take a puck's position that went by; with the last of the four comes a velocity [counts]."""
        self._position_at = now
        self._heard[node] = counts
        if len(self._heard) == 4:
            angles = joint_angles(tuple(self._count * self._heard[node] for node in (1, 2, 3, 4)))
            if self._angles is not None and now > self._angles[0]:
                self._judge(angles, now)
            self._heard, self._angles = {}, (now, angles)

    def advance(self, now: float) -> None:
        """Look at the clock."""
        if now >= self._released and self._button != "e-stop":
            self._button = "none"
        if self.mode == ACTIVE and now - min(self._torque_at, self._position_at) > self._heartbeat:
            self._fault("heartbeat", now)
        if self._idled is not None and now - self._idled >= STILL_TOO_FAST_S:
            self._idled = None
            fault = self.values[self.number["VL2"]] / 4096.0
            if fault and self._speed() > fault:
                self._go(ESTOP, now)

    def _judge(self, angles: tuple[float, ...], now: float) -> None:
        assert self._angles is not None
        before, last = self._angles
        v = [(new - old) / (now - before) for new, old in zip(angles, last, strict=True)]
        if self.values[self.number["IFAULT"]] > 0:
            self.values[self.number["IFAULT"]] -= 1
            v = [0.0] * 4
        elbow = ELBOW * math.hypot(v[1], math.sin(angles[1]) * v[0])
        # Not homed, it does not know the arm's posture, and joints count as if they were a metre long.
        homed = self.values[self.number["ZERO"]] == 1
        self._speeds.append(elbow + BEYOND * abs(v[3]) if homed else max(map(abs, v)))
        warning, fault = (self.values[self.number[name]] / 4096.0 for name in ("VL1", "VL2"))
        if fault and self._speed() > fault and self.mode == ACTIVE:
            self._fault("velocity", now)
        elif self._words["velocity"] != FAULT:
            self._words["velocity"] = WARNING if self._speed() > warning else SAFE

    def _speed(self) -> float:
        return sum(self._speeds) / HISTORY

    def _fault(self, word: str, now: float) -> None:
        self._words[word] = FAULT
        if self.mode == ACTIVE:
            self._idled = now
            self._go(IDLE, now)

    def _go(self, mode: int, now: float) -> None:
        self.values[self.number["MODE"]] = mode

    def _pendant(self) -> int:
        """PEN: button, lights, digit, five words."""
        mode = self.mode
        bits = _BUTTON_BITS[self._button] << 26 | (mode == ACTIVE) << 25 | (mode == IDLE) << 24
        worst = next((i + 1 for i, word in enumerate(WORDS) if self._words[word] == FAULT), 0)
        bits |= (0x79 if mode == ESTOP else _DIGITS[worst]) << 16
        for i, word in enumerate(WORDS):
            bits |= self._words[word] << 3 * i
        return bits
