"""Who froze a controller: an Ed25519 signature in a file beside it, made and verified by `cryptography`.

The seal tells that a file is what was written, not by whom: whoever changes it can seal it again. A signature can be
made with the private key alone. Its file, FILE.sig, has three lines:

    jaxmpc controller signature 1
    ssh-ed25519 AAAA…                the public key, as OpenSSH writes it
    …==                              the signature, in base64

over the first line, a line feed and the bytes of the controller. Keys are those of `ssh-keygen -t ed25519` or of
`openssl genpkey -algorithm ed25519`.
"""

import base64
import binascii
import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from jaxmpc.files.errors import InputError

TITLE = "jaxmpc controller signature 1"
ALGORITHM = "ssh-ed25519"
LENGTH = 64
"""Length of a signature [bytes]."""
LARGEST = 65_536
"""Largest file of a key or signature that is read [bytes]."""
EXTRA = "Install the extra jaxmpc[signature], which brings the library `cryptography`."


_PREFIX = b"\0\0\0\x0bssh-ed25519\0\0\0\x20"
"""What stands before the 32 bytes of a key in OpenSSH's form."""


class SignatureError(ValueError):
    """No signature that counts; the message is a sentence that says why."""


class Signature(NamedTuple):
    """A signature, and the public key (as in `ssh-ed25519 KEY`) that it claims to be of."""

    key: str
    value: bytes

    @property
    def fingerprint(self) -> str:
        """Short name of the key, as `ssh-keygen -l` prints it."""
        return fingerprint(self.key)


def path_of(artifact: Path) -> Path:
    """Where the signature of a controller stands."""
    return artifact.with_name(f"{artifact.name}.sig")


def fingerprint(key: str) -> str:
    """Short name of a public key, as `ssh-keygen -l` prints it."""
    return "SHA256:" + base64.b64encode(hashlib.sha256(base64.b64decode(key)).digest()).decode().rstrip("=")


def signed(data: bytes, private: Path, password: Callable[[], str]) -> str:
    """The text of a signature file.

    Args:
        data: Bytes of the controller.
        private: File of the key that signs, PEM or OpenSSH.
        password: Asked for one where the key is encrypted.

    Raises:
        InputError: It holds no private Ed25519 key, the password is wrong, or the library is missing.
    """
    serialization, ed25519 = _library()
    content = _content("key", private)
    remedy = "Make one by `ssh-keygen -t ed25519 -f FILE`."
    load = serialization.load_ssh_private_key if b"OPENSSH" in content else serialization.load_pem_private_key
    try:
        try:
            key = load(content, None)
        except (TypeError, ValueError) as error:
            if "password" not in str(error).lower() and "encrypted" not in str(error).lower():
                raise
            key = load(content, password().encode())
    except Exception as error:  # what a foreign file makes the library say is of many kinds
        raise InputError("key", private, f"a private Ed25519 key ({error or type(error).__name__})", remedy) from None
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise InputError("key", private, "a private Ed25519 key, not one of another kind", remedy)
    value = base64.b64encode(key.sign(_message(data))).decode()
    return f"{TITLE}\n{ALGORITHM} {_written(serialization, key.public_key())}\n{value}\n"


def public_key(path: Path) -> str:
    """The public key in a file, OpenSSH's one line or PEM; that of a private one is not taken from it.

    Raises:
        InputError: It holds no public Ed25519 key, or the library is missing.
    """
    serialization, ed25519 = _library()
    content = _content("--require-signature", path)
    remedy = "Give the public key of whoever freezes, such as FILE.pub of `ssh-keygen -t ed25519 -f FILE`."
    load = serialization.load_pem_public_key if b"BEGIN PUBLIC KEY" in content else serialization.load_ssh_public_key
    try:
        key = load(content.strip())
    except Exception as error:
        bound = f"a public Ed25519 key ({str(error) or type(error).__name__})"
        raise InputError("--require-signature", path, bound, remedy) from None
    if not isinstance(key, ed25519.Ed25519PublicKey):
        raise InputError("--require-signature", path, "a public Ed25519 key, not one of another kind", remedy)
    return _written(serialization, key)


