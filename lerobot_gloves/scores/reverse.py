"""Reverse-flow nonconformity score (paper, "Out-Of-Distribution Detection" and its appendix)."""

from dataclasses import dataclass

from torch import Tensor

from lerobot_gloves.flow import VelocityField, integrate


@dataclass(frozen=True)
class ReverseScore:
    """Squared norm of the noise that the flow maps to the chunk, s(x) = ||z_hat(x)||^2.

    One step is the paper's default, z_hat = x - v(x, 1). On a flow without error that is 0 for every chunk, since
    v(x, 1) = x: what it measures is the network's error. From two steps on the score also follows the density.

    Attributes:
        steps: Backward Euler steps from t = 1 to t = 0.

    Raises:
        ValueError: If `steps` is below 1.
    """

    steps: int = 1
    starts_at_chunk = True

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"ReverseScore: steps is {self.steps}, but must be at least 1")

    def __call__(self, velocity: VelocityField, chunk: Tensor, length: int | None = None) -> Tensor:
        """Score chunks.

        Args:
            velocity: The expert flow, context bound.
            chunk: Normalised chunks, shape (N, T, A).
            length: How many leading actions count; the rest is padding that the flow sees but the norm leaves out.

        Returns:
            Scores, shape (N,): low where the expert would act like this, high where it would not.
        """
        z = integrate(velocity, chunk, start=1.0, end=0.0, steps=self.steps)
        return z[:, :length].square().sum(dim=(1, 2))
