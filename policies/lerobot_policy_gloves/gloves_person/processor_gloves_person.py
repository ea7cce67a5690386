"""Processors of `gloves_person`: a command is a raw action, so nothing is normalised, as around the wrapper."""

from ..gloves.processor_gloves import make_gloves_pre_post_processors

make_gloves_person_pre_post_processors = make_gloves_pre_post_processors
