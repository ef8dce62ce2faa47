"""How a frozen controller is run, apart from the controller itself."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import IDENTITY, ForceSensor
from deploy.loop.control import Contacting
from deploy.reference.sources import Source
from jaxmpc.law.scalar import Matrix


@dataclass(frozen=True)
class Options:
    """Options of a run.

    Attributes:
        source: Wanted force on the tissue since contact.
        rate: Largest rate of the wanted force [N/s].
        contacting: How the tissue is met and left.
        sensor: Of the force.
        lowpass_hz: Of that sensor [Hz]; None is not known, as a twin's.
        mount: Rotation from the sensor's axes to the tool's, or to the world's if it does not turn.
        turns: Whether the sensor turns with the tool.
        tare: Whether it is tared at the start.
        home: The operator says that the arm stands at home.
        hz: Rate that is asked for; None is the controller's own.
        seconds: Length of the flight recorder [s].
        hook: What becomes of a force on its way; see `Cycle`.
        log: Takes every torque frame that is sent.
    """

    source: Source
    rate: float = 5.0
    contacting: Contacting = field(default_factory=Contacting)
    sensor: ForceSensor = field(default_factory=CanSensor)
    lowpass_hz: float | None = None
    mount: Matrix = IDENTITY
    turns: bool = True
    tare: bool = True
    home: bool = False
    hz: float | None = None
    seconds: float = 10.0
    hook: Callable[[Any], Any] | None = None
    log: Callable[..., None] | None = None
