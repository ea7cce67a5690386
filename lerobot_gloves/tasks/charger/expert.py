"""A scripted person who plugs the charger in, never twice alike."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_gloves.tasks.charger.kinematics import joint_step
from lerobot_gloves.tasks.charger.scene import BODY_SIZE, MAX_DELTA, PEG_LENGTH, turn_of
from lerobot_gloves.tasks.jostling import JostledExpert

if TYPE_CHECKING:
    import sapien

OPEN, HELD, EMPTY = 0.070, 0.033, 0.020
"""Distances of the fingers, metres: above the first they are open, between the others they hold the charger."""
CLEAR = -0.11
"""Farthest back (x) that the tool goes to get clear of the receptacle, metres."""
STRAIGHT, CENTRED = 0.024, 0.0016
"""Turn (rad) and distance from the holes' axis (metres) from which on a charger is taken back, not pushed in."""
STANDOFF = 0.024
"""How far from the goal, and so with the pegs before the receptacle, a charger is set straight, metres."""
SLOW = 0.007
"""How far ahead of the tool its target is while the pegs go in, metres."""
FINE, GAIN, FAR = 0.06, 2.0, 0.02
"""Closer than the first to the goal (metres) the target lies that many times as far ahead as the error is, up to the
third (metres): the robot gets a third of the way in a step, and what is left of half a millimetre is too little for a
policy to tell from nothing."""
CARE = 0.04
"""Share of the jostling that reaches the robot close to the receptacle."""
BUMP_BEGINS, BUMP_BEGINS_FINE, BUMP_ENDS = 1 / 25, 1 / 6, 1 / 6
"""Chances in a step that a bump begins, the same close to the goal, and that it ends."""
BUMP = (0.02, 0.15)
"""Smallest and largest size of a bump, in the units of an action."""
SLIP_BEGINS, SLIP_ENDS = 1 / 80, 1 / 8
"""Chances in a step that the empty fingers begin to close by themselves, and that they stop."""
TURN = 8.0
"""By how much farther ahead it is in orientation, rad a metre."""


