"""Manners of worker processes. Imports next to nothing, so that a worker minds them from its first moment."""

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator


def begin_worker() -> None:
    """End this process when its parent is gone, and make it know the policies and environments."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    logging.disable(logging.WARNING)  # each cell has the same ones
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()


@contextlib.contextmanager
def interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C meanwhile; processes that are started meanwhile go on ignoring it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