def read(artifact: Path) -> Signature | None:
    """The signature beside a controller, not yet verified; None where there is no such file.

    Raises:
        SignatureError: It is malformed.
    """
    path = path_of(artifact)
    if not os.path.lexists(path):
        return None
    try:
        return _parsed(_content("signature", path))
    except InputError as error:
        raise SignatureError(f"{path.name}: {error}") from None


def verify(signature: Signature, data: bytes) -> None:
    """Verify that a signature is one of its key over these bytes of a controller.

    Raises:
        SignatureError: It is not.
        InputError: The library is missing.
    """
    _, ed25519 = _library()
    raw = base64.b64decode(signature.key)[-32:]
    try:
        ed25519.Ed25519PublicKey.from_public_bytes(raw).verify(signature.value, _message(data))
    except Exception:  # InvalidSignature says nothing more, and a key that is no point of the curve raises others
        why = "the signature is not one of this file: it was changed, or frozen again, after it was signed"
        raise SignatureError(why) from None


def require(artifact: Path, data: bytes, key: str) -> Signature:
    """The signature of a controller by a key that is trusted.

    Args:
        artifact: File of the controller.
        data: Its bytes, as they were read once.
        key: From `public_key`.

    Raises:
        SignatureError: There is none, it is malformed, of another key, or of other bytes.
        InputError: The library is missing.
    """
    signature = read(artifact)
    if signature is None:
        raise SignatureError(
            f"it is not signed: there is no {path_of(artifact).name} beside it; `jaxmpc sign` makes it"
        )
    if signature.key != key:
        whose = f"it is signed by {signature.fingerprint}, and {fingerprint(key)} is required"
        raise SignatureError(f"{whose}: ask who froze it")
    verify(signature, data)
    return signature


def _parsed(content: bytes) -> Signature:
    """The only form that is taken: no other bytes mean the same."""
    try:
        title, owner, value, rest = content.decode("ascii").split("\n")
        algorithm, key = owner.split(" ")
        signature = Signature(key, base64.b64decode(value, validate=True))
        blob = base64.b64decode(key, validate=True)
    except (ValueError, binascii.Error):
        raise SignatureError("its signature is not three lines as `jaxmpc sign` writes them") from None
    if title != TITLE or algorithm != ALGORITHM or rest:
        raise SignatureError(f"its signature is not a {TITLE!r}")
    if len(signature.value) != LENGTH or base64.b64encode(signature.value).decode() != value:
        raise SignatureError("its signature is not one of Ed25519")
    if blob[:-32] != _PREFIX or len(blob) != len(_PREFIX) + 32 or base64.b64encode(blob).decode() != key:
        raise SignatureError("its signature names no key of Ed25519")
    return signature


def _message(data: bytes) -> bytes:
    return f"{TITLE}\n".encode() + data


def _written(serialization: Any, key: Any) -> str:
    text = key.public_bytes(serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH).decode()
    return str(text.split(" ")[1])


def _content(name: str, path: Path) -> bytes:
    """The bytes of a small regular file.

    Raises:
        InputError: It is no such file, or cannot be read.
    """
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            if stat.S_ISREG(os.fstat(file.fileno()).st_mode) and len(content := file.read(LARGEST + 1)) <= LARGEST:
                return content
    except OSError as error:
        raise InputError(name, path, f"a file that can be read ({error.strerror})", "Give its path.") from None
    raise InputError(name, path, f"a regular file of at most {LARGEST} bytes", "Give the file of a key.")


def _library() -> Any:
    """The two modules of `cryptography` that are needed.

    Raises:
        InputError: It is not installed.
    """
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError:
        raise InputError("cryptography", "missing", "installed where signatures are made or verified", EXTRA) from None
    return serialization, ed25519
