"""Several perturbations one after the other, and the words in which perturbations are written."""

from collections import Counter
from dataclasses import dataclass

from torch import Tensor

from lerobot_gloves.perturbations.base import Perturbation
from lerobot_gloves.perturbations.registry import PERTURBATIONS
from lerobot_gloves.specification import parse, parse_optional, parts_of, specification

KIND = "perturbation"


@dataclass
class Compound(Perturbation):
    """Several perturbations, applied from left to right.

    Each part draws as it would alone. Of several of one kind, the second and later ones have streams of their own, so
    that no two parts share draws.

    Example:
        >>> perturbation = Compound("noised:sigma=0.005+laggy:p=0.2")
    """

    # The parts' specifications, such as noised:sigma=0.005+laggy:p=0.2, applied from left to right.
    parts: str

    def __post_init__(self) -> None:
        self._parts: list[Perturbation] = [parse(part, PERTURBATIONS, KIND) for part in parts_of(self.parts)]
        seen: Counter[type[Perturbation]] = Counter()
        for part in self._parts:
            seen[type(part)] += 1
            part._which = seen[type(part)]

    def __str__(self) -> str:
        """The specification with every option written out."""
        return "+".join(specification(part, PERTURBATIONS) for part in self._parts)

    def reset(self, batch_size: int, seed: int, first_episode: int = 0) -> None:
        for part in self._parts:
            part.reset(batch_size, seed, first_episode)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        for part in self._parts:
            chunk = part(chunk, ran)
        return chunk


CHOICES: dict[str, type[Perturbation]] = {**PERTURBATIONS, "compound": Compound}
"""What `--policy.perturbation.type` may be."""


def parse_perturbation(text: str) -> Perturbation | None:
    """The perturbation that a specification names.

    Args:
        text: `none`; one of `PERTURBATIONS` with its options, such as `noised:sigma=0.005`; or several, joined by `+`
            and applied from left to right.

    Returns:
        The perturbation; None for `none`.

    Raises:
        ValueError: If a name, an option or a value is not valid; the message lists the valid ones.
    """
    return Compound(text) if len(parts_of(text)) > 1 else parse_optional(text, PERTURBATIONS, KIND)


def written_out(perturbation: Perturbation | None) -> str:
    """The specification that `parse_perturbation` turns back into `perturbation`, every option written out."""
    return str(perturbation) if isinstance(perturbation, Compound) else specification(perturbation, PERTURBATIONS)
