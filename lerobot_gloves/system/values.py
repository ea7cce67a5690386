"""What was typed, as the one who typed it meant it."""

import os

import yaml

NOTHING = ("null", "~")
"""How an option is typed that shall have no value, where it may have none."""


def text_value(typed: str) -> str:
    """The text that was typed for an option that takes text, such as a folder's name.

    Every character counts, be it YAML or not, unless all of it stands in quotes; `~` is a home, which no shell makes of
    it behind an equals sign.
    """
    if typed[:1] in ("'", '"'):
        try:
            content = yaml.safe_load(typed)
        except yaml.YAMLError:
            content = None
        if isinstance(content, str):
            return content
    return os.path.expanduser(typed)
