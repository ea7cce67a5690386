import math

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from lerobot_gloves.networks.dit import Block, DiT, SelfAttention, TimeEmbedding, rotary, rotate
from tests.builders import awaken
from tests.gaussian import seeded

T, A, CONTEXT = 5, 2, 6


def make_dit(**options) -> DiT:
    torch.manual_seed(0)
    return DiT(A, CONTEXT, **{"width": 16, "depth": 2, "heads": 2, "time_dim": 8, **options}).double().eval()


def awake_dit(**options) -> DiT:
    dit = make_dit(**options)
    awaken(dit)
    return dit


def inputs(rows: int = 3, tokens: int = 4):
    g = seeded(1)
    x = torch.randn(rows, T, A, generator=g, dtype=torch.float64)
    t = torch.rand(rows, generator=g, dtype=torch.float64)
    return x, t, torch.randn(rows, tokens, CONTEXT, generator=g, dtype=torch.float64)


def test_it_starts_as_the_zero_field_with_blocks_that_change_nothing():
    dit = make_dit()
    x, t, context = inputs()
    assert not dit(x, t, dit.project(context)).any()
    block = dit.blocks[0]
    hidden = torch.randn(3, T, 16, dtype=torch.float64)
    condition = torch.randn(3, 16, dtype=torch.float64)
    out = block(hidden, condition, rotary(T, 8, hidden.dtype, hidden.device), block.cross.keys_values(context))
    torch.testing.assert_close(out, hidden, rtol=0, atol=0)


def test_a_block_is_the_papers_formula():
    """Written anew with torch's own attention and no rotation, for one block of one head."""
    torch.manual_seed(0)
    block = Block(8, CONTEXT, heads=1, mlp_ratio=2, dropout=0.0).double()
    awaken(block)
    hidden = torch.randn(2, T, 8, dtype=torch.float64)
    condition = torch.randn(2, 8, dtype=torch.float64)
    context = torch.randn(2, 3, CONTEXT, dtype=torch.float64)
    still = (torch.ones(T, 4, dtype=torch.float64), torch.zeros(T, 4, dtype=torch.float64))
    scale1, gate1, scale2, gate2, scale3, gate3 = block.modulation(condition).split(8, dim=-1)

    def norm(x, scale):
        centred = x - x.mean(-1, keepdim=True)
        return centred / (centred.square().mean(-1, keepdim=True) + 1e-5).sqrt() * (1 + scale[:, None])

    def attend(query, key, value):
        return ((query @ key.mT) / math.sqrt(8)).softmax(-1) @ value

    x = hidden
    query, key, value = block.attention.qkv(norm(x, scale1)).split(8, dim=-1)
    x = x + gate1[:, None] * block.attention.out(attend(query, key, value))
    key, value = block.cross.kv(context).split(8, dim=-1)
    x = x + gate2[:, None] * block.cross.out(attend(block.cross.query(norm(x, scale2)), key, value))
    first, _, second = block.mlp
    x = x + gate3[:, None] * second(F.gelu(first(norm(x, scale3))))
    torch.testing.assert_close(block(hidden, condition, still, block.cross.keys_values(context)), x)


def test_rotary_attention_sees_only_how_far_apart_two_actions_are():
    head_dim, length = 8, 12
    g = seeded(2)
    query = torch.randn(head_dim, generator=g, dtype=torch.float64).expand(1, 1, length, -1)
    key = torch.randn(head_dim, generator=g, dtype=torch.float64).expand(1, 1, length, -1)
    rotation = rotary(length, head_dim, query.dtype, query.device)
    logits = (rotate(query, rotation) @ rotate(key, rotation).mT)[0, 0]
    for offset in range(-length + 1, length):
        diagonal = logits.diagonal(offset)
        torch.testing.assert_close(diagonal, diagonal[:1].expand_as(diagonal))
    # And it does see it: hand-derived as a sum of planar rotations by offset * 10000 ** (-2 i / head_dim).
    q, k = torch.complex(*query[0, 0, 0].chunk(2)), torch.complex(*key[0, 0, 0].chunk(2))
    rate = 10_000 ** (-torch.arange(4, dtype=torch.float64) * 2 / head_dim)
    expected = [(q * k.conj() * torch.polar(torch.ones(4).double(), -rate * n)).real.sum() for n in range(length)]
    torch.testing.assert_close(logits[0], torch.stack(expected))


def test_self_attention_depends_on_the_order_of_actions():
    torch.manual_seed(0)
    attention = SelfAttention(16, heads=2).double()
    x = torch.randn(1, T, 16, dtype=torch.float64)
    rotation = rotary(T, 8, x.dtype, x.device)
    assert not torch.allclose(attention(x.flip(1), rotation), attention(x, rotation).flip(1))


def test_what_inference_worked_out_serves_a_training():
    dit, (x, t, context) = awake_dit(), inputs()
    rotary.cache_clear()
    with torch.inference_mode():
        alone = dit(x, t, dit.project(context))
    out = dit(x, t, dit.project(context))
    out.square().sum().backward()
    torch.testing.assert_close(out, alone)
    assert dit.blocks[0].attention.qkv.weight.grad.abs().sum() > 0


def test_the_order_of_context_tokens_does_not_matter_but_each_of_them_does():
    dit = awake_dit()
    x, t, context = inputs()
    out = dit(x, t, dit.project(context))
    torch.testing.assert_close(dit(x, t, dit.project(context.flip(1))), out)
    for token in range(context.shape[1]):
        changed = context.clone()
        changed[:, token] += 1
        assert (dit(x, t, dit.project(changed)) - out).abs().amax(dim=(1, 2)).min() > 1e-6


def test_samples_of_one_context_folded_into_one_call_equal_separate_calls():
    dit = awake_dit()
    _, _, context = inputs(rows=2)
    g = seeded(3)
    x = torch.randn(6, T, A, generator=g, dtype=torch.float64)  # three of the first context, three of the second
    t = torch.rand(6, generator=g, dtype=torch.float64)
    folded = dit(x, t, dit.project(context))
    alone = [dit(x[i : i + 1], t[i : i + 1], dit.project(context[i // 3 : i // 3 + 1])) for i in range(6)]
    torch.testing.assert_close(folded, torch.cat(alone))


def test_the_time_embedding_is_sinusoids_of_a_thousand_t():
    embedding = TimeEmbedding(8, 4)
    embedding.mlp = nn.Identity()
    t = torch.tensor([0.0, 0.3])
    frequencies = [10_000 ** (-i / 4) for i in range(4)]
    expected = [[f(1000 * s * w) for f in (math.cos, math.sin) for w in frequencies] for s in t.tolist()]
    torch.testing.assert_close(embedding(t), torch.tensor(expected), rtol=0, atol=1e-4)


@pytest.mark.parametrize(("width", "heads"), [(16, 3), (12, 4)])
def test_a_width_that_does_not_split_is_refused(width, heads):
    with pytest.raises(ValueError, match=f"width {width} does not split into {heads} heads"):
        make_dit(width=width, heads=heads)


def test_table_a_is_the_default_size():
    """Each of 4 blocks: attention (3 + 1 + 1 + 1) d^2, keys and values 2 c d, MLP 8 d^2, AdaLN 6 d^2."""
    d, c = 128, 256
    weights = 4 * (6 * d * d + 2 * c * d + 8 * d * d + 6 * d * d) + 256 * d + d * d + d * d + 2 * d * A
    assert sum(p.numel() for p in DiT(A).parameters() if p.ndim > 1) == weights
