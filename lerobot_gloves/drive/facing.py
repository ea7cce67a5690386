"""What the tasks' views have in common: robots that are looked at from the front, and moved by displacements."""

import numpy as np


class FacingView:
    """The robot's y points to the right and its x down, in the camera's picture as on the top view; z is up.

    Attributes:
        speed: Entry of the action for a key held, or a stick all the way out.
        axes: Entries of the action (x, y, and z where the task has a height) that keys move.
        actions: Entries of an action.
    """

    speed: float
    axes: int
    actions: int

    def steer(self, x: float, y: float, z: float = 0.0, grip: float = 0.0) -> np.ndarray:
        """See `lerobot_gloves.drive.view.View`."""
        action = np.zeros(self.actions, dtype=np.float32)
        action[: self.axes] = (self.speed * np.array([-y, x, z]))[: self.axes]
        return action

    def arrow(self, action: np.ndarray) -> tuple[float, float, float]:
        """See `lerobot_gloves.drive.view.View`."""
        down, right, *up = action[: self.axes] / self.speed
        return float(right), float(-down), float(up[0]) if up else 0.0


def rectangle(left: float, above: float, right: float, below: float, kind: str = "rule") -> list[dict]:
    """The four lines of a rectangle on the top view."""
    corners = [[left, above], [right, above], [right, below], [left, below]]
    return [{"kind": kind, "from": corners[i], "to": corners[(i + 1) % 4]} for i in range(4)]
