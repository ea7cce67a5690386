"""Processors of `csa_assist`: those of every flow."""

from gloves_flow.inputs import make_flow_pre_post_processors

make_csa_assist_pre_post_processors = make_flow_pre_post_processors
