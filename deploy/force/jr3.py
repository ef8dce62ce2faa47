"""A JR3 sensor through comedi's driver jr3_pci (wam.md §4.2)."""

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

from deploy.errors import BusError
from deploy.force.sensor import BAD_DATA, SATURATED, Wrench
from deploy.puck.frame import Frame

CHANNELS: Final = 58
ZERO: Final = 0x4000
FULL_SCALE_COUNTS: Final = 16384
LOWPASS_HZ: Final = 500.0
"""Low-pass of its filter 1 [Hz]."""
PER_RANGE: Final = 1000.0
"""The driver gives full scales in kN and kN m: its forces × 1000 and moments × 100 (of 0.1 N m) are micro-units."""
LIBRARIES: Final = ("libcomedi.so.0", "libcomedi.so")
SETTLING: Final = "it takes 10 s after the driver was loaded; check the sensor's cable and `dmesg` for jr3_pci"


class Comedi(Protocol):
    """What is used of a comedi subdevice."""

    def channels(self) -> int:
        """How many it has, 0 or less if there is no such subdevice."""
        ...

    def full_scale(self, channel: int) -> float:
        """Upper end of a channel's range, in the driver's units; not finite if it has none."""
        ...

    def read(self, channel: int) -> int | None:
        """A raw sample, None if there is none now."""
        ...


class Jr3:
    """Reads the six axes of a JR3 behind one of its own filters when a cycle begins.

    Attributes:
        failures: Cycles without a reading.
    """

    ready = True

    def __init__(self, device: Comedi, filter: int = 1) -> None:
        """Take the full scales from the sensor.

        Args:
            device: An opened subdevice; see `open_comedi`.
            filter: 0 is raw, 1 cuts off at 500 Hz, each further one at a quarter of that, to 6.

        Raises:
            BusError: It is no JR3, or the sensor does not answer.
        """
        if not 0 <= filter <= 6:
            raise BusError(f"a JR3 has the filters 0 to 6, not {filter}")
        if (found := device.channels()) != CHANNELS:
            raise BusError(f"a JR3 has {CHANNELS} channels, this comedi subdevice has {found}: is it another board's?")
        self._device = device
        self._channels = tuple(8 * filter + axis for axis in range(6))
        scales = tuple(PER_RANGE * device.full_scale(channel) for channel in self._channels)
        if not all(0.0 < scale < math.inf for scale in scales):
            raise BusError(f"the JR3 tells no full scales yet: {SETTLING}")
        self.full_scales = scales
        self._gains = tuple(scale / FULL_SCALE_COUNTS for scale in scales)
        self._offsets = [0.0] * 6
        self._raw: list[int] | None = None
        self.failures = 0
        self.request()
        if self._raw is None:
            raise BusError(f"the JR3 does not answer: {SETTLING}")

    def request(self) -> tuple[Frame, ...]:
        """Sample now, while the pucks are asked for their positions; nothing goes over the bus."""
        raw: list[int] = []
        for channel in self._channels:
            sample = self._device.read(channel)
            if sample is None:
                self._raw = None
                self.failures += 1
                return ()
            raw.append(sample - ZERO)
        self._raw = raw
        return ()

    def feed(self, frame: Frame) -> bool:
        """No frame is a JR3's."""
        return False

    def read(self) -> Wrench | None:
        """This cycle's reading; an axis at the end of its scale is flagged, one beyond it as bad."""
        if self._raw is None:
            return None
        flags = 0
        values = []
        for axis, counts in enumerate(self._raw):
            if not -FULL_SCALE_COUNTS < counts < FULL_SCALE_COUNTS - 1:
                flags |= 1 << axis if -FULL_SCALE_COUNTS <= counts < FULL_SCALE_COUNTS else BAD_DATA
            values.append(counts * self._gains[axis] - self._offsets[axis])
        fx, fy, fz, mx, my, mz = values
        return Wrench((fx, fy, fz), (mx, my, mz), flags & (SATURATED | BAD_DATA))

    def tare(self, samples: int = 100) -> tuple[Frame, ...]:
        """Call the mean of so many samples zero, here and not in the sensor; never while the loop runs.

        Raises:
            BusError: A sample is missing or not to be relied on.
        """
        self._offsets = [0.0] * 6
        sums = [0.0] * 6
        for _ in range(samples):
            self.request()
            wrench = self.read()
            if wrench is None or wrench.flags:
                raise BusError(f"the JR3 cannot be tared, for it gives no sound reading: {SETTLING}")
            sums = [total + value for total, value in zip(sums, wrench.force + wrench.moment, strict=True)]
        self._offsets = [total / samples for total in sums]
        return ()


def open_comedi(
    path: str = "/dev/comedi0", subdevice: int = 0, load: Callable[[str], Any] = ctypes.CDLL
) -> "LibComedi":
    """A subdevice through the C library, where both are there.

    Args:
        path: Of the device.
        subdevice: One for each sensor of the board.
        load: How a library is loaded.

    Raises:
        BusError: There is no such device, no library, or no permission.
    """
    if not Path(path).exists():
        others = ", ".join(sorted(map(str, Path("/dev").glob("comedi*")))) or "none"
        raise BusError(f"there is no {path} (comedi devices here: {others}): load its driver with `modprobe jr3_pci`")
    for name in LIBRARIES:
        try:
            library = load(name)
        except OSError:
            continue
        return LibComedi(library, path, subdevice)
    raise BusError(f"{path} is there, but the library to read it is not: install comedilib ({LIBRARIES[0]})")


class _Range(ctypes.Structure):
    _fields_ = (("min", ctypes.c_double), ("max", ctypes.c_double), ("unit", ctypes.c_uint))


class LibComedi:
    """A subdevice of a comedi device, through the C library."""

    def __init__(self, library: Any, path: str, subdevice: int) -> None:
        """Open it.

        Raises:
            BusError: The library refuses.
        """
        c_uint, handle = ctypes.c_uint, ctypes.c_void_p
        library.comedi_open.argtypes, library.comedi_open.restype = (ctypes.c_char_p,), handle
        library.comedi_get_n_channels.argtypes = (handle, c_uint)
        library.comedi_get_range.argtypes = (handle, c_uint, c_uint, c_uint)
        library.comedi_get_range.restype = ctypes.POINTER(_Range)
        pointer = ctypes.POINTER(c_uint)
        library.comedi_data_read.argtypes = (handle, c_uint, c_uint, c_uint, c_uint, pointer)
        self._library, self._subdevice = library, subdevice
        self._device = library.comedi_open(path.encode())
        if not self._device:
            raise BusError(f"{path} cannot be opened: have its permissions let you read and write it")
        self._sample = c_uint()
        self._pointer = ctypes.pointer(self._sample)

    def channels(self) -> int:
        """As `Comedi`."""
        return int(self._library.comedi_get_n_channels(self._device, self._subdevice))

    def full_scale(self, channel: int) -> float:
        """As `Comedi`."""
        found = self._library.comedi_get_range(self._device, self._subdevice, channel, 0)
        return float(found.contents.max) if found else math.nan

    def read(self, channel: int) -> int | None:
        """As `Comedi`."""
        done = self._library.comedi_data_read(self._device, self._subdevice, channel, 0, 0, self._pointer)
        return self._sample.value if done == 1 else None
