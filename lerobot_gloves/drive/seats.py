"""Who drives and who watches."""

from collections import deque

from lerobot_gloves.drive.stick import Stick

PAGES = 32
"""How many pages may be open at once."""


class FullError(ConnectionError):
    """Too many pages are open."""


class Seat:
    """A page that is connected.

    Attributes:
        page: What the page calls itself: by it a page that reconnects is known.
        lines: What it is still to be told, the oldest first.
        refused: How many of its messages were refused.
        replaced: Whether the same page has connected anew since.
    """

    def __init__(self, page: str) -> None:
        self.page = page
        self.lines: deque[str] = deque(maxlen=5)
        self.refused = 0
        self.replaced = False


class Seats:
    """The first page drives, every other one watches; when the driver leaves, the stick goes back to its centre.

    A driver's page that connects anew, after a lost connection, drives on, even while its old connection still seems
    to be alive. A watcher takes the controls by asking for them, once nobody has them.

    Attributes:
        driver: Who drives, None if nobody does.

    Args:
        stick: What the driver moves.
    """

    def __init__(self, stick: Stick) -> None:
        self.driver: Seat | None = None
        self._stick = stick
        self._taken: list[Seat] = []

    def enter(self, page: str) -> Seat:
        """A page connects.

        Raises:
            FullError: If too many are.
        """
        seat = Seat(page)
        if self.driver is not None and page and self.driver.page == page:
            self.driver.replaced = True
            self.leave(self.driver)
        if len(self._taken) >= PAGES:
            raise FullError(f"{PAGES} pages are open already: close one")
        self._taken.append(seat)
        self.take(seat)
        return seat

    def take(self, seat: Seat) -> bool:
        """Let a page drive, if nobody does; whether it drives now."""
        if self.driver is None and seat in self._taken:
            self.driver = seat
        return self.driver is seat

    def leave(self, seat: Seat) -> None:
        """A page is gone; a second time changes nothing."""
        if seat in self._taken:
            self._taken.remove(seat)
        if self.driver is seat:
            self.driver = None
            self._stick.release()
