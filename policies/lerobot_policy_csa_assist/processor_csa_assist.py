"""Processors of `csa_assist`: LeRobot's default pipelines (rename, batch, device, normalise; and back)."""

from lerobot.processor import make_default_pre_post_processors

make_csa_assist_pre_post_processors = make_default_pre_post_processors
