import urllib.error

import pytest
import torch
import torch.nn.functional as F
from torch import nn
from torchvision.models import ResNet18_Weights, resnet18

from lerobot_gloves.networks.encoders import ImageEncoder, StateEncoder


@pytest.fixture(scope="module")
def encoder() -> ImageEncoder:
    torch.manual_seed(0)
    return ImageEncoder(8)


def test_a_view_of_256_becomes_16_by_16_tokens_in_reading_order(encoder):
    image = torch.zeros(1, 3, 256, 256)
    with torch.no_grad():
        blank = encoder(image)
        assert blank.shape == (1, 16 * 16, 8)
        image[:, :, 200:208, 40:48] = 5.0
        changed = (encoder(image) - blank).norm(dim=-1)[0].view(16, 16)
    # The patch lies in the token of row 200 / 16 and column 40 / 16; fields of view overlap around it.
    row, column = divmod(int(changed.argmax()), 16)
    assert abs(row - 12) <= 1 and abs(column - 2) <= 1


def test_it_is_resnet18_up_to_its_third_stage(encoder):
    """With the same weights as torchvision's whole network, whose batch norm is not the frozen kind."""
    net = resnet18(weights=None)
    stages = {str(i): name for i, name in enumerate(["conv1", "bn1", "relu", "maxpool", "layer1", "layer2", "layer3"])}
    weights = {
        f"{stages[key.split('.')[0]]}.{key.split('.', 1)[1]}": v for key, v in encoder.backbone.state_dict().items()
    }
    missing, unexpected = net.load_state_dict(weights, strict=False)
    assert not unexpected
    assert all(key.startswith(("layer4", "fc")) or key.endswith("num_batches_tracked") for key in missing)
    image = torch.randn(2, 3, 64, 64)
    seen = {}
    net.layer3.register_forward_hook(lambda *call: seen.update(out=call[-1]))
    with torch.no_grad():
        net.eval()(image)
        tokens = encoder.project(seen["out"]).flatten(2).transpose(1, 2)
        torch.testing.assert_close(encoder(image), tokens)


def test_batch_norm_is_frozen_also_in_training(encoder):
    image = torch.randn(4, 3, 64, 64)
    buffers = {key: value.clone() for key, value in encoder.named_buffers()}
    with torch.no_grad():
        training, evaluating = encoder.train()(image), encoder.eval()(image)
        alone = encoder.train()(image[:1])
    torch.testing.assert_close(training, evaluating, rtol=0, atol=0)
    torch.testing.assert_close(alone, training[:1])
    assert buffers and all(torch.equal(value, buffers[key]) for key, value in encoder.named_buffers())
    assert not any(isinstance(module, nn.BatchNorm2d) for module in encoder.modules())


def test_pretrained_weights_fill_the_backbone_without_the_last_stage(monkeypatch):
    source = resnet18(weights=None).state_dict()
    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", lambda *_, **__: source)
    encoder = ImageEncoder(8)
    encoder.load_pretrained("ResNet18_Weights.IMAGENET1K_V1")
    loaded = encoder.backbone.state_dict()
    assert torch.equal(loaded["0.weight"], source["conv1.weight"])
    assert torch.equal(loaded["6.1.bn2.running_var"], source["layer3.1.bn2.running_var"])


@pytest.mark.parametrize(
    "error",
    [
        urllib.error.URLError("no route to host"),
        ConnectionResetError("reset"),
        RuntimeError('invalid hash value (expected "f37072fd",\ngot "0a1b")'),  # as torch.hub has it
    ],
)
def test_weights_that_cannot_be_fetched_are_one_line_that_names_the_option(monkeypatch, error):
    def unreachable(*_, **__):
        raise error

    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", unreachable)
    with pytest.raises(OSError, match=r"--policy\.pretrained_backbone_weights=null") as raised:
        ImageEncoder(8).load_pretrained("ResNet18_Weights.IMAGENET1K_V1")
    assert "IMAGENET1K_V1" in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize("weights", ["ResNet18_Weights.NONE_SUCH", "ResNet50_Weights.IMAGENET1K_V1", "nonsense"])
def test_unknown_weights_are_refused_with_the_valid_ones(weights):
    with pytest.raises(ValueError, match=rf"{weights}.* choose from .*ResNet18_Weights\.IMAGENET1K_V1"):
        ImageEncoder(8).load_pretrained(weights)


def test_a_stretched_state_becomes_one_token_by_three_layers():
    encoder, state = StateEncoder(5, 8), torch.randn(3, 5)
    first, second, third = (module for module in encoder.modules() if isinstance(module, nn.Linear))
    assert [tuple(layer.weight.shape) for layer in (first, second, third)] == [(256, 5), (256, 256), (8, 256)]
    expected = third(F.gelu(second(F.gelu(first(4 * state)))))
    torch.testing.assert_close(encoder(state), expected[:, None])
