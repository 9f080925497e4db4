"""``proprio``: parses, calls one function, prints.

`parser` is what may be written, `commands` what each command does, `terminal` what is said of it.
"""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

from proprio_ros import progress
from proprio_ros.cli.parser import UsageError, make_parser
from proprio_ros.cli.terminal import (
    EXIT_BAD_INPUT,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_TERMINATED,
    complain,
    json_error,
    say,
)
from proprio_ros.errors import ConfigurationError, ProprioError, one_line

LONGEST_WORD = 100_000  # characters of one word of the command line


class _Terminated(BaseException):
    """SIGTERM: what is under way ends in order, and nothing half written stays."""


def run() -> NoReturn:
    """Entry point of the installed command: ``main``, then out at once.

    Everything is written and closed by then; unloading Warp's native libraries would only cost the user 0.15 s.
    """
    # one answer and out: collecting while the libraries are imported costs another tenth of a second
    gc.disable()
    signal.signal(signal.SIGTERM, _terminate)
    code = main()
    for stream in (sys.stdout, sys.stderr):
        # the reader has gone, or there never was one
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(code)


def _terminate(*_: object) -> NoReturn:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough
    raise _Terminated


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse and obey; returns the exit code: 0 accepted, 2 bad input, 3 rejected, not identifiable or too wide, 130 interrupted.

    143 is ended by SIGTERM.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _obeyed(given)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:
        # the reader of stdout is gone (`proprio ... | head`): that is not an error of ours
        sys.stderr.close()
        return EXIT_OK
    except OSError as error:
        complain(f"the answer cannot be printed: {error.strerror or error}")
        return EXIT_BAD_INPUT


def _obeyed(given: Sequence[str]) -> int:
    """What `main` does, up to what is left in the buffer of stdout."""
    try:
        for word in given:
            if "\0" in word or len(word) > LONGEST_WORD:
                raise ConfigurationError(
                    f"{one_line(word, 60)}: too long, or it holds a NUL character"
                )
        options = make_parser().parse_args(given)
        with progress.listening(say):
            return int(options.command(options, given))
    except UsageError as error:
        json_error(given, error.sentence, EXIT_BAD_INPUT)
        raise
    except BrokenPipeError:
        raise
    except ProprioError as error:
        sentence = str(error)
        code = EXIT_BAD_INPUT
    except OSError as error:
        if error.filename is None and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise  # of what was printed
        # whatever the file system refuses; where it can be foreseen, the code above says what to do
        sentence = one_line(f"{error.filename or 'a file'}: {error.strerror or error}")
        code = EXIT_BAD_INPUT
    except MemoryError:
        sentence = "there is not enough memory: end other programs, or ask for a part of the recording with --span FROM:TO"
        code = EXIT_BAD_INPUT
    except KeyboardInterrupt:
        sentence = "interrupted"
        code = EXIT_INTERRUPTED
    except _Terminated:
        sentence = "ended by SIGTERM"
        code = EXIT_TERMINATED
    complain(sentence)
    return json_error(given, sentence, code)
