"""What `lerobot_gloves` itself offers, beside the modules that people outside the project import from."""

import importlib
import json
import subprocess
import sys

import pytest

import lerobot_gloves

SURFACE = {
    "lerobot_gloves.flow": ["interpolate", "integrate", "endpoint", "flow_matching_loss"],
    "lerobot_gloves.scores": ["ReverseScore", "ResidualScore", "LikelihoodScore", "SelfNormalisedScore"],
    "lerobot_gloves.conformal": ["ConformalGate"],
    "lerobot_gloves.editors": ["FPAS", "FEEG", "IFAE", "Reference"],
    "lerobot_gloves.perturbations": ["Noised", "Laggy", "Slow", "Shift"],
}
NAMES = sorted(name for names in SURFACE.values() for name in names)


def loaded_by(code: str) -> set[str]:
    """The packages outside the standard library that a fresh interpreter has loaded after the code."""
    code += "\nimport json, sys; print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1])) - sys.stdlib_module_names


def test_the_surface_is_what_the_modules_offer():
    assert sorted(lerobot_gloves.__all__) == NAMES
    for module, names in SURFACE.items():
        for name in names:
            assert getattr(lerobot_gloves, name) is getattr(importlib.import_module(module), name), name
    assert set(NAMES) <= set(dir(lerobot_gloves))


def test_what_the_library_does_not_offer_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"module 'lerobot_gloves' has no attribute 'SCORES'"):
        _ = lerobot_gloves.SCORES


def test_importing_the_library_loads_nothing_and_the_method_nothing_of_lerobot():
    assert not {"torch", "numpy", "lerobot"} & loaded_by("import lerobot_gloves")
    loaded = loaded_by("from lerobot_gloves import *; FEEG, integrate")
    assert "torch" in loaded and "lerobot" not in loaded
