"""NaN and infinity are never executed."""

from torch import Tensor


class NonFiniteProposalError(ValueError):
    """The agent proposed NaN or infinity, which is never executed."""


def check_finite(chunk: Tensor, origin: str, step: int) -> None:
    """Refuse chunks (B, n, A) that hold NaN or infinity.

    Args:
        chunk: What is about to be executed.
        origin: Whose doing it is, such as `the agent proposed`.
        step: Step of the episode.

    Raises:
        NonFiniteProposalError: Naming environment and step.
    """
    finite = chunk.isfinite().flatten(1).all(dim=1)
    if not finite.all():
        row = int((~finite).nonzero()[0])
        raise NonFiniteProposalError(
            f"{origin} a non-finite action in environment {row} at step {step}: {chunk[row].tolist()}"
        )
