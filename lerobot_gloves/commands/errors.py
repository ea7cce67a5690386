"""One clear line for what a user can mend; a traceback for what only we can."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import yaml
from draccus.utils import ParsingError
from httpx import HTTPError

from lerobot_gloves.system.errors import cause, one_line


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
        sys.exit(f"{command}: {one_line(cause(error))}")
    except yaml.YAMLError as error:
        sys.exit(f"{command}: the value of an option is not YAML: {one_line(error)}")
    except (ValueError, FileNotFoundError, FileExistsError, ImportError) as error:
        sys.exit(f"{command}: {one_line(error)}")
    except (OSError, HTTPError) as error:
        sys.exit(f"{command}: {one_line(error)}{behind}")
    except KeyboardInterrupt:
        sys.exit(f"{command}: interrupted{behind}")
