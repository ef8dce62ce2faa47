import ctypes
import math
from types import SimpleNamespace

import pytest

from deploy.errors import BusError
from deploy.force import jr3
from deploy.force.jr3 import Jr3, open_comedi
from deploy.force.sensor import BAD_DATA, Mounted
from deploy.puck.frame import Frame

FULL_SCALES = (100.0, 100.0, 200.0, 5.0, 5.0, 5.0)


class Device:
    """A comedi subdevice of jr3_pci: forces × 1000 and moments × 100 (of 0.1 N m) in micro-units."""

    def __init__(self, counts=(0,) * 6, scales=FULL_SCALES, n=58):
        self.counts, self.scales, self.n, self.asked = list(counts), scales, n, []

    def channels(self):
        return self.n

    def full_scale(self, channel):
        axis = channel % 8
        units = self.scales[axis] if axis < 3 else 10.0 * self.scales[axis]
        return units * (1000 if axis < 3 else 100) * 1e-6

    def read(self, channel):
        self.asked.append(channel)
        counts = self.counts[channel % 8]
        return None if counts is None else counts + 0x4000


def test_counts_become_newtons_by_the_full_scales_of_the_device():
    device = Device((16384 // 2, -16384 // 4, 1, 16384 // 5, 0, -16383))
    sensor = Jr3(device)
    assert sensor.full_scales == pytest.approx(FULL_SCALES)
    assert device.asked == [8, 9, 10, 11, 12, 13]
    assert sensor.request() == ()
    wrench = sensor.read()
    assert wrench.force == pytest.approx((50.0, -25.0, 200.0 / 16384))
    assert wrench.moment == pytest.approx((5.0 * 3276 / 16384, 0.0, -5.0 * 16383 / 16384))
    assert wrench.flags == 0
    assert sensor.ready


def test_a_reading_is_taken_when_the_cycle_begins():
    device = Device()
    sensor = Jr3(device)
    sensor.request()
    device.counts[0] = 8192
    assert sensor.read().force[0] == 0.0
    sensor.request()
    assert sensor.read().force[0] == pytest.approx(50.0)
    assert not sensor.feed(Frame(0x50A, bytes(6)))


@pytest.mark.parametrize("filter", range(7))
def test_channels_are_8_filter_plus_axis(filter):
    device = Device()
    Jr3(device, filter)
    assert device.asked == [8 * filter + axis for axis in range(6)]


@pytest.mark.parametrize(
    ("axis", "counts", "flags"),
    [(0, 16383, 1), (2, -16384, 4), (5, 16383, 32), (1, 16384, BAD_DATA), (1, -16385, BAD_DATA), (0, 16382, 0)],
)
def test_the_ends_of_the_scale_are_flagged(axis, counts, flags):
    device = Device()
    sensor = Jr3(device)
    device.counts[axis] = counts
    sensor.request()
    assert sensor.read().flags == flags


def test_a_missing_sample_is_no_reading():
    device = Device()
    sensor = Jr3(device)
    device.counts[4] = None
    sensor.request()
    assert sensor.read() is None
    assert sensor.failures == 1
    device.counts[4] = 0
    sensor.request()
    assert sensor.read() is not None


def test_tare_subtracts_what_is_felt_now():
    device = Device((1000, -2000, 3000, 100, 0, 0))
    sensor = Mounted(Jr3(device))
    assert sensor.tare() == ()
    sensor.request()
    assert sensor.read().force == pytest.approx((0.0, 0.0, 0.0))
    device.counts[2] += 8192
    sensor.request()
    assert sensor.read().force[2] == pytest.approx(-100.0)  # on the tissue
    device.counts[0] = 16383
    with pytest.raises(BusError, match="cannot be tared"):
        sensor.tare()


@pytest.mark.parametrize(
    ("device", "filter", "says"),
    [
        (Device(n=16), 1, "58 channels, this comedi subdevice has 16"),
        (Device(n=-1), 1, "has -1"),
        (Device(scales=(0.0,) * 6), 1, "no full scales"),
        (Device(scales=(math.nan,) * 6), 1, "no full scales"),
        (Device(counts=(None,) * 6), 1, "does not answer"),
        (Device(), 7, "filters 0 to 6"),
    ],
)
def test_what_is_no_working_jr3_is_refused(device, filter, says):
    with pytest.raises(BusError, match=says):
        Jr3(device, filter)


def test_without_device_or_library_a_sentence_says_so(tmp_path):
    with pytest.raises(BusError, match=r"there is no /dev/comedi99 .*modprobe jr3_pci"):
        open_comedi("/dev/comedi99")
    path = tmp_path / "comedi0"
    path.touch()

    def load(name):
        raise OSError("no such library")

    with pytest.raises(BusError, match="install comedilib"):
        open_comedi(str(path), load=load)


class Function:
    """Stands for one of a C library: takes the attributes that ctypes has, and calls."""

    def __init__(self, call):
        self.call = call

    def __call__(self, *arguments):
        return self.call(*arguments)


def library(handle=77):
    """The functions that are used of comedilib, over a `Device`."""
    device = Device((8192, 0, 0, 0, 0, 0))

    def read(dev, subdevice, channel, range, aref, pointer):
        assert (dev, subdevice, range, aref) == (77, 2, 0, 0)
        sample = device.read(channel)
        if sample is None:
            return -1
        pointer.contents.value = sample
        return 1

    def get_range(dev, subdevice, channel, range):
        top = device.full_scale(channel)
        return ctypes.pointer(jr3._Range(-top, top, 2))

    fake = SimpleNamespace(
        comedi_open=Function(lambda path: handle),
        comedi_get_n_channels=Function(lambda dev, subdevice: 58),
        comedi_get_range=Function(get_range),
        comedi_data_read=Function(read),
    )
    return fake, device


def test_the_c_library_is_called_as_its_header_says(tmp_path):
    path = tmp_path / "comedi0"
    path.touch()
    fake, device = library()
    sensor = Jr3(open_comedi(str(path), subdevice=2, load=lambda name: fake))
    assert sensor.read().force == pytest.approx((50.0, 0.0, 0.0))
    assert fake.comedi_open.argtypes == (ctypes.c_char_p,)
    assert fake.comedi_open.restype is ctypes.c_void_p  # a pointer of 64 bits, not an int
    device.counts[0] = None
    sensor.request()
    assert sensor.read() is None
    fake, _ = library(handle=None)
    with pytest.raises(BusError, match="permissions"):
        open_comedi(str(path), load=lambda name: fake)
    fake, _ = library()
    fake.comedi_get_range = Function(lambda *arguments: None)
    with pytest.raises(BusError, match="no full scales"):
        Jr3(open_comedi(str(path), subdevice=2, load=lambda name: fake))
