"""One cell of the benchmark: a task, a perturbation, a method, a seed."""

from dataclasses import dataclass

from lerobot_gloves.evaluation.seeds import BAND
from lerobot_gloves.specification import NONE

AGENT = "agent"
"""What the raw agent's column is called, in the paper's table and in ours."""
PERTURBED = "{perturbation}"
"""Stands for the perturbation's name, such as `noised`, in the options of a method."""
_GATED = "+gate"


@dataclass(frozen=True)
class Cell:
    """One cell of a benchmark.

    Attributes:
        perturbation: `none`, or a specification such as `noised:sigma=0.005`.
        editor: `none` for the raw agent, or a specification such as `feeg:start=0.5`.
        seed: Seed s of the policies; environment i has seed 100 s + i of the split's band.
        gate: Whether chunks that look like the expert's pass unchanged.
        task: The task's name.
        perturbation_label: What the perturbation is called; "" for its specification.
        label: What the method is called; "" for its editor, with `+gate` behind it if it is gated.

    Raises:
        ValueError: If the split has no room for the seed, or the raw agent is gated.
    """

    perturbation: str
    editor: str
    seed: int
    gate: bool = False
    task: str = ""
    perturbation_label: str = ""
    label: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.seed < BAND:
            raise ValueError(f"seed is {self.seed}, but must lie between 0 and {BAND - 1}")
        if self.gate and self.raw:
            raise ValueError(
                f"method {gated(self.editor, True)!r} makes no sense: the raw agent has nothing that a gate could "
                "hold back"
            )

    @property
    def raw(self) -> bool:
        """Whether it is the raw agent's."""
        return self.editor == NONE

    @property
    def line(self) -> str:
        """The perturbation's name."""
        return self.perturbation_label or self.perturbation

    @property
    def column(self) -> str:
        """The method's name."""
        return self.label or (AGENT if self.raw else gated(self.editor, self.gate))

    @property
    def title(self) -> str:
        """The method's name, behind the task's if it has one."""
        return " / ".join([*filter(None, [self.task]), self.column])

    @property
    def names(self) -> list[str]:
        """Task, if it has a name, perturbation, method and seed."""
        return [*filter(None, [self.task]), self.line, self.column, f"seed {self.seed}"]

    def __str__(self) -> str:
        return " / ".join(self.names)


def gated(editor: str, gate: bool) -> str:
    """An editor with its gate in one word, as `feeg:start=0.5+gate`."""
    return editor + _GATED * gate


def split_gate(text: str) -> tuple[str, bool]:
    """What `gated` has put into one word."""
    return text.removesuffix(_GATED), text.endswith(_GATED)
