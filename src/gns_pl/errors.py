"""The one error a user can cause: wrong input. Its message is one sentence that says what is wrong and what to do.

Nothing but the error type and its printing at a door belongs here.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gns_pl.machine import prepare_process


class InputError(ValueError):
    """Input that cannot be used: a scene, a file, a setting. The message is one sentence for the user."""


@contextmanager
def told_plainly(door: str, *, in_sweep: bool = False) -> Iterator[None]:
    """Turn an `InputError`, or a file that may not be touched, into one line on stderr and exit status 2.

    What the process lacks is made up for first: a home folder, characters that the terminal cannot show.

    Args:
        door: name of the command, printed before the sentence.
        in_sweep: raise the error again instead of ending, so that Hydra goes on with the other jobs.

    Raises:
        SystemExit: status 2 after one of these; other exceptions pass through with their traceback.
    """
    prepare_process()
    try:
        yield
    except (InputError, PermissionError) as error:
        print(f"{door}: {error}", file=sys.stderr)
        if in_sweep:
            raise
        raise SystemExit(2) from error
