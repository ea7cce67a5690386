"""The corrector: an adapter with its gate and its editor, between raw observations and raw actions."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.adapter import Adapter, BoundAdapter, pad
from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.loading import load_policy
from lerobot_gloves.checkpoints.recommendation import Recommendation
from lerobot_gloves.checkpoints.statistics import Constants, action_range
from lerobot_gloves.specification import name_of, parse_all, parse_optional, specification

from .configuration_gloves import GlovesConfig
from .fits import check_fits
from .gate import Gate
from .settings import Settings, settle


@dataclass
class Correction:
    """What became of B proposals.

    Attributes:
        action: What is to be executed, raw, (B, n, A).
        proposal: What was proposed, the same.
        score: Nonconformity scores (B,), None if nobody asked for them or the adapter has none; of several scores, how
            far the worst lies above the largest value that passes.
        each: Every score by its specification, (B,) each; none of them where `score` is None.
        p_value: Conformal p-values (B,), None without a gate.
        edited: Whether a proposal was edited, bool (B,).
        distance: Mean Euclidean distance (B,) of executed from proposed actions, in the adapter's normalised units.
        evaluations: Network evaluations per proposal, (B,).
        milliseconds: Time that a corrected proposal took, the batch's shared out among them.
    """

    action: Tensor
    proposal: Tensor
    score: Tensor | None
    each: dict[str, Tensor]
    p_value: Tensor | None
    edited: Tensor
    distance: Tensor
    evaluations: Tensor
    milliseconds: float

    @property
    def known(self) -> dict[str, float]:
        """What is known of the first proposal, by name: its score and p-value, if there are any, and `edited`."""
        scored = {"score": self.score, "p_value": self.p_value}
        found = {name: float(value[0]) for name, value in scored.items() if value is not None}
        return {**found, "edited": float(self.edited[0])}

    def spread(self, proposal: Tensor, rows: Tensor) -> "Correction":
        """The same for B proposals (B, n, A) of which only `rows`, bool (B,), were corrected; the others pass."""

        def spread(values: Tensor, fill: float) -> Tensor:
            everywhere = values.new_full((len(rows),), fill)
            everywhere[rows] = values
            return everywhere

        action = proposal.clone()
        action[rows] = self.action
        return replace(
            self,
            action=action,
            proposal=proposal,
            score=None if self.score is None else spread(self.score, torch.nan),
            each={name: spread(one, torch.nan) for name, one in self.each.items()},
            p_value=None if self.p_value is None else spread(self.p_value, torch.nan),
            edited=spread(self.edited, False),
            distance=spread(self.distance, 0.0),
            evaluations=spread(self.evaluations, 0.0),
        )


class Corrector:
    """Loads the adapter that a wrapper names and corrects proposals with it.

    Attributes:
        settings: Method and gate, whoever chose them.
        bounds: Between what the entries of an edited action lie, raw, (A,) each: by default the range of the data that
            the adapter was trained on; None for any number.

    Args:
        config: The wrapper's settings.
        adapter: Folder or Hub id of the adapter, which they name.

    Raises:
        ValueError: If the adapter does not fit the agent, the method or the score is not one of its own, or it is not
            calibrated, or has no agent flow, where the gate, or the editor, needs it.
    """

    def __init__(self, config: GlovesConfig, adapter: str):
        adapter_config = checkpoint_config("policy.adapter", adapter, config.adapter_overrides, config.adapter_revision)
        adapter_config.pretrained_path = adapter
        adapter_config.pretrained_revision = config.adapter_revision
        check_fits(config, adapter_config)
        self.loaded = load_policy(adapter_config, config.device)
        self.adapter = self.loaded.policy.requires_grad_(False)
        if not isinstance(self.adapter, Adapter):
            raise ValueError(
                f"{adapter} is a policy of type {adapter_config.type!r}, which cannot correct another one: "
                "--policy.adapter takes a checkpoint such as one of gloves_expert_flow"
            )
        self._name, self._revision = adapter, config.adapter_revision
        self._guidance = getattr(adapter_config, "guidance", 1.0)
        self.calibration = Calibration.load(adapter, config.adapter_revision)
        self._recommendation = Recommendation.load(adapter, config.adapter_revision) if config.method is None else None
        if stored := [one for one in (self.calibration, self._recommendation) if one is not None]:
            weights = weights_hash(self.loaded.policy.state_dict())
            for one in stored:
                one.check(weights)
        self.bounds = action_range(self.loaded.preprocess)
        self.constants = Constants(self.loaded.preprocess)
        self.rename_map = config.adapter_rename_map
        self.inputs = set(adapter_config.input_features)
        self.chunk_size = adapter_config.chunk_size
        self.history = getattr(self.adapter, "history", 0)
        self.settle(config)

    def settle(self, config: GlovesConfig) -> None:
        """Take method, gate, score and alpha from a wrapper's settings; the adapter stays loaded.

        Raises:
            ValueError: As at loading; what was settled before then stays.
        """
        settings = settle(config, self.adapter, self._recommendation)
        editor, scores = choose(config, settings, self.adapter)
        by_editor = getattr(editor, "needs_threshold", False)
        needed = settings.gate or by_editor or len(scores) > 1
        if needed and self.calibration is None:
            name = name_of(specification(editor, self.adapter.editors))
            what = "the gate" if settings.gate else name if by_editor else f"--policy.score={config.score}"
            raise ValueError(
                f"{what} needs a calibration, and {self._name} has none: "
                f"run gloves calibrate --policy.path={self._name} "
                + (f"--policy.pretrained_revision={self._revision} " if self._revision else "")
                + "--dataset.repo_id=<held-out expert episodes>"
            )
        if needed and self.calibration is not None and self._guidance != self.calibration.guidance:
            raise ValueError(
                f"the adapter's guidance is {self._guidance:g}, but it was calibrated with "
                f"{self.calibration.guidance:g}: run gloves calibrate --policy.guidance={self._guidance:g}"
            )
        self.gate = Gate(settings, self.adapter, scores, self.calibration, needed)
        self.settings, self.editor, self.gated = settings, editor, settings.gate
        self.scored = bool(scores) and (self.gated or config.log is not None)

    def reset(self) -> None:
        """A new episode begins."""
        self.loaded.reset()

    def __call__(
        self,
        observation: dict[str, Tensor],
        proposal: Tensor,
        generators: Sequence[torch.Generator],
        history: Sequence[Tensor] = (),
    ) -> Correction:
        """Score proposals and edit those that the gate turns away, or all of them without a gate.

        Args:
            observation: Raw observations, batched.
            proposal: Raw actions (B, n, A), n at most the adapter's chunk size.
            generators: One per environment.
            history: What was proposed before, the oldest first, raw actions (B, m, A) each, at most `self.history`.

        Raises:
            ValueError: If the adapter needs an observation that is not there.
        """
        began = time.perf_counter()
        length = proposal.shape[1]
        chunk = pad(proposal, self.chunk_size)
        if unknown := self.rename_map.keys() - observation.keys():
            raise ValueError(
                f"--policy.adapter_rename_map renames {', '.join(sorted(unknown))}, but there is only "
                f"{', '.join(sorted(observation))}"
            )
        named = {self.rename_map.get(key, key): value for key, value in observation.items()}
        missing = self.inputs - named.keys()
        if missing:
            raise ValueError(
                f"the adapter needs {', '.join(sorted(missing))}, but is given only {', '.join(sorted(named))}: rename "
                "by --policy.adapter_rename_map, or take an adapter for these observations"
            )
        # The task's text and the other observations are the agent's.
        told = {key: value for key, value in named.items() if key in self.inputs}
        proposals = torch.stack([*(pad(past, self.chunk_size) for past in history), chunk], dim=1)
        batch = self._normalised({**told, "action": proposals})
        *before, chunk = batch["action"].unbind(dim=1)
        bound, scorer = self._bound(batch, before), None
        if self.scored:
            # Proposals were calibrated beside last ones of their own length.
            judged = self.gate.judged(length)
            cut = [pad(past[:, :judged], self.chunk_size) for past in before]
            scorer = bound if judged == length or not before else self._bound(batch, cut)
        test = self.gate.test(length)
        scores = None if scorer is None else self.gate.score(scorer, chunk, length)
        # Masks stay on the CPU, where the actions are; they may index tensors on any device.
        p_value, admitted = None, torch.zeros(len(chunk), dtype=torch.bool)
        if self.gated and test is not None and scores is not None:
            p_value, admitted = test.p_value(scores), test.admits(scores).cpu()
        evaluations = torch.full((len(chunk),), float(bound.evaluations if scorer is None else scorer.evaluations))
        executed, distance = proposal.clone(), torch.zeros(len(chunk))
        edited = ~admitted if self.editor is not None else torch.zeros_like(admitted)
        if edited.any():
            some, (asked, threshold) = bound.select(edited), self.gate.aim(length)
            result = some.edit(
                chunk[edited],
                self.editor,
                score=asked,
                threshold=threshold,
                length=length,
                generator=[g for g, e in zip(generators, edited.tolist(), strict=True) if e],
            )
            raw = self.loaded.postprocess(result)[:, :length].to(executed)
            kept = self._bounded(raw)
            if not torch.equal(kept, raw):
                seen = {key: value[edited] for key, value in told.items()}
                result = self._normalised({**seen, "action": kept})["action"]
            moved = result[:, :length] - chunk[edited][:, :length]
            if (constant := self.constants.action) is not None:
                kept = torch.where(constant.to(kept.device), executed[edited], kept)
                moved[..., constant] = 0
            executed[edited] = kept
            moved = moved.norm(dim=-1).mean(dim=-1)
            distance[edited] = moved.to(distance)
            evaluations[edited] += some.evaluations
        milliseconds = 1000 * (time.perf_counter() - began) / len(chunk)
        score = None if scores is None else self.gate.summary(scores, length)
        each = {} if scores is None else dict(zip(self.gate.names, scores, strict=True))
        return Correction(executed, proposal, score, each, p_value, edited, distance, evaluations, milliseconds)

    def _bound(self, batch: dict[str, Tensor], before: Sequence[Tensor]) -> BoundAdapter:
        """The adapter bound to observations and, if it reads them, to the last proposals, normalised (B, T, A) each."""
        if not self.history:
            return self.adapter.bind(batch)
        return self.adapter.bind(batch, torch.stack(list(before), dim=1) if before else None)

    def _normalised(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """What the adapter sees of raw observations and actions: no more of a constant than in its training."""
        return self.loaded.preprocess(self.constants.hold(batch))

    def _bounded(self, raw: Tensor) -> Tensor:
        """Raw actions (..., A) between the bounds."""
        if self.bounds is None:
            return raw
        low, high = (bound.to(raw) for bound in self.bounds)
        return raw.clamp(low, high)


def choose(config: GlovesConfig, settings: Settings, adapter: Adapter) -> tuple[Any, tuple[Any, ...]]:
    """The editor, None for none, and the scores of a wrapper's settings.

    Raises:
        ValueError: If the adapter lacks one of them, has no agent flow where the editor needs one, or no score where
            the gate does.
    """
    method = settings.method
    editor = parse_optional(method, adapter.editors, "method")
    if getattr(editor, "needs_agent", False) and not getattr(adapter, "has_agent", False):
        raise ValueError(
            f"{name_of(method)} needs the agent's flow besides the expert's: take a gloves_align_flow as "
            """adapter, or name one by --policy.adapter_overrides='["--agent_flow=<checkpoint>"]'"""
        )
    if not adapter.scores and (settings.gate or settings.score is not None):
        raise ValueError(
            f"{config.adapter} scores no proposals, so it has no gate: leave out --policy.gate and --policy.score"
        )
    return editor, () if settings.score is None else parse_all(settings.score, adapter.scores, "score")
