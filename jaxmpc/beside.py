"""Threads and processes for what goes on beside the rest, such as compiling; who fails does not wait for them."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import forkserver, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from threading import Thread
from types import TracebackType
from typing import Any, Self

from jaxmpc.terminal.process import silence_libraries


class Beside(ThreadPoolExecutor):
    """Threads; who is interrupted or fails does not wait for them."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for them, unless Ctrl-C has struck, or something has failed whose user would wait minutes for a word."""
        self.shutdown(wait=kind is None, cancel_futures=kind is not None)


class Apart:
    """A process that calls one function, for what keeps Python busy: threads take turns there.

    It ends with its block. What it is given and what comes of it are copies.
    """

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Begin.

        Args:
            function: Of a module.
            *arguments: Its arguments.
        """
        context = get_context("spawn")
        self._answer, answer = context.Pipe(duplex=False)
        self._process = context.Process(target=_answered, args=(answer, function, arguments), daemon=True)
        with unheard():
            self._process.start()
        answer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End it, whether it is done or not."""
        self._process.terminate()
        self._process.join()

    def result(self) -> Any:
        """What the function returns, once it does.

        Raises:
            Exception: What the function has raised.
            ChildProcessError: The process has ended before, as by a lack of memory.
        """
        try:
            failed, found = heard(self._answer)
        except EOFError:
            self._process.join()
            raise ChildProcessError(f"a process has ended with code {self._process.exitcode}") from None
        if failed:
            raise found
        return found


def forks_of(module: str) -> BaseContext:
    """Have processes fork from one that has imported a module, which takes a core seconds; it begins with that now.

    Args:
        module: Its name; the same in every call.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([module])
    with unheard():
        forkserver.ensure_running()
    return context


def heard(sender: Connection) -> Any:
    """What another process sends, once it does.

    Raises:
        EOFError: It has ended.
    """
    # Python hears a Ctrl-C between two of its own steps: one that strikes just before a wait is heard after it.
    while not sender.poll(timeout=1.0):
        continue
    return sender.recv()


@contextmanager
def unheard() -> Iterator[None]:
    """Within it, processes begin that do not hear Ctrl-C, which strikes all of a terminal: they are told to end."""
    # What looks after their memory goes first: to begin that lets this thread hear Ctrl-C again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """Have this process end as soon as the one that has begun it does, whatever it is at and however that one ends."""

    def watch() -> None:
        if parent := parent_process():
            parent.join()
            os._exit(0)

    Thread(target=watch, daemon=True).start()


def _answered(answer: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    end_with_parent()
    silence_libraries()
    try:
        answer.send((False, function(*arguments)))
    except Exception as error:  # it is raised where the result is asked for
        answer.send((True, error))
