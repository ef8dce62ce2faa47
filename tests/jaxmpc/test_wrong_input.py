"""1500 wrong inputs over all verbs: each ends with 2 and one plain line, writes nothing and takes no 5 s.

They are generated, the same ones every time: wrong words, values, paths, files and tables. In this process, where a
call costs milliseconds; a sample of them in processes of their own.
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.cli import VERBS, main, whole_parser

WANTED = 1500
ROOT = Path(__file__).parents[2]
LIMIT_S = 5.0
NO_NUMBER = ("abc", "1e", "0x10", "1,5", "--", "½", "9" * 5000 + "x", "\x1b[2J", "1\n2", "", "1__0", "nan?", "∞")
NO_WORD = ("bogus", "TABLE-1", "", "\x1b]0;x\x07", "a\nb", "‮abc", "x" * 3000, "ταβλε", "text ")
POSITIONAL = {
    "simulate": ["table-1"], "sweep": ["good-sweep.toml"], "tune": ["demo-tune"], "limit": ["table-1"],
    "trials": ["text"], "freeze": ["text"], "identify": ["motion.csv"], "check": ["none.npz"], "run": ["none.npz"],
    "replay": ["none.npz"],
}  # fmt: skip
"""What goes before a wrong option."""

TABLES = {
    "experiment": {
        "physics": '"wan"', "duration": "0", "settle": "99.0", "stiffness": "[]", "damping": '"real"', "delay": "3",
        "velocity_lowpass": "-1", "sampling_time": "1.0", "force_limit": "0", "name": '"../../x"', "motion": "3",
        "reference": '"z"', "sensor": "[]", "tissue": "1", "arm": "true", "durationn": "1", "stifness": "[1.0]",
    },
    "motion": {
        "kind": '"recordin"', "scale": "-1", "phases": '"x"', "file": '"a\\u0000b"', "unit": '"cm"', "repeat": "1",
        "start": "-1", "fade": '"long"', "rhythm": '"bogus"', "seed": "-1", "knid": '"none"',
    },
    "reference": {"x": '"up"', "y": "[1, 2]", "z": '[{ kind = "rampp" }]', "w": "1", "preview": "3"},
    "sensor": {"noise": "-1", "lsb": "[1]", "lowpass_hz": '"x"', "seed": "1.5", "nose": "1", "kalman": '"x"'},
    "tissue": {"kind": '"jelly"', "attached": "1", "kindd": "1"},
    "arm": {"posture": "[0]", "cable_hz": "-1", "substeps": "0", "coulomb": '"x"', "integrator": '"rk4"', "tool": "1"},
    "params": {
        "lam": "-1", "delta": "nan", "Q_p": "inf", "Q_x": '"x"', "R": "0", "T_cl": "0", "K2": "-1", "Khat_s": "0.5",
        "Hp": "65", "Hu": "0", "architecture": '"pid"', "disturbance_order": "4", "guarded": "1", "lamda": "1",
        "knots": "3", "listening": "3",
    },
    "sweep": {"kind": '"gird"', "axes": "3", "rows": "0", "seed": "-1", "precision": '"float16"', "axis": "1"},
    "tune": {"starts": "0", "steps": "-1", "free": "3", "startss": "1", "diagonals": '["x"]', "seed": '"x"'},
    "goals": {"M_s": "1.0", "M_ss": "2", "phase_margin_deg": "-1", "ideal": "1", "soft": "{}", "rms": "nan"},
    "scenarios": {"rhythms": '["x"]', "friction": "2", "mass": "-1", "delays": "[3]", "rythms": "[]"},
    "risk": {"kind": '"mad"', "over": "1"},
}  # fmt: skip
"""A wrong value of every table's keys, and keys that do not exist."""
ANY_VALUE = (
    *(
        "[" * 4000 + "]" * 4000,
        "9" * 5000,
        "9" * 401,
        '"\\u0000"',
        '"\\u001b[31m"',
        "1979-05-27T07:32:00Z",
        "{ a.b = 1 }",
    ),
    *("[" * 40 + "]" * 40, '"""\nline\n"""', "[[1], [2]]"),
)
"""Wrong wherever they stand."""
BROKEN = (
    *(
        b"\xff\xfe",
        "a = 1".encode("utf-16"),
        b"\x00" * 100,
        b"= 1",
        b"[",
        b"[a\n",
        b"a = 1\na = 2",
        b"\x1b[2J",
        b"PK\5\6",
    ),
    *(
        b"{" * 5000,
        b"x = " + b"{x = " * 3000,
        b".".join([b"a"] * 9000) + b" = 1",
        b"[a]\n[a]",
        b"\xef\xbb\xbf\xef\xbb\xbf",
    ),
)
"""What is no TOML."""
OF_VERB = {
    "simulate": ("experiment", "motion", "reference", "sensor", "tissue", "arm"),
    "limit": ("experiment", "motion", "reference", "sensor", "tissue", "arm"),
    "trials": ("params",),
    "freeze": ("params",),
    "sweep": ("experiment", "motion", "sensor", "params", "sweep"),
    "tune": ("experiment", "motion", "sensor", "params", "tune", "goals", "scenarios", "risk"),
}
"""Tables of the file that a verb reads first."""


