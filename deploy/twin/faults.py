"""Faults on request, in words: TARGET:WORD[=VALUE][@START[+DURATION]], times in seconds.

Sensors, `force` and the encoders `J1` to `J4` (those of motors 1 to 4, of which J2 and J3 share two), in PX4's words:

    off                     no reading at all
    stuck                   the reading of the first moment, for ever
    garbage                 any number
    wrong[=v]               off by v all the time: 2 N on Z, or 200 counts
    slow[=ms]               a new reading only every 10 ms
    delayed[=ms]            each reading 20 ms old
    intermittent[=p]        each reading missing with probability 0.5
    sign, unit[=factor]     negated; times 1000, a slip of the unit
    jump[=v]                as wrong, from one sample to the next by 10 N, or one turn of 4096 counts
    nan, inf, -inf          `force` only

A CAN sensor cannot send NaN or infinity: its frames are integers. Those three words reach the force where a program
makes it a float: whoever tests a controller puts `Twin.force_hook` between its sensor and it. All other words are in
the frames.

Frames, of `frames` (all to the host), `positions`, `force`, `J1` to `J4`, or `commands` (all from the host):

    lost=p                  with probability p < 1, or the next p ≥ 1 of them
    late[=ms]               2 ms late
    duplicated[=p]          sent twice, always or with probability p

And `puck1` to `puck4`: fault (idle, and says so), mute (idle, and says nothing), off (silent), reset; `pendant`:
activate, idle, e-stop: all of them instants, without a duration; `bus`: off, babble[=frames per second of foreign
identifiers]. A value where a word takes none is refused, lest it be thought to act.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxmpc.files.errors import InputError, nearest

_SENSOR = {
    "off": None,
    "stuck": None,
    "garbage": None,
    "wrong": (2.0, 200.0),
    "slow": (10.0, 10.0),
    "delayed": (20.0, 20.0),
    "intermittent": (0.5, 0.5),
    "sign": None,
    "unit": (1000.0, 1000.0),
    "jump": (10.0, 4096.0),
}
"""Words of sensors, with the value of the force and of an encoder when none is given."""
_FRAMES = {"lost": math.nan, "late": 2.0, "duplicated": 1.0}
_PLAIN = {**_FRAMES, "babble": 8000.0}
"""Usual values of words that are no sensor's."""
_NOT_NEGATIVE = ("lost", "duplicated", "intermittent", "babble", "slow", "delayed", "late")
NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_OTHERS = {
    "puck": ("fault", "mute", "off", "reset"),
    "pendant": ("activate", "idle", "e-stop"),
    "bus": ("off", "babble"),
}
ENCODERS = ("J1", "J2", "J3", "J4")
WORDS: dict[str, tuple[str, ...]] = {
    "force": (*_SENSOR, *NOT_FINITE, *_FRAMES),
    **{joint: (*_SENSOR, *_FRAMES) for joint in ENCODERS},
    **{link: tuple(_FRAMES) for link in ("frames", "positions", "commands")},
    **{f"puck{node}": _OTHERS["puck"] for node in (1, 2, 3, 4)},
    "pendant": _OTHERS["pendant"],
    "bus": _OTHERS["bus"],
}
"""Words of each target."""
_FORM = "TARGET:WORD[=VALUE][@START[+DURATION]]"
_LARGEST = {"force": 100.0, "encoder": 2.0**20}
HUGE = 1e9
"""Size of a value beyond which none makes another fault: no frame of a sensor holds a tenth of it."""
FULL = 20_000.0
"""Frames of a second that no bus of 1 Mbit/s can carry, if each has eight bytes, as these have [1/s]."""
_SOON = 1e-9
"""Times are sums of milliseconds [s]."""


@dataclass(frozen=True)
class Fault:
    """Fault of a device, a sensor or the bus, from its start for its duration."""

    target: str
    word: str
    value: float
    start: float = 0.0
    """[s]"""
    duration: float = math.inf
    """[s]"""

    def active(self, now: float) -> bool:
        """Whether the fault lasts at a time [s]."""
        return self.start - _SOON <= now < self.start + self.duration - _SOON

    @property
    def is_event(self) -> bool:
        """Whether the fault is an instant of the pendant or a puck."""
        return self.target == "pendant" or self.target.startswith("puck")


