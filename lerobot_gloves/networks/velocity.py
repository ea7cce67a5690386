"""A velocity field conditioned on observations: context encoders, DiT, and the two bound together."""

from collections.abc import Collection, Mapping, Sequence
from typing import cast

import torch
from torch import Tensor, nn

from lerobot_gloves.flow import VelocityField
from lerobot_gloves.networks.dit import DiT, KeyValues
from lerobot_gloves.networks.encoders import ImageEncoder, StateEncoder


class VelocityNetwork(nn.Module):
    """Conditional velocity field v(x, t | c) (paper, appendix "Model Architecture").

    The context is one token for the concatenated state vectors, one for the goal, which is read together with them
    since what it asks for depends on where the robot is, and a grid of tokens for each camera, whose encoders share
    no weights. What is dropped, the goal or in a network without one the whole context, becomes a learned null token
    (classifier-free guidance). For an align flow, what is asked for is a source, and its label takes the goal's place.

    Args:
        action_dim: A.
        states: Observation keys of the states and how many numbers each holds, whatever its shape.
        cameras: Observation keys of the images.
        goal: Key of the goal's vector, or the label's, and its size; None without.
        context_dim: Width of a context token, d_c.
        context_dropout: Probability p_cfg that training drops an item's context (or goal).
        visual_dropout: Probability p_vd that training drops one whole view of an item.
        backbone_norm: What normalises inside the image encoders, see `ImageEncoder`; None without cameras.
        backbone_dtype: What they compute in.
        dit: The other arguments of `DiT`.

    Raises:
        ValueError: If there is nothing to be conditioned on.
    """

    def __init__(
        self,
        action_dim: int,
        *,
        states: Mapping[str, int],
        cameras: Sequence[str] = (),
        goal: tuple[str, int] | None = None,
        context_dim: int = 256,
        context_dropout: float = 0.2,
        visual_dropout: float = 0.1,
        backbone_norm: str | None = "frozen_batch",
        backbone_dtype: str = "float32",
        **dit: int | float,
    ):
        super().__init__()
        if not states and not cameras:
            raise ValueError("VelocityNetwork: neither a state vector nor a camera to be conditioned on")
        self.states, self.cameras, self.goal = dict(states), tuple(cameras), goal
        self.context_dropout, self.visual_dropout = context_dropout, visual_dropout
        self.state_encoder = StateEncoder(sum(states.values()), context_dim) if states else None
        # A ModuleList's type does not say what it holds.
        encoders = nn.ModuleList(ImageEncoder(context_dim, backbone_norm, backbone_dtype) for _ in cameras)
        self.image_encoders = cast(Collection[ImageEncoder], encoders)
        self.goal_encoder = StateEncoder(goal[1] + sum(states.values()), context_dim) if goal else None
        self.null = nn.Parameter(torch.zeros(1, 1, context_dim))
        self.dit = DiT(action_dim, context_dim, **dit)  # type: ignore[arg-type]

    def encode(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Tokens (B, S, d_c) of states and images, all of the context but the goal."""
        tokens = []
        if self.state_encoder is not None:
            tokens.append(self.state_encoder(self._states(observation)))
        for key, encoder in zip(self.cameras, self.image_encoders, strict=True):
            view = encoder(observation[key].to(self.null.dtype))
            tokens.append(view * self._keeps(view, self.visual_dropout))
        return torch.cat(tokens, dim=1)

    def bind(
        self, observation: Mapping[str, Tensor], guidance: float = 1.0, tokens: Tensor | None = None
    ) -> "BoundVelocity":
        """Encode the context of B observations and project its keys and values, once.

        Args:
            observation: Normalised observations, (B, ...) a state or a goal, (B, 3, H, W) an image.
            guidance: Weight of the context (of the goal, where there is one) against the null: 1 is the plain
                conditional field, more exaggerates the context.
            tokens: What `encode` returned for these observations, so that a second goal costs no second look at them.

        Returns:
            The velocity field of these contexts.

        Raises:
            ValueError: If a state or the goal holds more or fewer numbers than the network was made for.
        """
        context = self.encode(observation) if tokens is None else tokens
        conditional, kept = context, []
        if self.goal_encoder is not None and self.goal is not None:
            told = [self._vector(observation, *self.goal), *([self._states(observation)] if self.states else [])]
            conditional, kept = self.goal_encoder(torch.cat(told, dim=-1)), [context]
        null = self.null.expand_as(conditional)
        keep = self._keeps(conditional, self.context_dropout)
        conditional = torch.where(keep.bool(), conditional, null)

        def project(token: Tensor) -> KeyValues:
            return self.dit.project(torch.cat([*kept, token], dim=1))

        return BoundVelocity(self.dit, project(conditional), None if guidance == 1.0 else project(null), guidance)

    def _states(self, observation: Mapping[str, Tensor]) -> Tensor:
        return torch.cat([self._vector(observation, key, size) for key, size in self.states.items()], dim=-1)

    def _vector(self, observation: Mapping[str, Tensor], key: str, size: int) -> Tensor:
        """An observation as vectors (B, size), whatever its shape: LeRobot's loader makes (B,) of a single number."""
        vector = observation[key].flatten(1) if observation[key].ndim > 1 else observation[key][:, None]
        if vector.shape[1] != size:
            raise ValueError(f"{key} has shape {tuple(observation[key].shape)}, but must hold {size} numbers an item")
        return vector.to(self.null.dtype)

    def _keeps(self, tokens: Tensor, dropout: float) -> Tensor:
        """1 where an item's tokens are kept, 0 where training drops them, shape (B, 1, 1)."""
        if not self.training or dropout == 0:
            return tokens.new_ones(tokens.shape[0], 1, 1)
        return (torch.rand(tokens.shape[0], 1, 1, device=tokens.device) >= dropout).to(tokens.dtype)


class BoundVelocity:
    """The velocity field of B contexts: `velocity(x, t)` with x (n * B, T, A), t (n * B,).

    Args:
        dit: The network.
        context: Keys and values of the contexts.
        null: Those of none, for guidance.
        guidance: Weight of the context against the null.
        parts: The fields that this one is a stack of.
        beside: What stands beside the actions of each context's chunks, (B, T, C), or (B, 1, C) for the same
            beside all of them; None for nothing.

    Attributes:
        evaluations: Evaluations per context so far; with guidance each call makes two. Those of a stack count for each
            of the fields in it.
    """

    def __init__(
        self,
        dit: DiT,
        context: KeyValues,
        null: KeyValues | None = None,
        guidance: float = 1.0,
        parts: Sequence["BoundVelocity"] = (),
        beside: Tensor | None = None,
    ):
        self.beside = beside
        self.dit, self.context, self.null, self.guidance, self.parts = dit, context, null, guidance, parts
        self.evaluations = 0

    def __call__(self, x: Tensor, t: Tensor) -> Tensor:
        contexts = self.context[0][0].shape[0]
        for field in (self, *self.parts):
            field.evaluations += x.shape[0] // contexts * (1 if self.null is None else 2)
        if self.beside is not None:
            beside = self.beside.repeat_interleave(x.shape[0] // contexts, dim=0)
            x = torch.cat([x, beside.expand(-1, x.shape[1], -1)], dim=-1)
        if self.null is None:
            return self.dit(x, t, self.context)
        both = _concatenate([self.context, self.null])
        conditional, unconditional = self.dit(torch.cat([x, x]), torch.cat([t, t]), both).chunk(2)
        return unconditional + self.guidance * (conditional - unconditional)

    def select(self, rows: Tensor) -> "BoundVelocity":
        """The field of some of the contexts: `rows` is bool (B,)."""

        def pick(context: KeyValues) -> KeyValues:
            return [(key[rows], value[rows]) for key, value in context]

        null = None if self.null is None else pick(self.null)
        beside = None if self.beside is None else self.beside[rows]
        return BoundVelocity(self.dit, pick(self.context), null, self.guidance, beside=beside)

    def with_beside(self, beside: Tensor) -> "BoundVelocity":
        """The field of the same contexts with other numbers beside the actions."""
        return BoundVelocity(self.dit, self.context, self.null, self.guidance, beside=beside)

    def stack(self, others: Sequence[VelocityField]) -> "BoundVelocity | None":
        """One field of this one's contexts and those of `others`, in that order; None if it takes two networks.

        Such fields are evaluated by one call: IFAE's agent and expert flow are two labels of one network.
        """
        fields = [self]
        for other in others:
            if not isinstance(other, BoundVelocity) or other.dit is not self.dit or other.guidance != self.guidance:
                return None
            fields.append(other)
        nulls = [field.null for field in fields if field.null is not None]
        null = _concatenate(nulls) if nulls else None
        context, beside = _concatenate([field.context for field in fields]), None
        if self.beside is not None:
            found = [field.beside for field in fields if field.beside is not None]
            longest = max(one.shape[1] for one in found)
            beside = torch.cat([one.expand(-1, longest, -1) for one in found])
        return BoundVelocity(self.dit, context, null, self.guidance, fields, beside)


def _concatenate(contexts: Sequence[KeyValues]) -> KeyValues:
    """Keys and values of all contexts, one after another, for every block."""
    return [
        (torch.cat([key for key, _ in block]), torch.cat([value for _, value in block]))
        for block in zip(*contexts, strict=True)
    ]
