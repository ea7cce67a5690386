"""One clear line for what a user can mend; a traceback for what only we can."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_line_errors(command: str) -> Iterator[None]:
    """Turn the errors of bad input into one line on standard error and exit status 1."""
    try:
        yield
    except (ValueError, FileNotFoundError, FileExistsError, ImportError) as error:
        sys.exit(f"{command}: {error}")
    except KeyboardInterrupt:
        sys.exit(f"{command}: interrupted")
