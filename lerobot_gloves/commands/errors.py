"""One clear line for what a user can mend; a traceback for what only we can."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from draccus.utils import ParsingError
from httpx import HTTPError


def one_line(error: BaseException) -> str:
    """What an error says, on one line: the Hub's errors take several."""
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def one_line_errors(command: str, kept: str = "") -> Iterator[None]:
    """Turn errors of bad input, of the disk and of the network into one line on standard error and exit status 1.

    Args:
        command: Whose errors they are.
        kept: What to add to those that come in the midst of the work: what is kept of it, and how to go on.
    """
    behind = f"; {kept}" if kept else ""
    try:
        yield
    except ParsingError as error:
        # The parser wraps what a configuration says of a wrong value into errors of its own.
        told: BaseException = error
        while told.__cause__ is not None:
            told = told.__cause__
        sys.exit(f"{command}: {one_line(told)}")
    except (ValueError, FileNotFoundError, FileExistsError, ImportError) as error:
        sys.exit(f"{command}: {one_line(error)}")
    except (OSError, HTTPError) as error:
        sys.exit(f"{command}: {one_line(error)}{behind}")
    except KeyboardInterrupt:
        sys.exit(f"{command}: interrupted{behind}")
