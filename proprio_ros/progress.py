"""What takes long says how far it is, a sentence at a time, to whoever listens: the command line, a node."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listeners: list[Callable[[str], None]] = []


def say(words: str) -> None:
    """Tell those who listen, in the calling thread."""
    for listener in [*_listeners]:
        listener(words)


@contextmanager
def listening(listener: Callable[[str], None]) -> Iterator[None]:
    """Within it, the listener hears what any thread of this process says."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)
