"""Signals that end a centre."""

import signal
from threading import Event, Thread

import pytest

from toolkit.centre.stop_signals import stopping_by_signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_asks_for_the_end_and_a_second_ctrl_c_interrupts(number):
    before = signal.getsignal(number)
    stop = Event()
    with stopping_by_signals(stop):
        signal.raise_signal(number)
        assert stop.is_set()
        signal.raise_signal(signal.SIGTERM)  # a second one changes nothing
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(number) is before


def test_other_threads_leave_signals_as_they_are():
    handlers = []

    def run():
        with stopping_by_signals(Event()):
            handlers.append(signal.getsignal(signal.SIGTERM))

    thread = Thread(target=run)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGTERM)]
