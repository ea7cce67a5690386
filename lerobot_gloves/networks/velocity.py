"""A velocity field conditioned on observations: context encoders, DiT, and the two bound together."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from lerobot_gloves.networks.dit import DiT, KeyValues
from lerobot_gloves.networks.encoders import ImageEncoder, StateEncoder


class VelocityNetwork(nn.Module):
    """Conditional velocity field v(x, t | c) (paper, appendix "Model Architecture").

    The context is one token for the concatenated state vectors, one for the goal, which is read together with them
    since what it asks for depends on where the robot is, and a grid of tokens for each camera, whose encoders share
    no weights. What is dropped, the goal or in a network without one the whole context, becomes a learned null token
    (classifier-free guidance).

    Args:
        action_dim: A.
        states: Observation keys of the state vectors and their sizes.
        cameras: Observation keys of the images.
        goal: Observation key of the goal and its size, None without.
        context_dim: Width of a context token, d_c.
        context_dropout: Probability p_cfg that training drops an item's context (or goal).
        visual_dropout: Probability p_vd that training drops one whole view of an item.
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
        **dit: int | float,
    ):
        super().__init__()
        if not states and not cameras:
            raise ValueError("VelocityNetwork: neither a state vector nor a camera to be conditioned on")
        self.states, self.cameras, self.goal = tuple(states), tuple(cameras), goal[0] if goal else None
        self.context_dropout, self.visual_dropout = context_dropout, visual_dropout
        self.state_encoder = StateEncoder(sum(states.values()), context_dim) if states else None
        self.image_encoders = nn.ModuleList(ImageEncoder(context_dim) for _ in cameras)
        self.goal_encoder = StateEncoder(goal[1] + sum(states.values()), context_dim) if goal else None
        self.null = nn.Parameter(torch.zeros(1, 1, context_dim))
        self.dit = DiT(action_dim, context_dim, **dit)  # type: ignore[arg-type]

    def encode(self, observation: Mapping[str, Tensor]) -> tuple[Tensor, Tensor | None]:
        """Context tokens (B, S, d_c) and, if there is one, the goal's token (B, 1, d_c)."""
        vectors, tokens, goal = [observation[key] for key in self.states], [], None
        if self.state_encoder is not None:
            tokens.append(self.state_encoder(torch.cat(vectors, dim=-1)))
        if self.goal_encoder is not None and self.goal is not None:
            goal = self.goal_encoder(torch.cat([observation[self.goal], *vectors], dim=-1))
        for key, encoder in zip(self.cameras, self.image_encoders, strict=True):
            view = encoder(observation[key])
            tokens.append(view * self._keeps(view, self.visual_dropout))
        return torch.cat(tokens, dim=1), goal

    def bind(self, observation: Mapping[str, Tensor], guidance: float = 1.0) -> "BoundVelocity":
        """Encode the context of B observations and project its keys and values, once.

        Args:
            observation: Normalised observations, (B, S) a state vector, (B, 3, H, W) an image.
            guidance: Weight of the context (of the goal, where there is one) against the null: 1 is the plain
                conditional field, more exaggerates the context.

        Returns:
            The velocity field of these contexts.
        """
        context, goal = self.encode(observation)
        null = self.null.expand_as(context if goal is None else goal)
        conditional = context if goal is None else goal
        keep = self._keeps(conditional, self.context_dropout)
        conditional = torch.where(keep.bool(), conditional, null)

        def project(token: Tensor) -> KeyValues:
            return self.dit.project(token if goal is None else torch.cat([context, token], dim=1))

        return BoundVelocity(self.dit, project(conditional), None if guidance == 1.0 else project(null), guidance)

    def _keeps(self, tokens: Tensor, dropout: float) -> Tensor:
        """1 where an item's tokens are kept, 0 where training drops them, shape (B, 1, 1)."""
        if not self.training or dropout == 0:
            return tokens.new_ones(tokens.shape[0], 1, 1)
        return (torch.rand(tokens.shape[0], 1, 1, device=tokens.device) >= dropout).to(tokens.dtype)


class BoundVelocity:
    """The velocity field of B contexts: `velocity(x, t)` with x (n * B, T, A), t (n * B,).

    Attributes:
        evaluations: Evaluations per context so far; with guidance each call makes two.
    """

    def __init__(self, dit: DiT, context: KeyValues, null: KeyValues | None = None, guidance: float = 1.0):
        self.dit, self.context, self.null, self.guidance = dit, context, null, guidance
        self.evaluations = 0

    def __call__(self, x: Tensor, t: Tensor) -> Tensor:
        contexts = self.context[0][0].shape[0]
        self.evaluations += x.shape[0] // contexts * (1 if self.null is None else 2)
        if self.null is None:
            return self.dit(x, t, self.context)
        pairs = zip(self.context, self.null, strict=True)
        both = [(torch.cat([c[0], n[0]]), torch.cat([c[1], n[1]])) for c, n in pairs]
        conditional, unconditional = self.dit(torch.cat([x, x]), torch.cat([t, t]), both).chunk(2)
        return unconditional + self.guidance * (conditional - unconditional)

    def select(self, rows: Tensor) -> "BoundVelocity":
        """The field of some of the contexts: `rows` is bool (B,)."""

        def pick(context: KeyValues) -> KeyValues:
            return [(key[rows], value[rows]) for key, value in context]

        null = None if self.null is None else pick(self.null)
        return BoundVelocity(self.dit, pick(self.context), null, self.guidance)