def in_file(verb: str, table: str, key: str, value: str) -> str:
    """The file of a verb with one wrong entry."""
    nested = table in ("motion", "reference", "sensor", "tissue", "arm")
    if verb in ("sweep", "tune"):
        header = f"experiment.{table}" if nested else table
        rest = (
            "[sweep.axes]\nlam = [1.0, 2.0]\n" if verb == "sweep" and not (table == "sweep" and key == "axes") else ""
        )
        kind = 'kind = "grid"\n' if table == "sweep" and key != "kind" else ""
        more = '[sweep]\nkind = "grid"\n' if verb == "sweep" and table != "sweep" else ""
        return f"[{header}]\n{kind}{key} = {value}\n{more}{rest}"
    return f"{key} = {value}\n" if table == "experiment" else f"[{table}]\n{key} = {value}\n"


def wrong_words() -> Iterator[list[str]]:
    """Command lines whose words are wrong."""
    for word in (*NO_WORD[:1], *NO_WORD[3:], "sweeep", "simulat", "Tune"):
        yield [word or "?"]
    parser = whole_parser()
    for verb in VERBS:
        start = POSITIONAL.get(verb, [])
        known = parser.of_verb(verb).taking_values()
        for option in ("--bogus", "--stifness", "--\x1b[2J", "--" + "x" * 4000, "--trails=3"):
            yield [verb, *start, option]
        yield [verb, *start, "surplus-\x1b[1m", "again", "and-again"] if verb != "list" else [verb, "surplus"]
        if verb not in ("demo", "doctor", "twin", "list"):
            yield [verb]
        for action in known:
            if not action.option_strings:
                continue
            name = action.option_strings[-1]
            if action.nargs is None:
                yield [verb, *start, name]
            values = NO_WORD if action.choices else NO_NUMBER if action.type in (int, float) else ()
            yield from ([verb, *start, f"{name}={value}"] for value in values)


