"""Inputs that another process reads, so that unpacking does not hold up detection."""

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from threading import Event

from toolkit.centre.sensor_message import SensorInput, SensorMessage

_END_S = 2.0  # in which a stopped process must end
_POLL_S = 0.2


def read_in_process(source: SensorInput, stop: Event) -> Iterator[SensorMessage]:
    """Yield the messages of an input, which another process reads ahead by a message.

    Raises ValueError with the text of an error in that process, and if the process dies."""
    context = multiprocessing.get_context("spawn")  # forking would copy locks of threads
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send_messages, args=(source, sender), daemon=True)
    process.start()
    sender.close()  # the process has the other end, and its death shows here
    try:
        while not stop.is_set():
            if not receiver.poll(_POLL_S):
                continue
            try:
                content = receiver.recv()
            except EOFError:
                raise ValueError("the process that reads the input died: start again") from None
            if content is None:
                return
            if isinstance(content, str):
                raise ValueError(content)
            yield content
    finally:
        receiver.close()
        process.terminate()
        process.join(_END_S)


def _send_messages(source: SensorInput, sender: Connection) -> None:
    """Send all messages of an input, then None; the text of an error instead."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    with suppress(BrokenPipeError, ConnectionResetError):  # the parent has ended
        try:
            for message in source.messages(Event()):
                sender.send(message)
            sender.send(None)
        except (ValueError, OSError, ImportError) as error:
            if isinstance(error, BrokenPipeError | ConnectionResetError):
                raise
            sender.send(f"the input cannot be read on: {error}")
