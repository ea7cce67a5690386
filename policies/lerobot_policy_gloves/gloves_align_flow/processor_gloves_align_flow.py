"""Processors of `gloves_align_flow`: those of every flow."""

from gloves_flow.inputs import make_flow_pre_post_processors

make_gloves_align_flow_pre_post_processors = make_flow_pre_post_processors
