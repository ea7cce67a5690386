"""Which environments of a batch still run, for a policy that nobody tells."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor, equal


class Motion:
    """Tells by what the environments of a batch show which of their episodes are over.

    LeRobot asks a policy for actions until the last episode of a batch ends, and does not say which have ended. One
    that has rests where LeRobot freezes it (`FreezeAfterEpisodeEnd`) and in the tasks of this package, and shows the
    same to the last bit from then on. So one that stands still while another moves on is taken to be over until it
    moves again. What never moved at all shows nothing, and runs; so does what Gymnasium begins anew by itself.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """New episodes begin."""
        self._before: dict[str, Tensor] = {}
        self._given: dict[str, int] = {}
        self._now = 0
        self._moved: list[int] = []

    def see(self, observation: Mapping[str, Any], batch_size: int) -> None:
        """Compare what B environments show, in full, with what they showed last; to be called at every step."""
        shown = {
            key: one for key, one in observation.items() if isinstance(one, Tensor) and one.shape[:1] == (batch_size,)
        }
        if len(self._moved) != batch_size:
            self.reset()
            self._moved = [0] * batch_size
        else:
            self._now += 1
            # What is small tells most changes, and images need not be looked at.
            keys = sorted(shown, key=lambda key: shown[key].numel())
            for row in range(batch_size):
                if any(self._changed(key, shown[key], row) for key in keys):
                    self._moved[row] = self._now
        # Copies would cost more than the comparison: only what is written over by whoever gives it is copied.
        given = {key: one.data_ptr() for key, one in shown.items()}
        self._before = {key: one.clone() if given[key] == self._given.get(key) else one for key, one in shown.items()}
        self._given = given

    def over(self, row: int) -> bool:
        """Whether an environment's episode is taken to be over."""
        return 0 < self._moved[row] < max(self._moved)

    def moves(self, row: int) -> bool:
        """Whether an environment has moved at the last step."""
        return self._moved[row] == self._now

    def _changed(self, key: str, now: Tensor, row: int) -> bool:
        before = self._before.get(key)
        if before is None or before.data_ptr() == now.data_ptr():  # written over: nobody knows
            return True
        return not equal(before[row], now[row])
