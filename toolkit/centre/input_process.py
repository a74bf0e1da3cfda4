"""Inputs that another process reads, so that unpacking does not hold up detection.

The process reads some messages ahead, so that they are there in time when detection needs all
cores for a while."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import Empty, Queue
from threading import Event, Thread

from toolkit.centre.sensor_message import SensorInput, SensorMessage

MAX_AHEAD_MESSAGES = 24  # that are read before their time
_NICENESS = 5  # it has read ahead, so that detection goes first
_END_S = 2.0  # in which a stopped process must end
_POLL_S = 0.2
_Content = SensorMessage | str | None  # a message, the text of an error, or the end


def read_in_process(source: SensorInput, stop: Event) -> Iterator[SensorMessage]:
    """Yield the messages of an input, which another process reads ahead.

    Raises ValueError with the text of an error in that process, and if the process dies."""
    context = multiprocessing.get_context("spawn")  # forking would copy locks of threads
    connection, other_end = context.Pipe()
    process = context.Process(target=_send_messages, args=(other_end,), daemon=True)
    process.start()
    other_end.close()  # the process has the other end, and its death shows here
    try:
        # as an argument, a large input would block for ever if the process died before it read it
        with suppress(BrokenPipeError, ConnectionResetError):
            connection.send(source)
        while not stop.is_set():
            if not connection.poll(_POLL_S):
                continue
            try:
                content: _Content = connection.recv()
            except (EOFError, ConnectionResetError):
                raise ValueError(
                    "the process that reads the input died: start again, in a script under "
                    '`if __name__ == "__main__":`'
                ) from None
            if content is None:
                return
            if isinstance(content, str):
                raise ValueError(content)
            yield content
    finally:
        connection.close()
        process.terminate()
        process.join(_END_S)


def _send_messages(connection: Connection) -> None:
    """Receive an input, then send all its messages and at the end None, or the text of an error.

    A thread reads them ahead. If it dies of an unexpected error, the process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    source: SensorInput = connection.recv()
    contents: Queue[_Content] = Queue(MAX_AHEAD_MESSAGES)
    reader = Thread(target=_read_messages, args=(source, contents), daemon=True)
    reader.start()
    with suppress(BrokenPipeError, ConnectionResetError):  # the parent has ended
        while reader.is_alive() or not contents.empty():
            with suppress(Empty):
                connection.send(contents.get(timeout=_POLL_S))


def _read_messages(source: SensorInput, contents: "Queue[_Content]") -> None:
    """Put all messages of an input into a queue, then None, or the text of an error instead."""
    never_stop = Event()  # the process is terminated instead
    try:
        for message in source.messages(never_stop):
            contents.put(message)
        contents.put(None)
    except (ValueError, OSError, ImportError) as error:
        contents.put(f"the input cannot be read on: {error}")
