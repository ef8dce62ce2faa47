"""Who froze a controller: signatures that count, and all that must not."""

import base64
import random
import subprocess
import sys

import pytest

from deploy.controller.file import to_bytes
from deploy.controller.signature import TITLE, SignatureError, fingerprint, path_of, public_key, read, require
from jaxmpc.cli import main

NO_LIBRARY = "import sys; sys.modules['cryptography'] = None; from jaxmpc.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def frozen(arm_artifact, tmp_path):
    path = tmp_path / "controller.npz"
    path.write_bytes(to_bytes(arm_artifact))
    return path


def keys(folder, name, form="OpenSSH", password=b""):
    """Files of a new private and public key."""
    serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")
    from cryptography.hazmat.primitives.asymmetric import ed25519

    made = ed25519.Ed25519PrivateKey.generate()
    private_form = {"OpenSSH": serialization.PrivateFormat.OpenSSH, "PEM": serialization.PrivateFormat.PKCS8}[form]
    locked = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    private, public = folder / name, folder / f"{name}.pub"
    private.write_bytes(made.private_bytes(serialization.Encoding.PEM, private_form, locked))
    written = (
        (serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH)
        if form == "OpenSSH"
        else (serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    )
    public.write_bytes(made.public_key().public_bytes(*written) + (b" somebody@here\n" if form == "OpenSSH" else b""))
    return private, public


@pytest.fixture
def key(tmp_path):
    return keys(tmp_path, "key")


@pytest.fixture
def signed(frozen, key):
    assert main(["sign", str(frozen), "--key", str(key[0])]) == 0
    return frozen


@pytest.mark.parametrize("form", ["OpenSSH", "PEM"])
def test_a_signature_of_the_key_that_is_required_counts(frozen, tmp_path, capsys, form):
    private, public = keys(tmp_path, "mine", form)
    assert main(["sign", str(frozen), "--key", str(private)]) == 0
    found = require(frozen, frozen.read_bytes(), public_key(public))
    assert found.fingerprint in capsys.readouterr().out
    main(["check", str(frozen), "--require-signature", str(public)])
    assert f"signed      by {found.fingerprint}, the key that is required" in capsys.readouterr().out
    main(["check", str(frozen)])
    assert f"signed      by {found.fingerprint};" in capsys.readouterr().out


def test_the_signature_is_one_of_ed25519_over_title_and_file_and_the_name_that_of_ssh_keygen(signed, key, tmp_path):
    from cryptography.hazmat.primitives import serialization

    title, owner, value = path_of(signed).read_text().splitlines()
    public = serialization.load_ssh_public_key(owner.encode())
    public.verify(base64.b64decode(value), f"{title}\n".encode() + signed.read_bytes())
    try:
        said = subprocess.run(["ssh-keygen", "-l", "-f", str(key[1])], capture_output=True, text=True, check=True)
    except OSError:
        pytest.skip("no ssh-keygen here")
    assert said.stdout.split()[1] == fingerprint(owner.split()[1])


def test_a_key_with_a_password_asks_for_it(frozen, tmp_path, monkeypatch, capsys):
    private, _ = keys(tmp_path, "locked", "PEM", b"open sesame")
    monkeypatch.setattr("getpass.getpass", lambda _: "open sesame")
    assert main(["sign", str(frozen), "--key", str(private)]) == 0
    monkeypatch.setattr("getpass.getpass", lambda _: "open barley")
    assert main(["sign", str(frozen), "--key", str(private)]) == 2
    assert "private Ed25519 key" in capsys.readouterr().err


def test_every_flipped_bit_of_the_signature_is_refused(signed, key):
    path, public, data = path_of(signed), public_key(key[1]), signed.read_bytes()
    whole = path.read_bytes()
    require(signed, data, public)
    for bit in range(8 * len(whole)):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        with pytest.raises(SignatureError):
            require(signed, data, public)


def test_flipped_bits_of_the_controller_are_refused(signed, key):
    data, public, dice = signed.read_bytes(), public_key(key[1]), random.Random(0)
    for bit in (0, 8 * len(data) - 1, *(dice.randrange(8 * len(data)) for _ in range(200))):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(SignatureError, match="not one of this file"):
            require(signed, bytes(flipped), public)


def test_other_bytes_than_three_lines_are_refused(signed, key):
    path, public, data = path_of(signed), public_key(key[1]), signed.read_bytes()
    text = path.read_text()
    title, owner, value, _ = text.split("\n")
    zero = "AA" * 42 + "AA=="
    for wrong in (
        *("", text + "\n", text.rstrip(), text.replace("\n", "\r\n"), f"{title}\n{owner} me\n{value}\n"),
        *(f"{title}\n{owner}\n{zero}\n", f"{TITLE[:-1]}2\n{owner}\n{value}\n", f"{title}\nssh-rsa AAAA\n{value}\n"),
        *("x" * 100_000, f"{title}\n{owner}\n{value[:-4]}\n", f"{title}\n{owner}\n{value}\n{value}\n"),
        f"{title}\n{owner}\n{value}\nand more",
    ):
        path.write_text(wrong, newline="")
        with pytest.raises(SignatureError):
            require(signed, data, public)


@pytest.mark.parametrize("verb", [["check"], ["run", "--lockstep"]])
def test_no_signature_and_another_key_are_refused_before_anything_is_read(frozen, tmp_path, verb, capsys):
    private, public = keys(tmp_path, "mine")
    command = [verb[0], str(frozen), *verb[1:], "--require-signature", str(public)]
    assert main(command) == 1
    assert "not signed" in capsys.readouterr().err
    assert main(["sign", str(frozen), "--key", str(keys(tmp_path, "other")[0])]) == 0
    assert main(command) == 1
    assert "ask who froze it" in capsys.readouterr().err
    frozen.write_bytes(b"nothing that could be read")
    path_of(frozen).unlink()
    assert main(command) == 1
    assert "not signed" in capsys.readouterr().err
    assert private.exists()


def test_a_controller_that_was_frozen_again_is_told_by_check(signed, key, plain_again, capsys):
    signed.write_bytes(plain_again)
    assert main(["check", str(signed)]) == 1
    assert "frozen again" in capsys.readouterr().err


@pytest.fixture
def plain_again(arm_artifact):
    from dataclasses import replace

    return to_bytes(replace(arm_artifact, params={**arm_artifact.params, "note": 1.0}))


@pytest.mark.parametrize("flag", ["--key", "--require-signature"])
@pytest.mark.parametrize("content", [None, b"", b"no key", b"-----BEGIN PUBLIC KEY-----\n-----END PUBLIC KEY-----"])
def test_what_is_no_key_is_wrong_input(frozen, tmp_path, capsys, flag, content):
    pytest.importorskip("cryptography")
    path = tmp_path / "wrong"
    if content is not None:
        path.write_bytes(content)
    verb = "sign" if flag == "--key" else "check"
    assert main([verb, str(frozen), flag, str(path)]) == 2
    assert str(path) in capsys.readouterr().err
    assert not path_of(frozen).exists()


def test_a_key_of_another_kind_is_wrong_input(frozen, tmp_path, capsys):
    serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")
    from cryptography.hazmat.primitives.asymmetric import ec

    made = ec.generate_private_key(ec.SECP256R1())
    forms = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (tmp_path / "ec").write_bytes(made.private_bytes(*forms))
    assert main(["sign", str(frozen), "--key", str(tmp_path / "ec")]) == 2
    assert "not one of another kind" in capsys.readouterr().err


def test_what_no_robot_would_take_is_not_signed(tmp_path, key, capsys):
    path = tmp_path / "broken.npz"
    path.write_bytes(b"broken")
    assert main(["sign", str(path), "--key", str(key[0])]) == 1
    assert "refused" in capsys.readouterr().err
    assert not path_of(path).exists()


@pytest.mark.parametrize("name", ["folder", "params.toml"])
def test_what_cannot_be_a_controller_is_wrong_input_as_for_check_and_run(tmp_path, key, capsys, name):
    made = tmp_path / name
    made.mkdir() if name == "folder" else made.write_text("[params]\n")
    assert main(["sign", str(made), "--key", str(key[0])]) == main(["check", str(made)]) == 2
    told = capsys.readouterr().err.splitlines()
    assert told[0].removeprefix("jaxmpc sign") == told[1].removeprefix("jaxmpc check")


def test_without_the_library_a_signature_that_is_wanted_is_refused_and_one_that_is_not_is_told(frozen, tmp_path):
    blob = b"\0\0\0\x0bssh-ed25519\0\0\0\x20" + bytes(32)
    owner, value = (base64.b64encode(each).decode() for each in (blob, bytes(64)))
    path_of(frozen).write_text(f"{TITLE}\nssh-ed25519 {owner}\n{value}\n")
    assert read(frozen) is not None
    (tmp_path / "key.pub").write_text("ssh-ed25519 AAAA")

    def said(*words):
        command = [sys.executable, "-c", NO_LIBRARY, *words]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    for wanted in (
        ["run", str(frozen), "--lockstep", "--require-signature", str(tmp_path / "key.pub")],
        ["check", str(frozen), "--require-signature", str(tmp_path / "key.pub")],
        ["sign", str(frozen), "--key", str(tmp_path / "key.pub")],
    ):
        ended = said(*wanted)
        assert ended.returncode == 2, ended.stderr
        assert "jaxmpc[signature]" in ended.stderr
        assert "Traceback" not in ended.stderr
    assert "NOT VERIFIED" in said("check", str(frozen)).stdout
