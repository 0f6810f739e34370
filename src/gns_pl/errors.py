"""The one error a user can cause: wrong input. Its message is one sentence that says what is wrong and what to do.

Nothing but the error type and its printing by a command belongs here.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gns_pl.machine import prepare_process


class InputError(ValueError):
    """Input that cannot be used: a scene, a file, a setting. The message is one sentence for the user."""


@contextmanager
def tolerated(what: str) -> Iterator[None]:
    """Go on with one line on stderr after whatever is raised: a figure or a report must not cost a result.

    Args:
        what: is being made, at the beginning of the line.
    """
    try:
        yield
    except Exception as error:
        reason = str(error).strip().partition("\n")[0].rstrip(".") or "no reason given"
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        print(f"{what} could not be made ({kind}{reason}); the results are there without.", file=sys.stderr)


@contextmanager
def report_input_errors(command: str, *, in_sweep: bool = False) -> Iterator[None]:
    """Turn an `InputError`, or a file that may not be touched, into one line on stderr and exit status 2.

    What the process lacks is made up for first: a home folder, characters that the terminal cannot show.

    Args:
        command: its name, printed before the message.
        in_sweep: raise the error again instead of ending, so that Hydra goes on with the other jobs.

    Raises:
        SystemExit: status 2 after one of these; other exceptions pass through with their traceback.
    """
    prepare_process()
    try:
        yield
    except (InputError, OSError) as error:
        if isinstance(error, OSError) and error.filename is None:
            raise
        print(f"{command}: {file_error_message(error) if isinstance(error, OSError) else error}", file=sys.stderr)
        if in_sweep:
            error.was_reported = True  # type: ignore[union-attr]
            raise
        raise SystemExit(2) from error


def file_error_message(error: OSError) -> str:
    """Return what is wrong with the file that an `OSError` names."""
    return f"{error.filename}: cannot be used ({error.strerror}); check the name and its permissions."
