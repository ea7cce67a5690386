"""Processors of `gloves_flow_policy`: those of every flow."""

from gloves_flow.inputs import make_flow_pre_post_processors

make_gloves_flow_policy_pre_post_processors = make_flow_pre_post_processors
