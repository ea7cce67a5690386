"""Processors of `gloves_copilot`: LeRobot's default pipelines (rename, batch, device, normalise; and back)."""

from lerobot.processor import make_default_pre_post_processors

make_gloves_copilot_pre_post_processors = make_default_pre_post_processors
