"""Tell when code is compiled. numba does that on a machine's first encode, for half a minute and more, and keeps it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class Compiling:
    """How long code has been compiled. on_change: told whether compiling begins or is over."""

    def __init__(self, on_change: Callable[[bool], None]) -> None:
        self._on_change = on_change
        self._depth = 0
        # Seconds before this compiling, and when it began. One value, for other threads read it meanwhile.
        self._times: tuple[float, float | None] = 0.0, None

    @property
    def seconds(self) -> float:
        """So far."""
        before, since = self._times
        return before + (0.0 if since is None else time.monotonic() - since)

    def now(self) -> float:
        """A clock, in seconds, that stands while code is compiled."""
        return time.monotonic() - self.seconds

    def start(self) -> None:
        """To be called where compiling begins; what is compiled may have more compiled."""
        self._depth += 1
        if self._depth == 1:
            self._times = self._times[0], time.monotonic()
            self._on_change(True)

    def end(self) -> None:
        """To be called where it ends. An end alone, of what began before anybody listened, is none."""
        if not self._depth:
            return
        self._depth -= 1
        if not self._depth:
            self._times = self.seconds, None
            self._on_change(False)


@contextmanager
def told(compiling: Compiling) -> Iterator[None]:
    """Tell of all that numba compiles meanwhile, for this encode or another of the process. It compiles one function at
    a time, whatever the threads."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            compiling.start()

        def on_end(self, event: Any) -> None:
            compiling.end()

    with event.install_listener("numba:compile", Listener()):
        yield
