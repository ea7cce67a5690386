"""The paper's DiT velocity field (appendix "DiT Velocity Field", table (a))."""

import math
from functools import cache

import torch
import torch.nn.functional as F
from torch import Tensor, nn

type KeyValues = list[tuple[Tensor, Tensor]]
"""Keys and values of the context, (B, H, S, d / H) each, one pair a block."""


class DiT(nn.Module):
    """Transformer over action tokens that attends to context tokens and is modulated by time.

    Args:
        action_dim: A.
        context_dim: Width of a context token, d_c.
        width: Hidden width, d.
        depth: Number of blocks.
        heads: Attention heads, H.
        mlp_ratio: Expansion of the MLP, r.
        dropout: Dropout on each sub-layer's output.
        time_dim: Frequencies of the sinusoidal time embedding.
        beside_dim: Numbers that stand beside every action, C: a token is embedded from both.

    Raises:
        ValueError: If `width` does not split into `heads` of an even size.
    """

    def __init__(
        self,
        action_dim: int,
        context_dim: int = 256,
        width: int = 128,
        depth: int = 4,
        heads: int = 4,
        mlp_ratio: int = 4,
        dropout: float = 0.1,
        time_dim: int = 256,
        beside_dim: int = 0,
    ):
        super().__init__()
        if width % (2 * heads):
            raise ValueError(f"DiT: width {width} does not split into {heads} heads of an even size")
        self.head_dim = width // heads
        self.embed = nn.Linear(action_dim + beside_dim, width)
        self.time = TimeEmbedding(time_dim, width)
        self.blocks = nn.ModuleList(Block(width, context_dim, heads, mlp_ratio, dropout) for _ in range(depth))
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.modulation = _zero(nn.Linear(width, width))
        self.head = _zero(nn.Linear(width, action_dim))

    def project(self, context: Tensor) -> KeyValues:
        """Keys and values of context tokens (B, S, d_c), for every block: all that `forward` needs of a context."""
        return [block.cross.keys_values(context) for block in self.blocks]  # type: ignore[union-attr, operator]

    def forward(self, x: Tensor, t: Tensor, context: KeyValues) -> Tensor:
        """Velocity v(x, t | context).

        Args:
            x: Noisy chunks and what stands beside them, shape (n * B, T, A + C), the n of one context adjacent.
            t: Times in [0, 1], shape (n * B,).
            context: What `project` returned for the B contexts.

        Returns:
            Velocities, shape (n * B, T, A).
        """
        x, t = x.to(self.head.weight.dtype), t.to(self.head.weight.dtype)  # actions are of the type that the agent has
        hidden, condition = self.embed(x), F.silu(self.time(t))
        rotation = rotary(x.shape[1], self.head_dim, x.dtype, x.device)
        for block, key_values in zip(self.blocks, context, strict=True):
            hidden = block(hidden, condition, rotation, key_values)
        return self.head(self.norm(hidden) * (1 + self.modulation(condition)[:, None]))


class Block(nn.Module):
    """Self-attention, cross-attention and MLP, each behind AdaLN-Zero: x + gate(t) * f(norm(x) * (1 + scale(t)))."""

    def __init__(self, width: int, context_dim: int, heads: int, mlp_ratio: int, dropout: float):
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.attention = SelfAttention(width, heads)
        self.cross = CrossAttention(width, context_dim, heads)
        self.mlp = nn.Sequential(nn.Linear(width, mlp_ratio * width), nn.GELU(), nn.Linear(mlp_ratio * width, width))
        self.dropout = nn.Dropout(dropout)
        self.modulation = _zero(nn.Linear(width, 6 * width))

    def forward(
        self, x: Tensor, condition: Tensor, rotation: tuple[Tensor, Tensor], context: tuple[Tensor, Tensor]
    ) -> Tensor:
        """Shapes: x (n * B, T, d), condition (n * B, d)."""
        scale1, gate1, scale2, gate2, scale3, gate3 = self.modulation(condition)[:, None].chunk(6, dim=-1)
        x = x + gate1 * self._dropped(self.attention(self.norm(x) * (1 + scale1), rotation))
        x = x + gate2 * self._dropped(self.cross(self.norm(x) * (1 + scale2), context))
        return x + gate3 * self._dropped(self.mlp(self.norm(x) * (1 + scale3)))

    def _dropped(self, x: Tensor) -> Tensor:
        return self.dropout(x) if self.training else x  # of one chunk's forward the calls alone are a twentieth


