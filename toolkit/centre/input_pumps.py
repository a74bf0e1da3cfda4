"""Threads that hand the messages of inputs to the centre, at their time.

The clock of a replay that cannot be read or simulated at its pace is set back, so that the centre
does not fall behind it more and more."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from threading import Event, Lock, Thread

from toolkit.centre.clock import Clock, RunningClock
from toolkit.centre.input_process import read_in_process
from toolkit.centre.message_queue import MessageQueue
from toolkit.centre.sensor_message import SensorInput, SensorMessage, SensorSetup

_END_S = 3.0  # in which threads must end
_POLL_S = 0.2  # a waiting thread looks for the end of the run this often
_MAX_LAG_S = 1.0  # of a replay, in seconds of this machine, before its clock is set back

Reader = Callable[[SensorInput, Event], Iterator[SensorMessage]]


def read_in_thread(source: SensorInput, stop: Event) -> Iterator[SensorMessage]:
    """Yield the messages of an input, read by the calling thread."""
    return source.messages(stop)


class InputPumps:
    """Inputs of a centre, a thread for each.

    A replay begins when every input has its first message. Inputs that are not live are read by
    processes.

    Args:
        inputs: Inputs, all live or none.
        setups: Poses and clock offsets by sensor.
        queue: Queue that gets the messages, closed after the last one.
        stop: Ends the threads when it is set.
        speed: Seconds of a replay in a second.
        read: Reader of inputs that are not live.

    Attributes:
        set_back_s: Seconds by which the clock of a replay was set back so far.

    Raises:
        ValueError: Live inputs are mixed with others.
    """

    def __init__(
        self,
        inputs: Sequence[SensorInput],
        setups: Mapping[str, SensorSetup],
        queue: MessageQueue,
        stop: Event,
        *,
        speed: float = 1.0,
        read: Reader = read_in_process,
    ) -> None:
        """Make a thread for each input; `start` starts them.

        Raises ValueError for live sensors next to replays."""
        self._is_live = inputs[0].is_live
        if any(source.is_live != self._is_live for source in inputs):
            raise ValueError("live sensors and replays have different clocks: give one kind only")
        self._setups = setups
        self._queue = queue
        self._speed = speed
        self._read = read_in_thread if self._is_live else read
        self._stop = stop
        self._started = Event()
        self._clock = RunningClock(time.time())
        self._clock_lock = Lock()  # held by the thread that sets the clock back
        self.set_back_s = 0.0
        self._first_messages: list[SensorMessage] = []
        self._error: Exception | None = None
        self._ready = [Event() for _ in inputs]
        self._done = [Event() for _ in inputs]
        self._threads = [
            Thread(target=self._pump, args=(source, number), daemon=True)
            for number, source in enumerate(inputs)
        ]

    def start(self) -> Clock:
        """Start the threads, and return the centre's clock once the first messages are there.

        Raises the error of an input."""
        for thread in self._threads:
            thread.start()
        if not self._is_live:
            for ready in self._ready:
                self._await(ready)
            self.check()
            if self._first_messages:
                start_s = min(message.arrival_s for message in self._first_messages)
                self._clock = RunningClock(start_s, self._speed)
        self._started.set()
        return self._clock

    def check(self) -> None:
        """Raise the error of an input, if one failed."""
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """End the threads and the processes."""
        self._stop.set()
        self._started.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(_END_S)

    def _pump(self, source: SensorInput, number: int) -> None:
        """Put the messages of an input into the queue, and close it after the last input's.

        Of a replay, the first message waits until all inputs are ready. number: the input's."""
        try:
            is_first = True
            for message in self._read(source, self._stop):
                if is_first and not self._is_live:
                    self._first_messages.append(message)
                    self._ready[number].set()
                    self._await(self._started)
                is_first = False
                if not self._put(message):
                    break
        except (ValueError, OSError, ImportError, RuntimeError) as error:
            self._error = error
        finally:
            self._ready[number].set()
            self._done[number].set()
            if all(done.is_set() for done in self._done):
                self._queue.close()

    def _await(self, event: Event) -> None:
        """Wait for an event, or the end of the run."""
        while not event.wait(_POLL_S) and not self._stop.is_set():
            pass

    def _put(self, message: SensorMessage) -> bool:
        """Put a message into the queue at its time; return False if the run has ended."""
        if not self._is_live:
            self._clock.wait(message.arrival_s, self._stop)
            self._limit_lag(message.arrival_s)
        message = replace(message, arrival_s=max(self._clock.now(), message.arrival_s))
        if self._stop.is_set():
            return False
        setup = self._setups.get(message.sensor)
        self._queue.put(message if setup is None else setup.correct(message))
        return True

    def _limit_lag(self, arrival_s: float) -> None:
        """Set the clock back to the arrival of a message (s) that comes much too late."""
        with self._clock_lock:
            lag_s = self._clock.now() - arrival_s
            if lag_s > _MAX_LAG_S * self._speed:
                self._clock.set_back(lag_s)
                self.set_back_s += lag_s
