"""A file that lies beside a checkpoint's weights."""

import logging
from pathlib import Path

from huggingface_hub import hf_hub_download
from huggingface_hub.errors import EntryNotFoundError, LocalEntryNotFoundError


def beside(checkpoint: str | Path, name: str, revision: str | None, what: str) -> Path | None:
    """Where a file of a checkpoint, a folder or a Hub id, lies on this machine; None if it has none.

    Args:
        checkpoint: The checkpoint.
        name: The file's.
        revision: The Hub revision.
        what: What the file holds, for the warning that the Hub is out of reach.
    """
    if Path(checkpoint).is_dir():
        path = Path(checkpoint) / name
        return path if path.exists() else None
    try:
        return Path(hf_hub_download(str(checkpoint), name, revision=revision))
    except LocalEntryNotFoundError:
        logging.warning("the Hub is out of reach: %s is used without the %s it may have", checkpoint, what)
        return None
    except EntryNotFoundError:
        return None
