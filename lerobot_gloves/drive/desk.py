"""From a page's messages to what they do: the one place where a page can do anything."""

import logging

from lerobot_gloves.drive.protocol import Begin, Command, MessageError, Settings, Take, parse
from lerobot_gloves.drive.seats import Seat, Seats
from lerobot_gloves.drive.session import Driven

logger = logging.getLogger(__name__)

PATIENCE = 20
"""Messages of one connection that may be refused before it is closed."""


class Desk:
    """Does what the driver's page says, and tells any page in one line what it did wrong.

    Attributes:
        seats: Who drives and who watches.

    Args:
        session: What is driven.
    """

    def __init__(self, session: Driven) -> None:
        self.seats = Seats(session.stick)
        self._session = session

    def receive(self, seat: Seat, text: str | bytes) -> bool:
        """Take a page's message; False if it has sent so many wrong ones that its connection is to be closed."""
        try:
            message = parse(text)
            if not isinstance(message, Take) and self.seats.driver is not seat:
                raise MessageError("only the page that drives may do that")
        except MessageError as error:
            if self.seats.driver is seat:
                self._session.stick.release()
            if seat.refused == 0:
                logger.warning("gloves drive: a page sent a wrong message: %s", error)
            seat.refused += 1
            seat.lines.append(str(error))
            return seat.refused < PATIENCE
        match message:
            case Command(x, y, z, grip):
                self._session.stick.move(x, y, z, grip)
            case Settings() | Begin():
                self._session.ask(message)
            case Take():
                self.seats.take(seat)
        return True
