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
        self._depth, self._since, self._before = 0, 0.0, 0.0

    @property
    def seconds(self) -> float:
        """So far."""
        return self._before + (time.monotonic() - self._since if self._depth else 0.0)

    def now(self) -> float:
        """A clock, in seconds, that stands while code is compiled."""
        return time.monotonic() - self.seconds

    def start(self) -> None:
        """To be called where compiling begins; what is compiled may have more compiled."""
        if not self._depth:
            self._since = time.monotonic()
            self._on_change(True)
        self._depth += 1

    def end(self) -> None:
        """To be called where it ends."""
        self._depth -= 1
        if not self._depth:
            self._before += time.monotonic() - self._since
            self._on_change(False)


@contextmanager
def told(compiling: Compiling) -> Iterator[None]:
    """Tell of all that numba compiles meanwhile. It compiles one function at a time, whatever the threads."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            compiling.start()

        def on_end(self, event: Any) -> None:
            compiling.end()

    with event.install_listener("numba:compile", Listener()):
        yield
