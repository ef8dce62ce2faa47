"""`jaxmpc` and `python -m jaxmpc`: a process for one verb."""

import os
import signal
import sys
import threading
from typing import NoReturn

from jaxmpc.cli import main


def program() -> NoReturn:
    """Run a verb and end with its exit code.

    One that is interrupted, or fails, ends at once: threads that still compile would be waited for, or would meet an
    interpreter that is being taken down, and crash. Files are written whole or not at all, so that nothing is left to
    be done. Ctrl-C after the end ends nothing: the interpreter's own way out would tell of it by another code.
    """
    code = main()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if code == 130 or (code and threading.active_count() > 1):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    program()
