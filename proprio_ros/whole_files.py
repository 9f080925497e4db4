"""Files that are whole or not there, however the process ends that writes them."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

_unfinished = set[Path]()


def real_path(path: str | Path) -> Path:
    """Without links, as ``Path.resolve`` has it; of links that lead in a circle the path itself, and no error."""
    return Path(os.path.realpath(path))


@contextmanager
def in_one_step(path: Path) -> Iterator[IO[bytes]]:
    """A stream into what becomes the file once it is closed; however that ends, an interrupt among it, nothing else is left.

    Raises `OSError`: It cannot be written.
    """
    # it has no other name until it is whole; who else may read it is set before anything is in it
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}.tmp")
    mode = stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask()
    _unfinished.add(temporary)
    try:
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with open(handle, "wb") as stream:
            os.fchmod(handle, mode)
            yield stream
            stream.flush()
            os.fsync(handle)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    finally:
        _unfinished.discard(temporary)


def leave_nothing_unfinished() -> None:
    """Before a process ends at once: what it was writing goes."""
    for temporary in list(_unfinished):
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _umask() -> int:
    """The user's umask, without setting it: other threads may be making files."""
    with (
        suppress(OSError, ValueError, IndexError),
        open("/proc/self/status", encoding="ascii") as status,
    ):
        return int(
            next(line for line in status if line.startswith("Umask:")).split()[1],
            8,
        )
    return 0o022
