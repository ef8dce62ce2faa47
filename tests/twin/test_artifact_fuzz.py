"""Whatever bytes come, loading a controller ends in a refusal: no crash, no hang, no acceptance."""

import json
from collections import Counter
from hashlib import sha256

import numpy as np
import pytest

from deploy.controller.file import ArtifactError, from_bytes, to_bytes
from deploy.controller.runtimes import arm_runtime
from jaxmpc.files.sealed import SEAL, seal, unseal
from tests.deploy import made

ODD = [None, True, -1, 0, 1e308, -0.0, 10**400, "inf", "", [], {}, [[]], [1.0] * 7, {"a": 1}, "nan", 1e-320]


@pytest.fixture(scope="module")
def good():
    return to_bytes(made.arm_artifact(12))


def changed(draw, data):
    """Bytes that are not the file's: flipped, cut, grown, repeated, swapped, or drawn altogether."""
    kind = draw.integers(6)
    buffer = bytearray(data)
    if kind == 0:
        return draw.bytes(int(draw.integers(0, 200)))
    if kind == 1:
        return data[: draw.integers(len(data))]
    if kind == 2:
        return data + draw.bytes(int(draw.integers(1, 50)))
    first, second = sorted(draw.integers(0, len(data), 2).tolist())
    if kind == 3:
        return data[:first] + data[second + 1 :]
    if kind == 4:
        return data[:second] + data[first:]
    for _ in range(draw.integers(1, 5)):
        buffer[draw.integers(len(data))] ^= int(draw.integers(1, 256))
    return bytes(buffer)


def resealed(draw, data):
    """The same, closed again by a right seal, so that the parsers behind it meet what they have never seen."""
    body = changed(draw, data[:-SEAL])
    return body + sha256(body).digest()


def odd_table(draw, table):
    """A header or part of it with one entry replaced by something odd, at any depth, or left out."""
    if isinstance(table, dict | list) and table and draw.random() < 0.8:
        keys = list(table) if isinstance(table, dict) else range(len(table))
        key = keys[draw.integers(len(keys))]
        inner = odd_table(draw, table[key])
        if isinstance(table, list):
            return [inner if i == key else each for i, each in enumerate(table)]
        return {k: inner if k == key else v for k, v in table.items() if k != key or draw.random() < 0.9}
    return ODD[draw.integers(len(ODD))]


def odd_arrays(draw, arrays):
    name = list(arrays)[draw.integers(len(arrays))]
    value = arrays[name]
    odd = [value[:, 0], value * np.nan, value.astype(str), np.full(value.shape, 1e300), value + draw.normal(size=1)]
    return arrays | {name: odd[draw.integers(len(odd))]}


def torques(artifact):
    """What it asks of the arm in a run that it has never seen, shape (40, 4) [N m]."""
    runtime, (qs, forces, wanted) = arm_runtime(artifact), made.recorded_inputs(40, seed=5)
    runtime.start(qs[0])
    runtime.enter(forces[0], qs[0])
    rows = zip(qs, forces, wanted, strict=True)
    return np.array([runtime.control(q, runtime.velocity(q), y, [axis[0] for axis in ref]) for q, y, ref in rows])


def attack(draw, data, count, forged):
    """Refusals by their first words, and how many were accepted."""
    (header, arrays), expected = unseal(data), torques(from_bytes(data))
    refusals, accepted = Counter(), 0
    for i in range(count):
        if i >= forged:
            content = changed(draw, data)
        elif i % 2:
            content = resealed(draw, data)
        else:
            odd = odd_table(draw, json.loads(json.dumps(header))) if draw.random() < 0.8 else header
            content = seal(odd, odd_arrays(draw, arrays) if odd is header else arrays)
        if content == data:
            continue
        try:
            found = from_bytes(content)
        except ArtifactError as error:
            refusals[str(error)[:24]] += 1
        else:
            # Its maker has sealed it anew: words, margins or limits may be others, but not what it does.
            assert i < forged
            np.testing.assert_allclose(torques(found), expected, rtol=0, atol=1e-6)
            accepted += 1
    return refusals, accepted


@pytest.mark.oracle
def test_ten_thousand_inputs(good):
    refusals, accepted = attack(np.random.default_rng(1), good, 10_000, forged=250)
    assert sum(refusals.values()) + accepted >= 9_990
    assert accepted < 60
    assert len(refusals) > 20  # they have come by many gates


@pytest.mark.slow
def test_a_million_inputs(good):
    refusals, accepted = attack(np.random.default_rng(2), good, 1_000_000, forged=10_000)
    assert sum(refusals.values()) + accepted >= 999_900
    assert accepted < 6000
