"""What an error says, for people."""

from draccus.utils import ParsingError


def one_line(error: BaseException) -> str:
    """What an error says, on one line: the Hub's errors take several."""
    return " ".join(str(error).split()) or type(error).__name__


def cause(error: BaseException) -> BaseException:
    """What a configuration said of a wrong value, out of the errors of its own that the parser wraps around it."""
    while isinstance(error, ParsingError) and error.__cause__ is not None:
        error = error.__cause__
    return error
