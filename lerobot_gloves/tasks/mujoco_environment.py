"""What the environments that MuJoCo simulates have in common."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from lerobot_gloves.tasks.environment import CONTROL_HZ, TaskEnvironment
from lerobot_gloves.tasks.panda import import_mujoco

if TYPE_CHECKING:
    import mujoco


class MujocoEnvironment(TaskEnvironment):
    """A task in MuJoCo whose episodes each have a mode: which of several things is asked for.

    The mode is that of `reset`'s `options={"mode": ...}`, else the fixed one, else the one that the seed modulo
    `period` stands for (`_mode_of`); without a seed, a number below `period` is drawn. A task says how an episode for a
    mode begins (`_begin_mode`), and begins one itself when it is made, so that it can be drawn at once.

    Attributes:
        period: After so many consecutive seeds the modes repeat.

    Args:
        extra: The extra of this package that installs what the task needs, for errors.
        make_model: Gives the compiled scene to move in.
        mode: The fixed mode; None lets the seed choose.
        arguments: Those of `TaskEnvironment`.

    Raises:
        ValueError: As `TaskEnvironment`.
        SimulatorError: If MuJoCo or what the scene is built from is missing or unusable.
    """

    period: int

    def __init__(
        self, *, extra: str, make_model: Callable[[], "mujoco.MjModel"], mode: str | None, **arguments: Any
    ) -> None:
        super().__init__(**arguments)
        self._fixed_mode = mode
        self._mujoco = import_mujoco(extra)
        self._model = make_model()
        self._data = self._mujoco.MjData(self._model)
        self._substeps = round(1 / CONTROL_HZ / self._model.opt.timestep)

    def _begin(self, seed: int | None, options: Mapping[str, Any]) -> None:
        mode = options.get("mode") or self._fixed_mode
        if mode is None:
            mode = self._mode_of(int(self.np_random.integers(self.period)) if seed is None else seed % self.period)
        self._begin_mode(mode)

    @abstractmethod
    def _mode_of(self, number: int) -> str:
        """The mode that a number below `period` stands for."""

    @abstractmethod
    def _begin_mode(self, mode: str) -> None:
        """Put everything where it is at the beginning of an episode for a mode.

        Raises:
            ValueError: If there is no such mode.
        """
