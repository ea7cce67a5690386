"""The step of LeRobot's teleoperation pipelines that corrects what a person commands."""

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.processor import (
    ObservationProcessorStep,
    ProcessorStepRegistry,
    RobotActionProcessorStep,
    TransitionKey,
)
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import build_dataset_frame, dataset_to_policy_features

from lerobot_gloves.system.errors import one_line
from lerobot_gloves.tasks.configuration import OBS_COMMAND

logger = logging.getLogger(__name__)

type Features = dict[PipelineFeatureType, dict[str, PolicyFeature]]


@ProcessorStepRegistry.register("gloves_correction")
@dataclass
class CorrectionStep(RobotActionProcessorStep):
    """Executes what the wrapper makes of a person's command, decided anew at every step under its observation.

    A command that nothing changes passes bit for bit; so does every command where assistance is not wanted at the
    moment, and where the adapter cannot read what the robot shows or edits to NaN. An edited action lies within the
    range of the demonstrations, unless the command is further outside than an edit may move it.

    Attributes:
        features: What the robot shows and takes, as LeRobot describes a dataset's features.
        options: The wrapper's options for its adapter, such as `adapter` and `method`. Without `gate`, commands that
            look like the expert's pass if the adapter is calibrated.
        limit: How far an edit may move an entry of the action, as a share of its range in the demonstrations; None for
            any distance.
        fps: Steps a second; None if nobody knows.
        task: What is to be done, in words.
        device: Where the adapter computes; None for LeRobot's choice.
        wanted: Asked at every step whether the person wants to be assisted.
        commanded: The last command, raw, (A,), float32.
        edited: Whether another action was executed instead.
        shown: What is known of it, by name, for a display: the command, and `Correction.known`.

    Raises:
        ValueError: If the adapter does not fit the robot, or what is asked for needs what it lacks.
    """

    features: dict[str, dict[str, Any]]
    options: dict[str, Any]
    limit: float | None = 0.1
    fps: int | None = None
    task: str = ""
    device: str | None = None
    wanted: Callable[[], bool] = field(default=lambda: True, repr=False)

    def __post_init__(self) -> None:
        # Late: this module is imported with the plugin, by every command.
        from lerobot.policies import get_policy_class, make_policy_config

        from lerobot_gloves.evaluation.person import saved_person

        if self.limit is not None and not 0 <= self.limit <= 1:
            raise ValueError(f"limit is {self.limit}, but must lie between 0 and 1")
        self._names = list(self.features[ACTION]["names"])
        facts = {"action_feature_names": self._names, "fps": self.fps}
        with saved_person(dataset_to_policy_features(self.features), self.options, self.device, **facts) as agent:
            self._policy: Any = get_policy_class("gloves")(make_policy_config("gloves", agent=agent, **self.options))
        self._policy.eval()
        if self.options.get("adapter") is not None and self.options.get("gate") is None:
            with suppress(ValueError):  # it is not calibrated
                self._policy.adjust(gate=True)
        corrector = self._policy._corrector
        bounds = None if corrector is None else corrector.bounds
        if corrector is not None and bounds is None and self.limit is not None:
            raise ValueError(
                "the adapter does not know the range of the actions that it was trained on, so its edits cannot be "
                "limited to a share of it: --limit=null lets them go any distance"
            )
        self._largest = None
        if self.limit is not None and bounds is not None:
            self._largest = self.limit * (bounds[1] - bounds[0]).cpu().numpy()
        self._warned: set[str] = set()
        self.commanded: np.ndarray = np.zeros(len(self._names), dtype=np.float32)
        self.edited, self.shown = False, dict[str, float]()

    def reset(self) -> None:
        """A new episode begins."""
        self._policy.reset()

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """What is to be executed of a command.

        Raises:
            ValueError: If it is not a command for this robot, or not finite.
        """
        if missing := [name for name in self._names if name not in action]:
            raise ValueError(
                f"the teleoperator commands {', '.join(action)}, but the robot takes {', '.join(self._names)}: "
                f"nothing commands {', '.join(missing)}"
            )
        self.commanded = np.array([action[name] for name in self._names], dtype=np.float32)
        if not np.isfinite(self.commanded).all():
            raise ValueError(f"the teleoperator commands {self.commanded.tolist()}, which is not finite")
        # Asked also where nobody wants it: histories go on in time.
        executed = self._corrected(self.transition[TransitionKey.OBSERVATION])
        self.edited = executed is not None and self.wanted()
        if not self.edited:
            return action
        assert executed is not None
        if self._largest is not None:
            executed = self.commanded + np.clip(executed - self.commanded, -self._largest, self._largest)
            self.edited = not np.array_equal(executed, self.commanded)
            if not self.edited:
                return action
        return {**action, **dict(zip(self._names, executed.tolist(), strict=True))}

    def get_config(self) -> dict[str, Any]:
        names = ("features", "limit", "fps", "task", "device")
        options = {name: str(one) if isinstance(one, Path) else one for name, one in self.options.items()}
        return {"options": options, **{name: getattr(self, name) for name in names}}

    def transform_features(self, features: Features) -> Features:
        return features

    def _corrected(self, observation: Any) -> np.ndarray | None:
        """The edited action (A,), float32; None if the command is left as it is."""
        # Late: it brings LeRobot's policies.
        from lerobot.policies.utils import prepare_observation_for_inference

        device = torch.device(self._policy.config.device)
        self.shown = {f"commanded.{name}": float(one) for name, one in zip(self._names, self.commanded, strict=True)}
        try:
            frame = build_dataset_frame(self.features, observation, prefix=OBS_STR)
            batch: dict[str, Any] = prepare_observation_for_inference(frame, device, self.task)
            batch[OBS_COMMAND] = torch.from_numpy(self.commanded)[None].to(device)
            self._policy.running = torch.ones(1, dtype=torch.bool)
            with torch.inference_mode():
                executed = self._policy.select_action(batch)[0].cpu().numpy()
        except ValueError as error:
            if (told := one_line(error)) not in self._warned:
                self._warned.add(told)
                logger.warning("gloves: the command is executed as it is: %s", told)
            return None
        correction = self._policy.correction
        if correction is None:
            return None
        self.shown |= correction.known
        return executed if bool(correction.edited[0]) else None


@ProcessorStepRegistry.register("gloves_shown")
@dataclass
class ShownStep(ObservationProcessorStep):
    """Adds what a correction knows of its last command to what a display shows of the robot.

    Attributes:
        correction: The step that corrects.
    """

    correction: CorrectionStep

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        return {**observation, **{f"gloves.{name}": one for name, one in self.correction.shown.items()}}

    def transform_features(self, features: Features) -> Features:
        return features
