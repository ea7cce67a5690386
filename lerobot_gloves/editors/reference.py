"""What an editor may use of the outside: every editor is called alike, `editor(proposal, reference)`."""

from dataclasses import dataclass

from torch import Tensor

from lerobot_gloves.generators import Generators
from lerobot_gloves.scores import Score
from lerobot_gloves.scores.score import ask


@dataclass(frozen=True)
class Reference[Model]:
    """What proposals (B, T, A) are edited against. An editor takes of it what it needs.

    Attributes:
        expert: The expert flow v_e, a `VelocityField` bound to the B contexts; for the editor of another kind of model,
            that model.
        posterior: The expert flow given what is proposed as well, bound to contexts and proposals; None where
            the adapter reads no proposals, or neither editor nor score says `needs_posterior = True`.
        repeated: Which proposals are those of the last decision again, bool (B,); None where the adapter cannot know.
        agent: The agent flow v_u, bound to the same contexts; None where there is none, or the editor's class does not
            say `needs_agent = True`.
        score: Nonconformity score, see `lerobot_gloves.scores.Score`.
        threshold: tau, the largest value of `score` that the gate admits.
        length: How many leading actions count, the rest being padding; None: all do.
        generator: Source of whatever is drawn; a sequence holds one for each of the B rows.
    """

    expert: Model
    agent: Model | None = None
    posterior: Model | None = None
    repeated: Tensor | None = None
    score: Score | None = None
    threshold: float | None = None
    length: int | None = None
    generator: Generators = None

    def nonconformity(self, chunk: Tensor) -> Tensor:
        """Scores (n * B,) of chunks (n * B, T, A), those of one context adjacent.

        Whether a chunk repeats the last proposal is not theirs: an editor's candidates are no proposals.
        """
        assert self.score is not None
        return ask(self.score, self.expert, chunk, self.length, posterior=self.posterior)
