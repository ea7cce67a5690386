"""The wrapper on each device that there is: a GPU's edits repeat to the bit, and are the CPU's up to rounding."""

import pytest
import torch

from tests.builders import calibrate, observation, save_policy, wrap

GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """An agent, and an adapter with both flows whose gate turns most proposals away."""
    folder = tmp_path_factory.mktemp("devices")
    adapter = save_policy(folder / "adapter", "gloves_align_flow", seed=2, sources=["expert", "none"])
    scores = torch.linspace(0, 8, 99).expand(6, -1)
    return save_policy(folder / "agent", "gloves_flow_policy"), calibrate(adapter, scores={"reverse:steps=1": scores})


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=GPU)])
@pytest.mark.parametrize("method", ["feeg", "fpas:iterations=2,candidates=4", "ifae"])
def test_edits_are_the_same(folders, method, device):
    agent, adapter = folders
    played = []
    for place in (device, device, "cpu"):
        policy = wrap(agent, adapter=adapter, method=method, gate=True, device=place, seed=3)
        seen = {key: value.to(place) for key, value in observation(4).items()}
        with torch.inference_mode():
            played.append(torch.stack([policy.select_action(seen).cpu() for _ in range(8)]))
        assert policy.statistics()["intervention_rate"] > 0
    first, again, expected = played
    assert torch.equal(first, again)
    torch.testing.assert_close(first, expected, rtol=1e-3, atol=1e-4)
