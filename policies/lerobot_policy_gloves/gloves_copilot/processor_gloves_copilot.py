"""Processors of `gloves_copilot`: those of every flow."""

from gloves_flow.inputs import make_flow_pre_post_processors

make_gloves_copilot_pre_post_processors = make_flow_pre_post_processors
