"""A controller as a file: what is in it comes back, and whatever is missing or wrong has a sentence of its own."""

import io
from hashlib import sha256

import numpy as np
import pytest

from deploy.controller import file
from deploy.controller.file import ArtifactError, from_bytes, to_bytes
from jaxmpc.files.sealed import canonical_json, seal, unseal
from jaxmpc.law.gains import Gains
from jaxmpc.law.scalar import Constant, declared


def sealed(body):
    return body + sha256(body).digest()


def test_round_trip(data, arguments):
    artifact = from_bytes(data)
    assert to_bytes(artifact) == data
    assert artifact.gains == arguments["gains"]
    assert artifact.margins == arguments["margins"]  # infinity survives
    assert artifact.floor == arguments["floor"]
    assert artifact.params == arguments["params"]
    assert artifact.golden_v.tolist() == arguments["golden"][2].tolist()
    with pytest.raises(ValueError, match="read-only"):
        artifact.golden_v[0, 0] = 1.0


def test_every_flipped_bit_is_refused(data):
    flipped = bytearray(data)
    for index in range(len(data)):
        for bit in range(8):
            flipped[index] ^= 1 << bit
            with pytest.raises(ArtifactError, match=r"its sha256 seal does not match its content: it was changed"):
                from_bytes(bytes(flipped))
            flipped[index] ^= 1 << bit
    assert from_bytes(bytes(flipped)).T_s == 1e-3


def test_every_truncation_is_refused(data):
    for length in range(len(data)):
        with pytest.raises(ArtifactError, match="cut short"):
            from_bytes(data[:length])
    with pytest.raises(ArtifactError, match="changed"):
        from_bytes(data + b"\0")


HEADER_CASES = [
    ({"schema": None}, "not a controller: its schema is None"),
    ({"version": 3}, "newer than 2: update jaxmpc"),
    ({"version": 1}, "schema version 1, which does not say what filters it flies with: freeze it again"),
    ({"version": 0}, "never existed"),
    ({"version": "1"}, "never existed"),
    ({"kind": "7-dof"}, "of the kind '7-dof'; this version of jaxmpc knows 'linear' and 'wam'"),
    ({"kind": None}, "of the kind None"),
    ({"T_s": 0.0}, r"T_s = 0.0: must be in \[1e-4, 0.1\] s"),
    ({"T_s": "nan"}, "T_s = nan: must be a number"),
    ({"T_s": 10**400}, "T_s = 1000.*must be a number"),
    ({"K2": -1.0}, r"K2 = -1.0: must be in \[0, 1e4\] 1/s"),
    ({"preview": 0}, "preview = 0: must be true or false"),
    ({"loop": None}, "loop = None: must be a table of delay, ideal"),
    ({"loop": {"delay": 1}}, "loop.ideal = missing: must be given: whether the damping was ideal"),
    ({"params": []}, "params = .*must be a table"),
    ({"provenance": None}, "provenance = None: must be a table"),
    ({"floor": {}}, "floor = {}: must be a table of one or more"),
    ({"floor": {"M_t": 2.0}}, "floor = .*must be a table of one or more"),
    ({"floor": {"M_s": "inf"}}, "floor.M_s = inf: must be positive and finite"),
    ({"floor": {"gain_margin_db": 0.0}}, "floor.gain_margin_db = 0.0: must be positive"),
    ({"floor": None}, "floor = None"),
    ({"margins": []}, "margins = none: must be given for at least one stiffness"),
    ({"margins": [{}]}, "margins = {}: must be a table of"),
    ({"margins": [1]}, "margins = 1: must be a table of"),
]


