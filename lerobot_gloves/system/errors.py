"""What an error says, for people."""

from draccus.utils import ParsingError


def one_line(error: BaseException) -> str:
    """What an error says, on one line: the Hub's errors take several."""
    return " ".join(str(error).split()) or type(error).__name__


def cause(error: BaseException) -> BaseException:
    """What a configuration said of a wrong value, out of the errors of its own that the parser wraps around it."""
    # A KeyError names a key and says nothing of it: what the parser makes of it says more.
    while isinstance(error, ParsingError) and error.__cause__ is not None and not isinstance(error.__cause__, KeyError):
        error = error.__cause__
    return error