def parse(text: str) -> Fault:
    """A fault from its text, as "force:stuck@12.0" or "J2:off@3+0.1".

    Raises:
        InputError: A word, a number or the form is wrong.
    """
    what, at, when = text.partition("@")
    target, colon, rest = what.partition(":")
    word, equals, value = rest.partition("=")
    if not colon:
        raise InputError("fault", text, f"of the form {_FORM}", nearest(target, list(WORDS)))
    if target not in WORDS:
        raise InputError("fault", text, "about a target there is", nearest(target, list(WORDS)))
    if word not in WORDS[target]:
        raise InputError("fault", text, f"a word of {target}", nearest(word, list(WORDS[target])))
    start, plus, duration = when.partition("+")
    if equals and _usual(word, target) is None:
        raise InputError("fault", text, "without a value", f"{word} takes none: leave ={value} out.")
    number = _number(text, value, "its value") if equals else _usual(word, target)
    if number is None:
        number = math.nan
    elif math.isnan(number):
        raise InputError("fault", text, "with a value", "As lost=0.001 (probability) or lost=3 (the next three).")
    if word in _NOT_NEGATIVE and number < 0.0:
        raise InputError("fault", text, "with a value of 0 or more", f"The form is {_FORM}.")
    if word in ("duplicated", "intermittent") and number > 1.0:
        raise InputError("fault", text, "with a probability, at most 1", f"Leave it out for {_usual(word, target):g}.")
    if word == "lost" and number > 1.0 and number % 1.0:
        raise InputError("fault", text, "with a probability, or a whole number of frames", "As lost=0.001 or lost=3.")
    if abs(number) > HUGE:
        raise InputError("fault", text, f"with a value of at most {HUGE:g}", "No sensor and no wire has more.")
    if word == "babble" and number > FULL:
        raise InputError("fault", text, f"of at most {FULL:g} frames per second", "No more pass a bus of 1 Mbit/s.")
    begin = _number(text, start, "its start") if at else 0.0
    lasts = _number(text, duration, "its duration") if plus else math.inf
    if begin < 0.0 or lasts <= 0.0:
        raise InputError("fault", text, "from 0 s on and longer than 0 s", f"The form is {_FORM}.")
    fault = Fault(target, word, number, begin, lasts)
    if plus and fault.is_event:
        remedy = "Leave it out; the pendant's next button, or the next start, ends what it did."
        raise InputError("fault", text, "without a duration: it is an instant", remedy)
    return fault


def _usual(word: str, target: str) -> float | None:
    """The value of a word that is given none: NaN where it must be given, None where it takes none."""
    usual = _SENSOR.get(word)
    return usual[target != "force"] if usual is not None else _PLAIN.get(word)


def _number(text: str, written: str, what: str) -> float:
    try:
        number = float(written)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError("fault", text, f"with a finite number for {what}", f"The form is {_FORM}.")
    return number


class Distortion:
    """Applies the faults of one sensor to its readings."""

    def __init__(self, target: str, faults: Sequence[Fault], random: np.random.Generator) -> None:
        mine = [fault for fault in faults if fault.target == target and fault.word in _SENSOR]
        # A delay tells what was true before: it comes first, or it would undo the faults before it.
        self._faults = sorted(mine, key=lambda fault: fault.word != "delayed")
        self._random, self._largest = random, _LARGEST["force" if target == "force" else "encoder"]
        self._kept: dict[Fault, tuple[float, ...]] = {}
        self._history: deque[tuple[float, ...]] = deque(maxlen=1 + max(map(_memory, self._faults), default=0))

    def __bool__(self) -> bool:
        return bool(self._faults)

    def read(self, tick: int, reading: tuple[float, ...]) -> tuple[float, ...] | None:
        """A reading as it comes out, None if there is none; to be called every millisecond, `tick` counts them."""
        self._history.append(reading)
        for fault in self._faults:
            if fault.active(1e-3 * tick):
                changed = self._changed(fault, tick, reading)
                if changed is None:
                    return None
                reading = changed
        return reading

    def _changed(self, fault: Fault, tick: int, reading: tuple[float, ...]) -> tuple[float, ...] | None:
        value = fault.value
        match fault.word:
            case "off":
                return None
            case "intermittent":
                return None if self._random.random() < value else reading
            case "stuck":
                return self._kept.setdefault(fault, reading)
            case "slow":
                since = tick - round(1e3 * fault.start)
                if since % max(round(value), 1) == 0 or fault not in self._kept:
                    self._kept[fault] = reading
                return self._kept[fault]
            case "delayed":
                return self._history[max(len(self._history) - 1 - _memory(fault), 0)]
            case "garbage":
                return tuple(self._random.uniform(-self._largest, self._largest, len(reading)).tolist())
            case "sign":
                return tuple(-each for each in reading)
            case "unit":
                return tuple(value * each for each in reading)
        return (*reading[:-1], reading[-1] + value)


def _memory(fault: Fault) -> int:
    return round(fault.value) if fault.word == "delayed" else 0


class Links:
    """Loses, delays and doubles frames as the faults of the bus demand."""

    def __init__(self, faults: Sequence[Fault], random: np.random.Generator) -> None:
        self._faults = [fault for fault in faults if fault.word in _FRAMES]
        self._random = random
        self._left = {
            fault: round(fault.value) for fault in self._faults if fault.word == "lost" and fault.value >= 1.0
        }

    def __bool__(self) -> bool:
        return bool(self._faults)

    def copies(self, targets: Sequence[str], now: float) -> list[float]:
        """Lateness of each copy of a frame that arrives [s].

        Args:
            targets: All that the frame belongs to.
            now: Time [s].
        """
        late = [0.0]
        for fault in self._faults:
            if fault.target not in targets or not fault.active(now):
                continue
            if fault.word == "late":
                late = [each + 1e-3 * fault.value for each in late]
            elif fault.word == "duplicated":
                late = late * (2 if self._random.random() < fault.value else 1)
            elif fault in self._left:
                self._left[fault] -= 1
                late = late if self._left[fault] < 0 else []
            elif self._random.random() < fault.value:
                late = []
        return late
