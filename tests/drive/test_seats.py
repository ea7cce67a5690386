"""Who drives and who watches."""

import pytest

from lerobot_gloves.drive.seats import PAGES, FullError, Seats
from lerobot_gloves.drive.stick import CENTRE, Stick


@pytest.fixture
def seats():
    return Seats(Stick())


def test_the_first_page_drives_and_a_watcher_takes_over_only_when_it_asks_and_nobody_drives(seats):
    driver, watcher = seats.enter("a"), seats.enter("b")
    assert seats.driver is driver and not seats.take(watcher)
    seats._stick.move(1.0, 0.0)
    seats.leave(driver)
    assert seats.driver is None and seats._stick.position == CENTRE
    assert seats.take(watcher) and seats.driver is watcher
    assert not seats.take(driver)  # it is gone


def test_who_watches_and_leaves_does_not_stop_the_robot(seats):
    seats.enter("a")
    watcher = seats.enter("b")
    seats._stick.move(1.0, 0.0)
    seats.leave(watcher)
    seats.leave(watcher)
    assert seats._stick.position == (1.0, 0.0, 0.0, 0.0)


def test_a_page_that_reconnects_drives_on_while_its_old_connection_still_seems_alive(seats):
    old, watcher = seats.enter("a"), seats.enter("b")
    new = seats.enter("a")
    assert seats.driver is new and old.replaced and not watcher.replaced
    seats.leave(old)  # as its connection ends at last
    assert seats.driver is new


def test_pages_without_a_name_are_never_taken_for_one_another(seats):
    first, second = seats.enter(""), seats.enter("")
    assert seats.driver is first and not first.replaced and not second.replaced


def test_a_hundred_pages_are_too_many(seats):
    entered, refused = [], 0
    for number in range(100):
        try:
            entered.append(seats.enter(f"page {number}"))
        except FullError as error:
            refused += 1
            assert str(error) == f"{PAGES} pages are open already: close one"
    assert len(entered) == PAGES and refused == 100 - PAGES and seats.driver is entered[0]
    seats.leave(entered[5])
    seats.enter("another")
