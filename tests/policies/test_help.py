import dataclasses

import pytest
from draccus.wrappers.docstring import get_attribute_docstring, get_preferred_help_text
from lerobot.configs import PreTrainedConfig

OURS = ["gloves", "gloves_expert_flow", "gloves_flow_policy", "gloves_align_flow", "ddpm_assist", "csa_assist"]


@pytest.mark.parametrize("kind", OURS)
def test_every_option_is_explained_in_lerobots_help(kind):
    config = PreTrainedConfig.get_choice_class(kind)
    inherited = {field.name for field in dataclasses.fields(PreTrainedConfig)}
    own = [field.name for field in dataclasses.fields(config) if field.name not in inherited]
    assert len(own) > 10
    for name in own:
        text = get_preferred_help_text(get_attribute_docstring(config, name))
        # What draccus takes for a field's comment may be the code below it.
        assert text and "def " not in text, f"{name}: {text}"
