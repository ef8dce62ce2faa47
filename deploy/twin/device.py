"""Device on the bus, as all nodes are: numbered values, factory and stored defaults, a monitor to wake from."""

from collections.abc import Mapping

from deploy.puck.properties import Kind, number

RESET, ERROR, READY = 0, 1, 2
"""STAT."""
BOOT_S = 0.2
"""How long a node is silent after it was woken [s] (chosen here; libbarrett waits a second)."""


class Device:
    """Node of the bus; `get` answers None where the real one would not answer.

    Attributes:
        number: Numbers of its properties by name.
        values: What they are, by number.
        groups: Those that it listens to.
    """

    def __init__(self, node: int, kind: Kind, version: int, role: int, values: Mapping[str, int], awake: bool) -> None:
        """Power the node up.

        Args:
            node: Its address.
            kind: As `deploy.puck.properties.number` takes it.
            version: Of the firmware, VERS.
            role: ROLE.
            values: Properties by name with their factory defaults.
            awake: Whether it runs its firmware already, or its monitor.
        """
        common = {"VERS": version, "ROLE": role, "SN": 1000 + node, "ID": node, "ADDR": node, "ERROR": 0, "MODE": 0}
        self.node, self.number = node, {}
        for name in (*common, *values, "STAT", "SAVE", "LOAD", "DEF"):
            self.number[name] = number(name, kind, version)
        named = {self.number[name]: value for name, value in {**common, **values}.items()}
        self._monitor = {self.number[name] for name in ("VERS", "ROLE", "STAT")}
        self.values, self._stored, self._factory = dict(named), dict(named), named
        self.groups = self._groups()
        self.powered, self.stat, self._booted = True, READY if awake else RESET, 0.0

    def answers(self, now: float) -> bool:
        """Whether the node listens to the bus at a time [s]."""
        return self.powered and now >= self._booted

    def get(self, prop: int) -> int | None:
        """Value of a property."""
        if self.stat == RESET and prop not in self._monitor:
            return None
        return self.stat if prop == self.number["STAT"] else self.values.get(prop)

    def set(self, prop: int, value: int, now: float) -> None:
        """Take a value; unknown properties are ignored, as by the real ones."""
        if prop == self.number["STAT"]:
            if value == READY and self.stat == RESET:
                self.stat, self._booted = READY, now + BOOT_S
            elif value == RESET:
                self.reset()
        elif self.stat == RESET:
            return
        elif prop == self.number["SAVE"] and value in self.values:
            self._stored[value] = self.values[value]
        elif prop == self.number["LOAD"] and value in self._stored:
            self.values[value] = self._stored[value]
        elif prop == self.number["DEF"] and value in self._factory:
            self._stored[value] = self._factory[value]
        elif prop in self.values:
            self.values[prop] = value
        self.groups = self._groups()

    def reset(self) -> None:
        """Fall back into the monitor."""
        self.stat, self.values = RESET, dict(self._stored)
        self.groups = self._groups()

    def _groups(self) -> tuple[int, ...]:
        return tuple(self.values[self.number[name]] for name in ("GRPA", "GRPB", "GRPC"))