def wrong_ranges() -> Iterator[list[str]]:
    """Numbers that a verb refuses."""
    for value in ("0", "-1", "10000000000", "99999999999999999999"):
        yield ["trials", "text", f"--trials={value}"]
    for value in ("-1", "1000000000", "99999999999999999999"):
        yield ["trials", "text", f"--seed={value}"]
    for flag in ("--sensitivity", "--chatter", "--band"):
        for value in ("nan", "-1", "-inf"):
            yield ["limit", "table-1", f"{flag}={value}"]
    for value in ("0", "1", "-1", "nan", "inf"):
        yield ["replay", "none.npz", f"--tolerance={value}"]
    for value in ("nan", "0", "inf", "-inf"):
        yield ["doctor", f"--rate={value}"]
    for flag, values in {
        "--duration": ("-1", "nan", "inf"), "--activate-after": ("-1", "nan"), "--port": ("-1", "70000"),
        "--stiffness": ("-1", "nan", "0", "1e300"), "--delay": ("-1", "9999999"), "--gap": ("nan", "inf"),
        "--tissue": NO_WORD, "--rhythm": (*NO_WORD, "none.csv", "pipe.csv", "folder.csv"), "--experiment": NO_WORD,
        "--fault": ("x", "force", "force:stuck@x", "J9:off@3", ":", "force:stuck@-1", "\x1b[2J"),
    }.items():  # fmt: skip
        yield from (["twin", f"{flag}={value}"] for value in values)
    for flag, values in {"--cores": ("0", "-1"), "--chunk": ("0", "-1", "99999999")}.items():
        yield from (["sweep", "good-sweep.toml", f"{flag}={value}"] for value in values)
    for flag in ("--max-ms", "--min-gain-db", "--min-phase-deg", "--min-delay-ms", "--max-radius"):
        yield from (["freeze", "text", f"{flag}={value}"] for value in ("nan", "-1"))
    for flag in ("--params", "--experiment", "--against"):
        for verb in ("simulate", "limit", "trials", "freeze", "run"):
            for value in NO_WORD:
                if flag in whole_parser().of_verb(verb)._option_string_actions:
                    yield [verb, *POSITIONAL[verb], f"{flag}={value or '?'}"]


PATHS = (
    "none.toml",
    "folder.toml",
    "pipe.toml",
    "zero.toml",
    "loop.toml",
    "huge.toml",
    "x" * 300 + ".toml",
    "a/b/c.toml",
)
PATHS += ("file/x.toml", "\x1b[2J.toml", "a\nb.toml", "locked\udcff.toml")


def wrong_paths() -> Iterator[list[str]]:
    """Paths of files that are none, and of places where nothing can be written."""
    for path in PATHS:
        for verb in ("simulate", "sweep", "tune", "limit", "freeze", "trials", "check", "run"):
            yield [verb, path]
        yield ["simulate", "table-1", "--params", path]
        yield ["freeze", "text", "--experiment", path]
        yield ["freeze", "text", "--experiment", "table-1-wam", "--limits", path]
        yield ["twin", "--experiment", path]
        yield ["sweep", "report", path]
        for other in ("csv", "npz"):
            yield ["identify", path.replace("toml", other)]
            yield ["replay", path.replace("toml", other), "--artifact", path]
    places = ("file/x", "none/x", "/proc/x", "x" * 300, "folder.toml/" + "y" * 300)
    for place in places:
        for verb, option, suffix in (
            ("freeze", "-o", ".npz"), ("identify", "-o", ".toml"), ("identify", "--figure", ".png"),
            ("limit", "-o", ".json"), ("replay", "--picture", ".png"),
        ):  # fmt: skip
            yield [verb, *POSITIONAL[verb], option, place + suffix]
    for place in ("file", "file/x", "/proc/x", "x" * 300):
        for verb in ("simulate", "sweep", "tune", "trials"):
            yield [verb, *POSITIONAL[verb], "-o", place]
        yield ["demo", "-o", place]
    for verb, option in (("identify", "--figure"), ("limit", "-o"), ("replay", "--picture"), ("simulate", "--video")):
        yield [verb, *POSITIONAL[verb], option, "x.odd"]