class ChargerExpert(JostledExpert):
    """Opens the hand above the charger, lowers it, grips, carries, aligns the pegs with the holes and pushes them in.

    What comes next is decided anew in every step from what is observed, and no step is counted: a charger that is lost
    is picked up again, and pegs that meet the receptacle beside its holes are taken back. What differs between
    episodes: where and how steeply the charger is gripped, from which height, the bow of the way to the receptacle, the
    speed and how it drifts.

    The joints are jostled, the less the closer the charger is to the receptacle. Besides they are bumped: for a few
    steps something pushes them one way, so that the charger comes to the receptacle beside the holes now and then, and
    a policy can learn what to do there; with the pegs in the holes there are no bumps. The empty fingers slip shut now
    and then.

    Args:
        rng: Source of all draws.
    """

    action_bound = 1.0
    jostled = 7
    haste_noise = 0.02
    drift_noise = 0.01
    jitter_range = (0.01, 0.04)

    def _begin(self, mode: str) -> None:
        rng = self._rng
        pitch = rng.uniform(0.18, 0.34)  # leans the hand away from the receptacle
        along, up = rng.uniform(-0.004, 0.003), rng.uniform(-0.001, 0.003)
        # The tool that grips, seen from the charger: it points down, the fingers move along y.
        self._grip = _pose([along - BODY_SIZE[0] / 2, 0.0, up], [0.0, np.cos(pitch / 2), 0.0, np.sin(pitch / 2)])
        self._hover = rng.uniform(0.035, 0.06)
        # By which share of the distance the way to the receptacle sets out sideways (y) and upward (z).
        self._bow = np.array([0.0, rng.normal(0.0, 0.2), rng.uniform(0.0, 0.3)])
        self._speed = rng.uniform(0.024, 0.032)  # how far ahead of the tool its target is: it gets a third of it a step
        self._bump: np.ndarray | None = None  # what pushes the joints away at this moment
        self._care = 1.0  # share of the jostling that reaches the robot
        self._bump_begins, self._slip_begins = BUMP_BEGINS, SLIP_BEGINS  # how likely that is at this moment
        self._slips = False  # whether the fingers close by themselves

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The next action.

        Args:
            observation: Needs `agent_pos` (25,), `goal` (14,) and, in `environment_state`, the charger's pose in the
                first seven.

        Returns:
            (8,) float32 in [-1, 1].
        """
        state = np.asarray(observation["agent_pos"], dtype=np.float64)
        tool, goal = _read(state[18:25]), _read(observation["goal"][7:14])
        charger = _read(observation["environment_state"][:7])
        self._care, self._bump_begins, self._slip_begins = 1.0, BUMP_BEGINS, SLIP_BEGINS

        fingers, speed, gain = state[7] + state[8], self._speed, 1.0
        off = (charger * self._grip).inv() * tool  # the tool seen from where it shall grip
        distance, turn = _length(off.p), _length(turn_of(off.q))
        around = distance < 0.013 and turn < 0.35
        if around and EMPTY < fingers < HELD:
            opening = -1.0
            carried, speed, gain = self._carried(charger, goal)
            target = carried * (charger.inv() * tool)
        elif around and fingers > EMPTY and (fingers < OPEN or (distance < 0.004 and turn < 0.05)):
            opening, target = -1.0, charger * self._grip
        else:
            opening, target = 1.0, self._above(tool, charger, goal)
        way, haste = tool.inv() * target, self._hurry()
        move = _shortened(gain * way.p, speed * haste)
        rotation = _shortened(gain * turn_of(way.q), TURN * self._speed * haste)
        joints = joint_step(state[:9], np.concatenate([move, rotation])) / MAX_DELTA
        joints /= max(1.0, float(np.abs(joints).max()))
        return np.array([*joints, opening], dtype=np.float32)

    def _above(self, tool: "sapien.Pose", charger: "sapien.Pose", goal: "sapien.Pose") -> "sapien.Pose":
        """Where the tool shall go in order to get around the charger: over it first, then down."""
        grip = charger * self._grip
        off = grip.inv() * tool
        aside = _length(off.p[:2]) + 0.1 * _length(turn_of(off.q))
        height = self._hover * np.clip((aside - 0.006) / 0.01, 0.0, 1.0)
        x, y, z = (grip * _pose([0.0, 0.0, -height])).p
        # Beside the receptacle it first goes back, and it comes down only where it is before it or over the charger.
        retreat = np.clip(abs(y - tool.p[1]) - 0.02, 0.0, max(0.0, x - CLEAR))
        before = -float((goal.inv() * tool).p[0])
        stay = np.clip((0.09 - before) / 0.04, 0.0, 1.0) * np.clip((aside - 0.02) / 0.03, 0.0, 1.0)
        return _pose([x - retreat, y, z + stay * max(0.0, tool.p[2] - z)], grip.q)

    def _carried(self, charger: "sapien.Pose", goal: "sapien.Pose") -> tuple["sapien.Pose", float, float]:
        """Where the charger shall go, how far ahead of the tool its target may be (metres), and by which gain."""
        error = goal.inv() * charger
        away = _length(error.p)
        crooked = max(_length(error.p[1:]) / CENTRED, _length(turn_of(error.q)) / STRAIGHT)
        inside = error.p[0] > -PEG_LENGTH and crooked < 1.0  # the pegs are in the holes, which hold them straight
        self._care = float(np.clip((away - 0.04) / 0.1, CARE, 1.0))
        self._bump_begins = 0.0 if inside else BUMP_BEGINS_FINE if away < FINE else BUMP_BEGINS
        self._slip_begins = 0.0
        # The straighter the faster forward, the more crooked the faster back.
        ahead = SLOW / GAIN * (1.0 if inside else float(np.clip(2.0 * (1.0 - crooked), -1.0, 1.0)))
        clear = np.clip(_length(error.p[1:]) - FINE, 0.0, 0.06)  # from beside it does not cut the receptacle's corner
        aim = np.array([np.clip(error.p[0] + ahead, -STANDOFF, 0.0) - clear, 0.0, 0.0])
        aim += self._bow * max(0.0, away - FINE)
        return goal * _pose(aim), *((FAR, GAIN) if away < FINE else (self._speed, 1.0))

    def disturb(self, action: np.ndarray) -> np.ndarray:
        """What reaches the robot in place of the expert's action (8,) while it is jostled, (8,) float32."""
        rng = self._rng
        if not self._bump_begins:
            self._bump = None
        elif self._bump is None:
            if rng.random() < self._bump_begins:
                self._bump = np.exp(rng.uniform(*np.log(BUMP))) * rng.standard_normal(7)
        elif rng.random() < BUMP_ENDS:
            self._bump = None
        jitter, drift = self._push()
        disturbed = action.copy()
        disturbed[:7] += self._care * (jitter + drift)
        if self._bump is not None:
            disturbed[:7] += self._bump
        self._slips = rng.random() < (1 - SLIP_ENDS if self._slips else self._slip_begins)
        if self._slips:
            disturbed[7] = -1.0
        return self._clipped(disturbed)


def _pose(position: Any, quaternion: Any = (1.0, 0.0, 0.0, 0.0)) -> "sapien.Pose":
    import sapien

    return sapien.Pose(position, quaternion)


def _read(vector: np.ndarray) -> "sapien.Pose":
    """A pose from its vector (7,)."""
    return _pose(vector[:3], vector[3:])


def _length(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))


def _shortened(vector: np.ndarray, length: float) -> np.ndarray:
    """A vector, shortened to a length where it is longer."""
    return np.asarray(vector, dtype=np.float64) * min(1.0, length / max(_length(vector), 1e-9))
