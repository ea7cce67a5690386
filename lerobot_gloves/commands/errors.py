"""One clear line for what a user can mend; a traceback for what only we can."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from draccus.utils import ParsingError


@contextmanager
def one_line_errors(command: str) -> Iterator[None]:
    """Turn the errors of bad input into one line on standard error and exit status 1."""
    try:
        yield
    except ParsingError as error:
        # The parser wraps what a configuration says of a wrong value into errors of its own.
        told: BaseException = error
        while told.__cause__ is not None:
            told = told.__cause__
        sys.exit(f"{command}: {told}")
    except (ValueError, FileNotFoundError, FileExistsError, ImportError) as error:
        sys.exit(f"{command}: {error}")
    except KeyboardInterrupt:
        sys.exit(f"{command}: interrupted")