def wrong_files(folder: Path) -> Iterator[list[str]]:
    """Files with one wrong entry, or that are none at all."""
    number = 0

    def file(content: bytes, suffix: str = ".toml") -> str:
        nonlocal number
        number += 1
        (folder / f"w{number}{suffix}").write_bytes(content)
        return f"w{number}{suffix}"

    for verb, tables in OF_VERB.items():
        for table in tables:
            for key, value in TABLES[table].items():
                yield [verb, file(in_file(verb, table, key, value).encode())]
            keys = list(TABLES[table])
            for place, value in enumerate(ANY_VALUE):
                yield [verb, file(in_file(verb, table, keys[place % len(keys)], value).encode())]
        for content in BROKEN:
            yield [verb, file(content)]
    for header in ("", "t,x,y", "t,x,y,z", "t,q1,q2,q3,q4,tau1,tau2,tau3,tau4", "\x1b[2J", "," * 5000, "t" * 10**6):
        for row in ("", "1,2,3", "a,b,c,d", "nan,0,0,0", "1e999,0,0,0", "\x1b[2J,0,0,0", "0,0,0,0\n0,0,0,0", "\0"):
            data = f"{header}\n{row}\n".encode()
            yield ["identify", file(data, ".csv")]
            yield ["identify", file(data, ".npz")]
            yield ["twin", "--rhythm", file(data, ".csv")]
            spec = f'[motion]\nkind = "recording"\nfile = "{file(data, ".csv")}"\n'
            yield ["simulate", file(spec.encode())]
            yield ["replay", file(data, ".npz"), "--artifact", "none.npz"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with things that no verb should read for ever, or write over."""
    made = tmp_path_factory.mktemp("wrong")
    for suffix in ("toml", "csv", "npz"):
        (made / f"folder.{suffix}").mkdir()
        os.mkfifo(made / f"pipe.{suffix}")
        (made / f"zero.{suffix}").symlink_to("/dev/zero")
        (made / f"loop.{suffix}").symlink_to(f"loop.{suffix}")
        (made / f"huge.{suffix}").touch()
        os.truncate(made / f"huge.{suffix}", 2**40)
    (made / "file").write_text("kept")
    (made / "good-sweep.toml").write_text('[sweep]\nkind = "grid"\n[sweep.axes]\nlam = [1.0, 2.0]\n')
    t = np.arange(2000) * 1e-3
    np.savetxt(made / "motion.csv", np.column_stack([t] * 9), delimiter=",", header="t,x", comments="")
    return made


def all_of_them(folder: Path) -> list[list[str]]:
    cases = [*wrong_words(), *wrong_ranges(), *wrong_paths(), *wrong_files(folder)]
    unique = list({tuple(case): case for case in cases}.values())
    random.Random(18).shuffle(unique)
    return unique


def there(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in sorted(folder.rglob("*"))}


@pytest.mark.oracle
def test_wrong_inputs_end_with_2_and_one_plain_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cases = all_of_them(folder)
    assert len(cases) >= WANTED
    monkeypatch.chdir(folder)
    # What a verb keeps elsewhere, or forgets, would land here.
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(elsewhere))
    for name in ("HOME", "XDG_CACHE_HOME", "TMPDIR"):
        monkeypatch.setenv(name, str(elsewhere))
    before, names, failed = there(folder), set(os.listdir(folder)), []
    for case in cases:
        began = time.process_time()
        try:
            code: object = main(case)
        except SystemExit as stopped:
            code = stopped.code
        except Exception as error:
            code = f"{type(error).__name__}: {error}"[:200]
        took, (out, err) = time.process_time() - began, capsys.readouterr()
        lines, written = (out + err).splitlines(), {*os.listdir(folder), *os.listdir(elsewhere)} - names
        if code != 2 or len(lines) != 1 or not lines[0].isprintable() or took > LIMIT_S or written:
            failed.append((case, code, (out + err)[-300:], round(took, 1), written))
            names |= written
    told = "\n".join(f"{[word[:60] for word in case]} → {rest}" for case, *rest in failed)
    assert not failed, f"{len(failed)} of {len(cases)}:\n{told}"
    assert there(folder) == before


@pytest.mark.slow
def test_a_sample_in_processes_of_their_own(folder: Path) -> None:
    """Every hundredth: with the interpreter's own start and end, and Python's warnings as errors."""
    for case in all_of_them(folder)[::100]:
        words = [word for word in case if "\0" not in word]
        command = [sys.executable, "-m", "jaxmpc", *words]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=folder, env=environment, timeout=60, check=False
        )
        assert done.returncode == 2, (case, done.stderr)
        assert len((done.stdout + done.stderr).splitlines()) == 1, (case, done.stderr)
