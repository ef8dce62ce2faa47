"""The page of memory that controller and watchdog share: three times, each written by one of them alone."""

import mmap
import os

_BEAT, _FIRED, _ALIVE = range(3)


class BeatPage:
    """Times in shared memory [ns].

    Each is read and written through a memoryview of 64-bit integers, in one move of the processor. `struct.pack_into`
    would clear its bytes first: whoever reads in between sees a time of 0, and takes a watchdog for dead that lives.
    """

    def __init__(self, descriptor: int) -> None:
        """Map the page of a descriptor; see `create`."""
        self._times = memoryview(mmap.mmap(descriptor, mmap.PAGESIZE)).cast("q")

    @staticmethod
    def create() -> int:
        """A descriptor of a page of zeros, to be handed to another process; the caller closes it."""
        descriptor = os.memfd_create("jaxmpc-watchdog")
        os.ftruncate(descriptor, mmap.PAGESIZE)
        return descriptor

    @property
    def beat(self) -> int:
        """Time of the controller's last beat: negative while torques are off, 0 before the first."""
        return self._times[_BEAT]

    @beat.setter
    def beat(self, time: int) -> None:
        self._times[_BEAT] = time

    @property
    def fired(self) -> int:
        """Time at which the watchdog acted [ns], 0 if never."""
        return self._times[_FIRED]

    @fired.setter
    def fired(self, time: int) -> None:
        self._times[_FIRED] = time

    @property
    def alive(self) -> int:
        """Time at which the watchdog last looked [ns], 0 before the first."""
        return self._times[_ALIVE]

    @alive.setter
    def alive(self, time: int) -> None:
        self._times[_ALIVE] = time
