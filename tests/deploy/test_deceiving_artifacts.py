"""Files that are sealed and yet no controller's: archives that would fill a memory, run code, or name what none has."""

import io
import json
import os
import pickle
import time
import tracemalloc
import warnings
import zipfile
from hashlib import sha256

import numpy as np
import pytest

from deploy.controller.file import ArtifactError, from_bytes, load, to_bytes
from jaxmpc.files.sealed import LARGEST, SEAL, seal, unseal


def sealed(body):
    return body + sha256(body).digest()


class Touch:
    def __reduce__(self):
        return os.mkdir, ("unpickled",)


def object_array():
    buffer = io.BytesIO()
    np.savez(buffer, header=np.array([Touch()], dtype=object))
    return buffer.getvalue()


def bomb():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("header.npy", "w") as file:
        for _ in range(LARGEST // 2**20 + 1):
            file.write(bytes(2**20))
    return buffer.getvalue()


def member(name, content):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, content)
    return buffer.getvalue()


def plain_npy():
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    return buffer.getvalue()


def huge_claim(count=1099511627776000):
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,), }\n" % count
    return member("header.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text)


def crowd():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for i in range(25_000):
            archive.writestr(f"{i}.npy", b"")
    return buffer.getvalue()


@pytest.mark.parametrize("make", [bomb, lambda: huge_claim(2**30), crowd], ids=["bomb", "claim", "crowd"])
def test_what_would_fill_the_memory_is_refused_before_it_does(make):
    data = sealed(make())
    tracemalloc.start()
    try:
        with pytest.raises(ArtifactError):
            from_bytes(data)
        # Of the file itself there may be one more copy.
        assert tracemalloc.get_traced_memory()[1] <= len(data) + 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pickle.dumps(Touch()), "sealed, but not a jaxmpc file"),
        (object_array, "an array of object, not of numbers or words"),
        (bomb, f"unpacks to more than {LARGEST} bytes"),
        (plain_npy, "sealed, but not a jaxmpc file"),
        (huge_claim, f"claims to have more than {LARGEST} bytes"),
        (crowd, "table of contents has .* bytes, more than"),
        (lambda: member("header", b"{}"), "sealed, but has no header"),
        (lambda: b"hello", "sealed, but not a jaxmpc file"),
        (lambda: seal([], {})[:-32], "its header is not a table"),  # type: ignore[arg-type]  # a list instead
        (lambda: seal({}, {})[:-32], "not a controller: its schema is None"),
    ],
)
def test_sealed_files_made_to_deceive_are_refused(make, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArtifactError, match=message):
        from_bytes(sealed(make()))
    assert not list(tmp_path.iterdir())


def test_unsealed_pickle_is_refused_by_its_seal(tmp_path):
    path = tmp_path / "controller.npz"
    path.write_bytes(pickle.dumps(Touch()) * 10)
    with pytest.raises(ArtifactError, match="seal does not match"):
        load(path)


def test_a_link_that_takes_the_files_place_as_it_is_opened_is_not_followed(data, tmp_path, monkeypatch):
    (tmp_path / "good.npz").write_bytes(data)
    (tmp_path / "link").symlink_to("good.npz")
    monkeypatch.setattr(type(tmp_path), "lstat", lambda path: (tmp_path / "good.npz").stat())
    with pytest.raises(ArtifactError, match="cannot be read"):
        load(tmp_path / "link")


def test_paths_that_are_no_files(data, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "good.npz").write_bytes(data)
    (tmp_path / "link").symlink_to("good.npz")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(LARGEST + 1)
    (tmp_path / "empty").touch()
    cases = {
        "missing": "cannot be read: No such file",
        "loop": "is a symbolic link, behind which anybody may put another",
        "link": "is a symbolic link",
        "folder": "not a file, but a folder or a device",
        "pipe": "not a file, but a folder or a device",
        "large": f"more than the {LARGEST}",
        "empty": "cut short",
    }
    for name, message in cases.items():
        with pytest.raises(ArtifactError, match=f"{name}: it .*{message}"):
            load(tmp_path / name)
    with pytest.raises(ArtifactError, match="/dev/zero: it is not a file"):
        load("/dev/zero")


def npy(shape, descr="<f8", content=b""):
    """An array's bytes that claim what they like."""
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


