"""The latest of what a page needs to know, from the simulation's thread to the server's."""

import asyncio

from lerobot_gloves.drive.session import Snapshot


class Board:
    """Holds one snapshot: a page on a slow line misses some, and nothing piles up.

    All methods but `publish` are the event loop's.
    """

    def __init__(self) -> None:
        self.latest: Snapshot | None = None
        self._news = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self) -> None:
        """Take snapshots for the pages of the running event loop."""
        self._loop = asyncio.get_running_loop()

    def publish(self, snapshot: Snapshot) -> None:
        """Show this from now on; from any thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._show, snapshot)

    async def newer(self) -> Snapshot:
        """The next snapshot that is published."""
        await self._news.wait()
        assert self.latest is not None
        return self.latest

    def _show(self, snapshot: Snapshot) -> None:
        self.latest = snapshot
        news, self._news = self._news, asyncio.Event()
        news.set()
