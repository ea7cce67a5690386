"""The proposal that is being executed, action by action."""

from torch import Tensor


class Plan:
    """What an agent has proposed, from the moment it planned until it plans again.

    Args:
        actions: All that it proposed, raw, (B, n, A).
        executed: How many of them it executes, the first ones.
        step: Step of the episode at which it planned.
        perturbed: Whether a perturbation changed it, bool (B,); None where there is none.
    """

    def __init__(self, actions: Tensor, executed: int, step: int, perturbed: Tensor | None = None):
        self.actions, self.executed, self.step, self.perturbed = actions, executed, step, perturbed
        self._next = 0

    @property
    def over(self) -> bool:
        """Whether all that is to be executed has been taken."""
        return self._next >= self.executed

    def take(self, length: int | None) -> tuple[Tensor, int]:
        """The next proposed actions (B, m, A), m <= `length`, and how many of them are to be executed.

        What is proposed beyond the actions to be executed says what the agent is up to.
        """
        begin, limit = self._next, self.actions.shape[1]
        end = limit if length is None else min(begin + length, limit)
        self._next = min(end, self.executed)
        return self.actions[:, begin:end], self._next - begin
