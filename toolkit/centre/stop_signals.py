"""Signals that end a running centre after the frame that it works on."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event

_SIGNALS = (signal.SIGTERM, signal.SIGINT)


@contextmanager
def stopping_by_signals(stop: Event) -> Iterator[None]:
    """Let SIGTERM and Ctrl-C set an event during a block; a second Ctrl-C interrupts it.

    Outside the main thread it has no effect, as only that thread may handle signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: object) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()

    previous_handlers = {number: signal.signal(number, handle) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