@pytest.mark.parametrize(("changes", "message"), HEADER_CASES)
def test_each_wrong_header_has_its_sentence(data, changes, message):
    header, arrays = unseal(data)
    with pytest.raises(ArtifactError, match=message):
        from_bytes(seal(header | changes, arrays))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spectral_radius": 1.035}, "spectral_radius at 1900 N/m = 1.035: must be below 1"),
        ({"M_s": 4.5}, "M_s at 1900 N/m = 4.5: must be at most 2, the declared floor"),
        ({"M_s": "inf"}, "M_s at 1900 N/m = inf: must be at most 2"),
        ({"gain_reduction_db": 5.9}, "gain_reduction_db at 1900 N/m = 5.9 dB: must be at least 6 dB"),
        ({"phase_margin_deg": None}, "phase_margin_deg = None: must be a number"),
        ({"stiffness": 0.0}, r"stiffness = 0.0: must be in \[1, 1e\+06\] N/m"),
        ({"stiffness": 0.999}, r"stiffness = 0.999: must be in"),
        ({"stiffness": 1.7e308}, r"stiffness = 1.7e\+308: must be in"),
        ({"surplus": 1.0}, "must be a table of"),
        ({"M_s": -1.0}, "M_s at 1900 N/m = -1: must be at least 1, as of any stable loop"),
        ({"M_s": 0.999}, "M_s at 1900 N/m = 0.999: must be at least 1"),
        ({"spectral_radius": -1e308}, r"spectral_radius at 1900 N/m = -1e\+308: must be at least 0"),
        ({"phase_margin_deg": -33.9}, "phase_margin_deg at 1900 N/m = -33.9: must be above 0"),
        ({"delay_margin_s": 0.0}, "delay_margin_s at 1900 N/m = 0: must be above 0"),
        ({"gain_margin_db": "-inf"}, "gain_margin_db at 1900 N/m = -inf: must be above 0"),
        # What is unstable is told as such, whatever its margins are.
        ({"spectral_radius": 1.035, "phase_margin_deg": -33.9}, "spectral_radius .* below 1"),
    ],
)
def test_each_wrong_margin_has_its_sentence(data, changes, message):
    header, arrays = unseal(data)
    header["margins"][-1] |= changes
    with pytest.raises(ArtifactError, match=message):
        from_bytes(seal(header, arrays))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"delay": 3}, "loop.delay = 3: must be 1 or 2"),
        ({"delay": True}, "loop.delay = True: must be 1 or 2"),
        ({"ideal": "no"}, "loop.ideal = no: must be true or false"),
        ({"velocity_cutoff": -1.0}, r"loop.velocity_cutoff = -1.0: must be in \[0, 1e5\] rad/s"),
        ({"sensor_cutoff": "inf"}, "loop.sensor_cutoff = inf: must be in"),
        ({"surplus": 1.0}, "loop.surplus = 1.0: must be a known key"),
    ],
)
def test_each_wrong_loop_has_its_sentence(data, changes, message):
    header, arrays = unseal(data)
    with pytest.raises(ArtifactError, match=message):
        from_bytes(seal(header | {"loop": header["loop"] | changes}, arrays))


def test_a_gain_by_which_the_law_divides_is_none_of_0(data):
    header, arrays = unseal(data)
    with pytest.raises(ArtifactError, match=r"input_gain = 0\.0: must be at least 1e-30"):
        from_bytes(seal(header | {"gains": header["gains"] | {"input_gain": 0.0}}, arrays))


def with_nan(array):
    changed = np.array(array)
    changed.flat[0] = np.nan
    return changed


@pytest.mark.parametrize("name", file.GOLDEN)
def test_each_wrong_array_has_its_sentence(data, name):
    header, arrays = unseal(data)
    good = arrays[name]
    others = {key: value for key, value in arrays.items() if key != name}
    for wrong, message in [
        (others, f"it lacks the array {name}"),
        (others | {name: np.stack([good, good])}, f"{name} = an array of shape .*must be of shape"),
        (others | {name: good[..., None][:0]}, f"{name} = an array of shape .*must be of shape"),
        (others | {name: with_nan(good)}, f"{name} = not finite somewhere"),
        (others | {name: good.astype(str)}, f"its array {name} is of <U.*, not of float64"),
        (others | {name: good.astype(np.float32)}, f"its array {name} is of float32, not of float64"),
        (others | {name: good.astype(">f8")}, f"its array {name} is of >f8, not of float64"),
    ]:
        with pytest.raises(ArtifactError, match=message):
            from_bytes(seal(header, wrong))


CONSTANTS = {name: value for name, value in declared(Gains).items() if isinstance(value, Constant)}


