"""A motor puck: encoder, torque, modes; idle it shorts its motor."""

import math

from deploy.twin.device import ERROR, READY, Device
from deploy.twin.settings import TwinSettings

VERSION = 200
"""VERS: numbering of the newest firmware."""
ROLE = 0x0100
"""A motor with an absolute magnetic encoder."""
IDLE, TORQUE = 0, 2
"""MODE."""
_TURN = 2.0 * math.pi


class Puck(Device):
    """One of the four; node 1 has PIDX 1 and drives motor 1."""

    def __init__(self, node: int, settings: TwinSettings) -> None:
        values = {
            **{"TEMP": 31, "PTEMP": 33, "OTEMP": 60, "VBUS": 48, "VLOGIC": 48, "IMOTOR": 0, "T": 0, "P": 0, "V": 0},
            **{"GRPA": 0, "GRPB": 1, "GRPC": 4, "MT": int(settings.max_torque[node - 1]), "CTS": settings.counts},
            **{"MV": 100, "MCV": 100, "MOV": 100, "PIDX": node, "IPNM": int(settings.ipnm[node - 1]), "POLES": 12},
            **{"KP": 2000, "KD": 8000, "KI": 0, "IKP": 8192, "IKI": 3276, "IKCOR": 1638, "TSTOP": 0, "MECH": 0},
            **{"JIDX": node, "HOLD": 0, "MOFST": 0, "IOFST": 0, "OT": 0, "CT": 0, "M": 0, "E": 0, "DP": 0, "ACCEL": 0},
        }
        super().__init__(node, "motor", VERSION, ROLE, values, not settings.cold)
        self._offset, self._raw, self._command = 0, 0, 0
        self._lost = settings.cold

    def turned(self, angle: float) -> int:
        """Take the motor's angle [rad]; the encoder's count since the factory's zero."""
        # Half up, as `jaxmpc.world.drive.read` rounds.
        self._raw = math.floor(angle / _TURN * self.values[self.number["CTS"]] + 0.5)
        if self._lost:
            # Within one turn the encoder is absolute, in how many turns it is does not survive.
            self._offset, self._lost = -self._raw + self.mechanical(), False
        return self._raw

    def mechanical(self) -> int:
        """MECH, the absolute angle within one turn [counts]."""
        return self._raw % self.values[self.number["CTS"]]

    def position(self, raw: int) -> int:
        """P for an encoder count [counts]."""
        return raw + self._offset

    @property
    def mode(self) -> int:
        """MODE."""
        return self.values[self.number["MODE"]]

    @property
    def driving(self) -> bool:
        """Whether the puck turns torque commands into torque; else its motor is shorted."""
        return self.powered and self.stat == READY and self.mode == TORQUE

    @property
    def torque(self) -> float:
        """Torque of its motor [N m]."""
        return self._command / self.values[self.number["IPNM"]] if self.driving else 0.0

    def command(self, units: int) -> None:
        """Take a torque [units]; beyond MT it saturates."""
        largest = self.values[self.number["MT"]]
        self._command = max(-largest, min(units, largest)) if self.driving else 0

    def get(self, prop: int) -> int | None:
        """As `Device.get`; P is asked for by `position`."""
        if self.stat != 0 and prop == self.number["MECH"]:
            return self.mechanical()
        if self.stat != 0 and prop == self.number["T"]:
            return self._command
        return super().get(prop)

    def set(self, prop: int, value: int, now: float) -> None:
        """As `Device.set`."""
        if prop == self.number["P"] and self.stat != 0:
            self._offset = value - self._raw
        elif prop == self.number["T"]:
            self.command(value)
        elif prop == self.number["MODE"] and self.stat == ERROR:
            return
        else:
            super().set(prop, value, now)
            if prop == self.number["MODE"]:
                self._command = 0

    def fail(self, code: int) -> None:
        """Begin an error: the puck falls idle until it is reset."""
        self.values[self.number["ERROR"]], self.values[self.number["MODE"]] = code, IDLE
        self.stat, self._command = ERROR, 0

    def reset(self) -> None:
        """As `Device.reset`; in which turn the motor is, it does not know afterwards."""
        super().reset()
        self._command, self._lost = 0, True