def with_entries(data, *entries, without=(), compression=zipfile.ZIP_STORED):
    """The file's entries and others, sealed again."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data[:-SEAL])) as old, zipfile.ZipFile(buffer, "w", compression) as archive:
        for name in old.namelist():
            if name not in without:
                archive.writestr(name, old.read(name))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # zipfile says so when a name comes twice
            for name, content in entries:
                archive.writestr(name, content)
    return sealed(buffer.getvalue())


def with_header(data, change):
    """The file with the text of its header changed, sealed again."""
    with zipfile.ZipFile(io.BytesIO(data[:-SEAL])) as old:
        text = np.load(io.BytesIO(old.read("header.npy"))).tobytes().decode()
    changed = change(text).encode()
    assert changed != text.encode()
    header = npy((len(changed),), "|u1", changed)
    return with_entries(data, ("header.npy", header), without=("header.npy",))


def nested_lists(text):
    return text.replace('"provenance":{', f'"provenance":{{"more":{"[" * 900}{"]" * 900},')


def nested_families(text):
    """A schedule whose knots have a schedule, and so on: each part by itself is as it must be."""
    header = json.loads(text)
    gains = "0"
    for _ in range(200):
        knots = json.dumps([{"log_stiffness": 6.0, "K2": 10.0, "gains": "@"}]).replace('"@"', gains)
        gains = json.dumps(header["gains"])[:-1] + f', "schedule": {{"knots": {knots}}}}}'
    return json.dumps(header | {"gains": "@"}).replace('"@"', gains)


V = "golden_v.npy"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda d: with_entries(d, (V, npy((10**6,) * 3, "|V0")), without=(V,)), "not of numbers or words"),
        (lambda d: with_entries(d, (V, npy((12, 3), "|V0")), without=(V,)), "not of numbers or words"),
        (lambda d: with_entries(d, (V, npy((10**6,) * 3, "<U0")), without=(V,)), "not of numbers or words"),
        (lambda d: with_entries(d, (V, npy((10**6,) * 3)), without=(V,)), "claims to have more than"),
        (lambda d: with_entries(d, (V, npy((0, 10**15))), without=(V,)), "claims to have more than"),
        (
            lambda d: with_entries(d, (V, npy((12, 3), content=bytes(287))), without=(V,)),
            "claims 288 bytes and has 287",
        ),
        (
            lambda d: with_entries(d, (V, npy((12, 3), content=bytes(289))), without=(V,)),
            "claims 288 bytes and has 289",
        ),
        (lambda d: with_entries(d, ("header.npy", npy((2,), "|u1", b"{}"))), "'header.npy' more than once"),
        (lambda d: with_entries(d, (V, npy((12, 3), content=bytes(288)))), "'golden_v.npy' more than once"),
        (lambda d: with_entries(d, ("../evil.npy", npy((0,)))), "no name of an array"),
        (lambda d: with_entries(d, ("a/../../evil.npy", npy((0,)))), "no name of an array"),
        (lambda d: with_entries(d, ("/etc/evil.npy", npy((0,)))), "no name of an array"),
        (lambda d: with_entries(d, ("..\\evil.npy", npy((0,)))), "no name of an array"),
        (lambda d: with_entries(d, ("golden_v", npy((0,)))), "no name of an array"),
        (lambda d: with_entries(d, ("extra.npy", npy((0,)))), "the array 'extra', which no controller"),
        (lambda d: with_entries(d, compression=zipfile.ZIP_DEFLATED), "is compressed"),
        (lambda d: with_header(d, lambda t: t.replace('"K2":', '"K2":1.0,"K2":')), "the key 'K2' twice"),
        (lambda d: with_header(d, lambda t: t.replace('"phi":', '"phi":[0,0],"phi":')), "the key 'phi' twice"),
        (lambda d: with_header(d, lambda t: t.replace('"version":2', '"version":true')), "schema version True"),
        (lambda d: with_header(d, lambda t: t.replace('"version":2', '"version":2.0')), "schema version 2.0"),
        (lambda d: with_header(d, lambda t: t.replace('"K2":', '"K2":NaN,"K":')), "holds NaN"),
        (lambda d: with_header(d, lambda t: t.replace('"K2":', '"more":1,"K2":')), "the key 'more', which no"),
        (lambda d: with_header(d, nested_lists), "nested more than 64 deep"),
        (lambda d: with_header(d, nested_families), "nested more than 64 deep"),
        (lambda d: with_header(d, lambda t: t.replace('"arm":', '"legs":') if '"arm":' in t else "[]"), "header"),
    ],
)
def test_what_no_freezing_writes_is_refused_at_once(data, make, message):
    began = time.perf_counter()
    with pytest.raises(ArtifactError, match=message):
        from_bytes(make(data))
    assert time.perf_counter() - began < 1.0


def test_the_same_entries_written_again_are_the_controller(data):
    assert to_bytes(from_bytes(with_entries(data))) == data


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "é" * 5000},
        {"schema": ["é" * 5000]},
        {"version": "é" * 5000},
        {"version": 10**4000},
        {"version": -(10**4000)},
        {"é" * 5000: 1},
    ],
)
def test_long_words_are_not_repeated_at_length(data, change):
    header, arrays = unseal(data)
    with pytest.raises(ArtifactError) as raised:
        from_bytes(seal(header | change, arrays))
    assert len(str(raised.value)) < 200
