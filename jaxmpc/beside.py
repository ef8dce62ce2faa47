"""Threads and processes for what goes on beside the rest, such as compiling; who fails does not wait for them."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import forkserver, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
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
        self._process, self._answer = spoken_with(_answered, function, arguments)

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


def spoken_with(function: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """A process that hears no Ctrl-C and ends with this one, and the way to speak with it.

    Args:
        function: Of a module; called there with the other end of that way, and with its arguments.
        *arguments: These.
    """
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_begun, args=(function, there, *arguments), daemon=True)
    with _unheard():
        process.start()
    there.close()
    return process, here


def forks_of(module: str) -> BaseContext:
    """Have processes fork from one that has imported a module, which takes a core seconds; it begins with that now.

    Args:
        module: Its name; the same in every call.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([module])
    with _unheard():
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
def _unheard() -> Iterator[None]:
    """Within it, processes begin that do not hear Ctrl-C, which strikes all of a terminal: they are told to end."""
    # What looks after their memory goes first: to begin that lets this thread hear Ctrl-C again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begun(function: Callable[..., None], there: Connection, *arguments: Any) -> None:
    """There; it ends as soon as the one that has begun it does, whatever it is at and however that one ends."""

    def watch() -> None:
        if parent := parent_process():
            parent.join()
            os._exit(0)

    Thread(target=watch, daemon=True).start()
    silence_libraries()
    function(there, *arguments)


def _answered(answer: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    try:
        answer.send((False, function(*arguments)))
    except Exception as error:  # it is raised where the result is asked for
        answer.send((True, error))
