"""How the commands begin that read datasets."""

import logging

from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging


def start() -> None:
    """Set logging up and load the plugins that are installed."""
    init_logging()
    # Where FFmpeg is missing LeRobot tells of it at length, and goes on with another decoder.
    logging.getLogger("lerobot.utils.import_utils").addFilter(lambda record: "torchcodec" not in record.getMessage())
    register_third_party_plugins()