@pytest.mark.parametrize("name", [name for name, value in CONSTANTS.items() if not value.optional])
def test_each_wrong_gain_has_its_sentence(data, name):
    header, arrays = unseal(data)
    good, gains = header["gains"][name], header["gains"]
    others = {key: value for key, value in gains.items() if key != name}
    for wrong, message in [
        (others, f"gains.{name} = missing: must be given"),
        (gains | {"surplus": 1.0}, "gains.surplus = 1.0: must be a known key"),
        (gains | {name: [good, good]}, f"{name} = an array of shape .*must be of shape"),
        (
            gains | {name: np.full(np.shape(good), "1").tolist()},
            f"{name} = an array of <U.*: must be an array of numbers",
        ),
        (gains | {name: None}, f"{name} = an array of object: must be an array of numbers"),
    ]:
        with pytest.raises(ArtifactError, match=message):
            from_bytes(seal(header | {"gains": wrong}, arrays))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (0.66, "deviation from the golden trace"),
        ("0.66", "K_earlier = an array of <U.*: must be an array of numbers"),
        ([0.66], r"K_earlier = an array of shape \(1,\): must be of shape \(\)"),
    ],
)
def test_a_gain_for_two_samples_of_delay_is_checked_too(data, wrong, message):
    header, arrays = unseal(data)
    assert "K_earlier" not in header["gains"]
    with pytest.raises(ArtifactError, match=message):
        from_bytes(seal(header | {"gains": header["gains"] | {"K_earlier": wrong}}, arrays))


@pytest.mark.parametrize("count", [3, 7])
def test_disturbance_order_that_does_not_exist_is_refused(data, count):
    header, arrays = unseal(data)
    gains = header["gains"] | {"K": [0.1] * count}
    with pytest.raises(ArtifactError, match=f"K = {count} numbers: must be 4 to 6"):
        from_bytes(seal(header | {"gains": gains}, arrays))


def test_gain_that_is_not_finite_is_refused(data):
    header, arrays = unseal(data)
    text = canonical_json(header | {"gains": header["gains"] | {"mpc_u": 12345.5}}).replace("12345.5", "1e999")
    buffer = io.BytesIO()
    np.savez(buffer, header=np.frombuffer(text.encode(), np.uint8), **arrays)
    with pytest.raises(ArtifactError, match="mpc_u = not finite somewhere"):
        from_bytes(sealed(buffer.getvalue()))
    header["gains"]["mpc_u"] = 10**400
    with pytest.raises(ArtifactError, match="mpc_u = an array of object"):
        from_bytes(seal(header, arrays))


@pytest.mark.parametrize("name", file.HEADER)
def test_each_missing_header_key_is_named(data, name):
    header, arrays = unseal(data)
    del header[name]
    with pytest.raises(ArtifactError, match=f"its header lacks {name}"):
        from_bytes(seal(header, arrays))


def test_trace_that_the_gains_do_not_give_is_refused(data):
    header, arrays = unseal(data)
    message = r"deviation from the golden trace = .* must be at most 1e-09"
    for name in arrays:
        changed = np.array(arrays[name])
        changed.flat[0] += 1e-4
        with pytest.raises(ArtifactError, match=message):
            from_bytes(seal(header, arrays | {name: changed}))
    for name, good in header["gains"].items():
        gain = np.array(good)
        gain.flat[0] *= 1 + 1e-4
        with pytest.raises(ArtifactError, match=message):
            from_bytes(seal(header | {"gains": header["gains"] | {name: gain.tolist()}}, arrays))


def test_trace_that_tells_nothing_is_refused(data):
    header, arrays = unseal(data)
    with pytest.raises(ArtifactError, match="golden_v = all zero"):
        from_bytes(seal(header, {name: 0.0 * value for name, value in arrays.items()}))
    empty = {name: arrays[name][:0] for name in file.GOLDEN}
    with pytest.raises(ArtifactError, match=r"golden_force = an array of shape \(0, 3\)"):
        from_bytes(seal(header, arrays | empty))


def test_gains_whose_sum_is_not_finite_are_refused(data):
    header, arrays = unseal(data)
    with pytest.raises(ArtifactError, match="sum of mpc_ref = not finite"):
        from_bytes(seal(header | {"gains": header["gains"] | {"mpc_ref": [1e308] * 64}}, arrays))
