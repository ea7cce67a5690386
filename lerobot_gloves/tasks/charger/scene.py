"""Charger Plug's geometry, and ManiSkill's scene stepped without ManiSkill's tensors.

A Panda stands behind a charger that lies on a table, before a receptacle that hangs above the table. Everything is in
metres and rad, in the world frame: x points away from the robot, y to its left, z up. The charger's frame has its
origin between the roots of the pegs, which point along x; the goal's has its origin in the middle of the receptacle's
face, with x into the receptacle, so that the charger's pose shall equal it.
"""

from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks.charger.simulator import plug_charger, without_graphics

if TYPE_CHECKING:
    import sapien

TOOL_LINK = "panda_hand_tcp"
BODY_SIZE = np.array([0.04, 0.03, 0.024])
"""Extent (3,) of the charger's body, which ends at the roots of the pegs."""
PEG_LENGTH = 0.016
NEAR, SLIGHT = 0.001, 0.01
"""Distance (metres) and turn (rad) that begin to count in an offset."""
MAX_DELTA = 0.1
"""What an action of 1 moves a joint by, rad."""
SUCCESS_DISTANCE, SUCCESS_ANGLE = 0.005, 0.2
"""Largest distance (metres) and turn (rad) of a charger that is plugged in."""


def pose_vector(pose: "sapien.Pose", positive: int) -> np.ndarray:
    """A pose (7,) as position and quaternion (w, x, y, z), of the two that mean the same the one with this entry >= 0.

    Args:
        pose: What to write down.
        positive: The quaternion's entry (0-3) that is far from 0 wherever such poses are, so that the sign never jumps.
    """
    quaternion = pose.q
    return np.concatenate([pose.p, -quaternion if quaternion[positive] < 0 else quaternion])


def turn_of(quaternion: np.ndarray) -> np.ndarray:
    """The rotation vector (3,), rad, at most pi long, of a unit quaternion (w, x, y, z)."""
    vector = np.asarray(quaternion[1:], dtype=np.float64)
    sine = float(np.linalg.norm(vector))
    if sine < 1e-9:
        return 2 * vector
    cosine = float(quaternion[0])
    angle = 2 * np.arctan2(sine, abs(cosine))
    return np.copysign(angle / sine, cosine) * vector


def offset(pose: "sapien.Pose", other: "sapien.Pose") -> np.ndarray:
    """How far a pose is from another, (6,): asinh of its position in `NEAR`s and of its rotation vector in `SLIGHT`s.

    Seen in the other's frame. Near it this is proportional to the error, far from it a logarithm, so that half a
    millimetre at the holes is not lost beside the half metre of the way there.
    """
    error = other.inv() * pose
    return np.arcsinh(np.concatenate([error.p / NEAR, turn_of(error.q) / SLIGHT]))


def gripping(charger: "sapien.Pose") -> "sapien.Pose":
    """Pose of a tool that points straight down at a charger, with a finger on either side of it."""
    import sapien

    return charger * sapien.Pose([0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0])


def is_plugged_in(charger: "sapien.Pose", goal: "sapien.Pose") -> bool:
    """Whether the charger is where it shall be: ManiSkill's test of success."""
    error = goal.inv() * charger
    return bool(np.linalg.norm(error.p) <= SUCCESS_DISTANCE and np.linalg.norm(turn_of(error.q)) <= SUCCESS_ANGLE)


class Scene:
    """PlugCharger-v1 with ManiSkill's draws, control law and physics to the bit, at a third of the cost of a step.

    An environment of its own; any number of them can exist in a process.
    """

    def __init__(self) -> None:
        with without_graphics():
            self._env = plug_charger(obs_mode="state", render_backend="none")
        self._entities = list(self._env.scene.sub_scenes[0].entities)
        self._scene = self._env.scene.sub_scenes[0]
        self._substeps = self._env.sim_freq // self._env.control_freq
        self._robot = self._env.agent.robot._objs[0]
        self._charger = self._env.charger._objs[0]
        self._tool = next(link for link in self._robot.links if link.name.endswith(TOOL_LINK))
        self._joints = self._robot.active_joints
        controllers = self._env.agent.controller.controllers
        bounds = [(c.action_space_low.numpy(), c.action_space_high.numpy()) for c in controllers.values()]
        low, high = (np.concatenate(part) for part in zip(*bounds, strict=True))
        # In single precision and in this order, as ManiSkill maps actions from [-1, 1] to what they mean.
        self._middle, self._half_range = np.float32(0.5) * (high + low), np.float32(0.5) * (high - low)

    def reset(self, seed: int) -> None:
        """Draw where everything is, as ManiSkill's own `reset(seed=...)` does."""
        import torch

        # ManiSkill's reset also forks the generators of all GPUs, which opens a CUDA context in each process.
        with torch.random.fork_rng(devices=[]):
            torch.default_generator.manual_seed(seed)
            self._env._clear_sim_state()
            self._env._initialize_episode(torch.tensor([0]), {})
        self.receptacle, self.goal = self._env.receptacle.pose.sp, self._env.goal_pose.sp
        self._renew_physics()

    def _renew_physics(self) -> None:
        """Move everything to a PhysX scene of its own: one remembers contacts, so that episodes would hang together."""
        import sapien

        self._env._set_scene_config()  # PhysX keeps it once a process: somebody else may have changed it
        self._physics = sapien.physx.PhysxCpuSystem()
        self._physics.timestep = self._env.sim_timestep
        scene = sapien.Scene([self._physics])
        for entity in self._entities:
            self._scene.remove_entity(entity)
        for entity in self._entities:
            scene.add_entity(entity)
        self._scene = scene

    def step(self, action: np.ndarray) -> None:
        """Simulate one twentieth of a second.

        Args:
            action: (8,) float32 in [-1, 1]: 7 joints from where they are, in units of `MAX_DELTA`; fingers.
        """
        target = self._middle + self._half_range * action
        target[:7] += self._robot.qpos[:7]
        for joint, angle in zip(self._joints, [*target, target[7]], strict=True):
            joint.set_drive_target(angle)
        for _ in range(self._substeps):
            self._physics.step()

    @property
    def joint_positions(self) -> np.ndarray:
        """Arm (7, rad) and fingers (2, metres each from the middle)."""
        return self._robot.qpos

    @property
    def joint_velocities(self) -> np.ndarray:
        """Their velocities (9,), a second."""
        return self._robot.qvel

    @property
    def tool(self) -> "sapien.Pose":
        """Pose of the point between the finger tips; z points out of the hand, the fingers move along y."""
        return self._tool.entity_pose

    @property
    def charger(self) -> "sapien.Pose":
        """Pose of the charger."""
        return self._charger.pose
