"""`jaxmpc sign`: say with a key who froze a controller."""

import argparse
import getpass
import sys
from pathlib import Path

from jaxmpc.files.errors import InputError


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("artifact", type=Path, help="a frozen controller, as `jaxmpc freeze` writes it (.npz)")
    parser.add_argument(
        "--key", type=Path, required=True, help="private Ed25519 key, of `ssh-keygen -t ed25519 -f KEY` or in PEM"
    )


def run(args: argparse.Namespace) -> int:
    """Check a controller and sign it; 1 if it is refused.

    Raises:
        InputError: There is no such file, it can be no controller, or there is no such key.
    """
    from deploy.controller import signature
    from deploy.controller.file import ArtifactError, check_kind, from_bytes, read
    from jaxmpc.files.sealed import write_atomic

    if not args.artifact.exists():
        remedy = "Make one with `jaxmpc freeze PARAMS.toml -o FILE`."
        raise InputError("artifact", args.artifact, "an existing file", remedy)
    check_kind(args.artifact)
    try:
        data = read(args.artifact)
        from_bytes(data)  # nobody puts his name to what no robot would take
    except ArtifactError as error:
        print(f"jaxmpc sign: refused: {args.artifact}: {error}", file=sys.stderr)
        return 1
    text = signature.signed(data, args.key, lambda: getpass.getpass(f"password of {args.key}: "))
    path = signature.path_of(args.artifact)
    write_atomic(path, text.encode())
    made = signature.read(args.artifact)
    assert made is not None
    signature.verify(made, data)
    print(f"signed: {path}, key {made.fingerprint}")
    print("`jaxmpc run --require-signature KEY.pub` takes only what is signed so")
    return 0
