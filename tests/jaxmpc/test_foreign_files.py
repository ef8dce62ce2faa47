"""Files that somebody else wrote: what is no plain data is refused in one sentence, whatever a parser would raise."""

import os
from pathlib import Path

import numpy as np
import pytest

from jaxmpc import InputError, Params
from jaxmpc.files.errors import plain, plain_name
from jaxmpc.files.foreign import DEEPEST, json_of, read_bytes
from jaxmpc.files.outputs import check_file, check_folder
from jaxmpc.files.samples import npz_vectors
from jaxmpc.files.sealed import write_atomic
from jaxmpc.files.toml import read_toml

HOSTILE = {
    "deep array": ("a = " + "[" * 5000 + "]" * 5000, "nested"),
    "deep table": ("a = " + "{a = " * 5000 + "1" + "}" * 5000, "nested"),
    "shallow enough for the parser": ("a = " + "[" * 50 + "]" * 50, "nested at most"),
    "dotted key": (".".join("a" * 20000) + " = 1", "of fewer than"),
    "dotted header": ("[" + ".".join("a" * 20000) + "]", "of fewer than"),
    "5000 digits": ("a = " + "9" * 5000, "thousands of digits"),
    "401 digits": ("a = " + "9" * 401, "of 64 bits"),
    "NUL in a path": ('[motion]\nfile = "a\\u0000b"', "control characters"),
    "escape in a value": ('name = "\\u001b[2J"', "control characters"),
    "escape in a key": ('"\\u001b]0;x\\u0007" = 1', "control characters"),
    "duplicate": ("a = 1\na = 2", "Cannot overwrite"),
    "UTF-16": ("a = 1".encode("utf-16"), "UTF-8"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_toml_is_refused_on_one_plain_line(tmp_path: Path, kind: str) -> None:
    content, words = HOSTILE[kind]
    path = tmp_path / "h.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=words) as caught:
        read_toml(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": NaN}', '{"a": ' + "9" * 5000 + "}", "[]", '{"a": 1e'])
def test_hostile_json_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        json_of(text, Path("h.json"))


def test_as_deep_as_allowed_is_read(tmp_path: Path) -> None:
    depth = DEEPEST - 1
    (tmp_path / "d.toml").write_text(f"a = {'[' * depth}{']' * depth}")
    assert "a" in read_toml(tmp_path / "d.toml")


def test_pipes_devices_folders_and_huge_files_are_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "huge").touch()
    os.truncate(tmp_path / "huge", 2**40)
    for path, words in (("pipe", "regular"), ("", "folder"), ("huge", "smaller"), ("none", "No such"), ("a\0b", "NUL")):
        with pytest.raises(InputError, match=words):
            read_bytes(tmp_path / path)
    with pytest.raises(InputError, match="regular"):
        read_bytes("/dev/zero")


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", t=np.zeros(2**25), x=np.zeros(2**25))
    with pytest.raises(InputError, match="unpacks to more"):
        npz_vectors(tmp_path / "bomb.npz", "recording")


def test_text_becomes_plain() -> None:
    assert plain("a\x1b[31m\nb\u202e") == "a\\x1b[31m\\nb\\u202e"
    assert plain("K̂_s ≤ 5 µm") == "K̂_s ≤ 5 µm"
    assert len(plain("x" * 10**6, 80)) <= 80
    assert str(InputError("k\n", 10**5000, "small", "Lower it.")).startswith("k\\n = a huge int: must be small")


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "-o", "a\nb", "x" * 101, "a\x1b", " a", "a "])
def test_names_that_are_no_names(name: str) -> None:
    with pytest.raises(InputError, match="plain name"):
        plain_name("name", name)


@pytest.mark.parametrize("name", ["table-1-wam", "Mein Herz 2", "a.b_c+d", "心臓", "table-1 (λ = 0.1)"])
def test_names_that_are_names(name: str) -> None:
    assert plain_name("name", name) == name


def test_outputs_are_looked_at_and_nothing_is_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    check_file("-o", tmp_path / "new.npz")
    check_file("-o", tmp_path / "file")
    check_folder("-o", tmp_path / "a" / "b")
    wrong_files = (tmp_path, tmp_path / "none" / "x", tmp_path / "file" / "x", Path("/proc/x"), Path("a\0b"), Path())
    for path in (*wrong_files, Path("/dev/null"), tmp_path / ("x" * 300)):
        with pytest.raises(InputError):
            check_file("-o", path)
    for path in (tmp_path / "file", tmp_path / "file" / "x", Path("/proc/x"), tmp_path / ("x" * 300), Path("a\0b")):
        with pytest.raises(InputError):
            check_folder("-o", path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_no_folder_is_made_in_the_place_of_a_link_to_nothing(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    for path in (tmp_path / "link", tmp_path / "link" / "x"):
        with pytest.raises(InputError, match="a link to nothing"):
            check_folder("-o", path)
    (tmp_path / "nothing").mkdir()
    check_folder("-o", tmp_path / "link")


def test_columns_of_two_dimensions_are_refused_by_name() -> None:
    with pytest.raises(InputError, match="Khat_s"):
        Params().with_columns({"Khat_s": np.full((3, 2), 900.0)})
    with pytest.raises(InputError, match="T_cl"):
        Params().with_columns({"Khat_s": np.full(3, 900.0), "T_cl": np.full(2, 1e-3)})
    with pytest.raises(InputError, match="known parameter"):
        Params().with_columns({"K_hat": np.full(3, 900.0)})
    with pytest.raises(InputError, match="at least one"):
        Params().with_columns({})
    assert Params().with_columns({"lam": np.ones((3, 16))}).lam.shape == (3, 16)


def test_a_name_of_the_greatest_length_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / ("é" * 125 + ".toml")
    assert len(os.fsencode(path.name)) == 255
    check_file("-o", path)
    write_atomic(path, b"a")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [(path.name, b"a")]


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as failed:
        write_atomic(tmp_path / "nowhere" / "a.toml", b"")
    assert failed.value.filename == f"{tmp_path / 'nowhere' / 'a.toml'}"