class SelfAttention(nn.Module):
    """Attention among the T action tokens, rotary positions on queries and keys."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads, self.head_dim = heads, width // heads
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, rotation: tuple[Tensor, Tensor]) -> Tensor:
        """Shapes: x and result (N, T, d)."""
        parts = self.qkv(x).unflatten(-1, (3, self.heads, self.head_dim)).permute(2, 0, 3, 1, 4)
        query, key = rotate(parts[:2], rotation)  # both at once: on two cores the calls cost more than the numbers
        mixed = F.scaled_dot_product_attention(query, key, parts[2])
        return self.out(mixed.transpose(1, 2).flatten(2))


class CrossAttention(nn.Module):
    """Attention from action tokens to context tokens, without positions on the context."""

    def __init__(self, width: int, context_dim: int, heads: int):
        super().__init__()
        self.heads, self.head_dim = heads, width // heads
        self.query = nn.Linear(width, width)
        self.kv = nn.Linear(context_dim, 2 * width)
        self.out = nn.Linear(width, width)

    def keys_values(self, context: Tensor) -> tuple[Tensor, Tensor]:
        """Keys and values (B, H, S, d / H) of context tokens (B, S, d_c)."""
        key, value = self.kv(context).unflatten(-1, (2, self.heads, self.head_dim)).unbind(2)
        return key.transpose(1, 2), value.transpose(1, 2)

    def forward(self, x: Tensor, context: tuple[Tensor, Tensor]) -> Tensor:
        """Shapes: x and result (n * B, T, d)."""
        # Queries carry no positions here, so the n samples of a context become n * T queries of one attention, and
        # its keys and values are never copied.
        key, value = context
        query = self.query(x).reshape(key.shape[0], -1, self.heads, self.head_dim).transpose(1, 2)
        mixed = F.scaled_dot_product_attention(query, key, value)
        return self.out(mixed.transpose(1, 2).reshape(x.shape))


class TimeEmbedding(nn.Module):
    """Sinusoids of 1000 t, then a two-layer MLP."""

    rate: Tensor

    def __init__(self, frequencies: int, width: int):
        super().__init__()
        exponent = torch.arange(frequencies // 2) / (frequencies // 2)
        self.register_buffer("rate", 1000 * torch.exp(-math.log(10_000) * exponent), persistent=False)
        self.mlp = nn.Sequential(nn.Linear(frequencies, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, t: Tensor) -> Tensor:
        """Times (N,) to embeddings (N, d)."""
        angle = t[:, None] * self.rate
        return self.mlp(torch.cat([angle.cos(), angle.sin()], dim=-1))


@cache
def rotary(length: int, head_dim: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Cosines and sines of rotary positions 0 to `length` - 1, (T, head_dim / 2) each."""
    with torch.inference_mode(False):  # a training may be the next to use them
        rate = 10_000 ** (-torch.arange(0, head_dim, 2, dtype=dtype, device=device) / head_dim)
        angle = torch.arange(length, dtype=dtype, device=device)[:, None] * rate
        return angle.cos(), angle.sin()


def rotate(x: Tensor, rotation: tuple[Tensor, Tensor]) -> Tensor:
    """Turn each half-split pair of features of x (..., T, head_dim) by its position's angle."""
    cos, sin = rotation
    first, second = x.chunk(2, dim=-1)
    return torch.cat([first * cos - second * sin, first * sin + second * cos], dim=-1)


def _zero(layer: nn.Linear) -> nn.Linear:
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer
