"""The page in a real browser: Chromium, driven by Selenium against `gloves drive` itself."""

import shutil
import socket
import threading
import time

import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

import lerobot_policy_gloves  # noqa: F401, registers the person and the adapter
from lerobot_gloves.commands.drive import DriveConfig, drive
from lerobot_gloves.tasks.slalom import SlalomEnv

BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.together,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="needs Chromium and chromedriver: bash scripts/browser.sh"),
]

PATIENCE = 60.0
"""Seconds: a browser without a GPU takes long where other tests run beside it."""


@pytest.fixture(scope="module")
def site():
    """The address of a server, whose simulation runs in a thread of this process: it has imported everything."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config = DriveConfig(env=SlalomEnv(mode="1 1 1"), port=port, view=128)
    over = threading.Event()
    simulation = threading.Thread(target=drive, args=(config, over.is_set), daemon=True)
    simulation.start()
    until(lambda: not simulation.is_alive() or listens(port))
    assert simulation.is_alive()
    yield f"http://127.0.0.1:{port}/"
    over.set()
    simulation.join(PATIENCE)
    assert not simulation.is_alive()


def listens(port: int) -> bool:
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="module")
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--window-size=1280,900",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield found
    found.quit()


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def text(browser, name: str) -> str:
    return browser.find_element(By.ID, name).text


@pytest.fixture
def page(browser, site):
    """The page, which drives."""
    browser.get(site)
    until(lambda: text(browser, "role") == "You drive." and browser.find_element(By.ID, "camera").get_attribute("src"))
    browser.find_element(By.ID, "again").click()
    until(lambda: text(browser, "outcome").startswith("Ready"))
    yield browser
    ActionChains(browser).key_up(Keys.ARROW_RIGHT).perform()
    assert browser.get_log("browser") == []


def hold(browser, key: str, seconds: float) -> None:
    ActionChains(browser).key_down(key).pause(seconds).key_up(key).perform()


def assist(browser, how: str) -> None:
    choice = f"input[name=assistance][value={how}]"
    browser.find_element(By.CSS_SELECTOR, choice).click()
    until(lambda: browser.find_element(By.CSS_SELECTOR, choice).is_selected())


def test_keys_move_the_rod_and_letting_go_stops_it(page):
    assert "lower gap of the first row" in text(page, "words")
    assist(page, "off")
    ActionChains(page).key_down(Keys.ARROW_RIGHT).perform()
    until(lambda: text(page, "reading").startswith("Executed as sent"))
    ActionChains(page).key_up(Keys.ARROW_RIGHT).perform()
    until(lambda: text(page, "reading") == "Standing still.")


def test_a_rod_that_is_steered_into_a_pillar_fails_and_may_try_again(page):
    assist(page, "off")
    ActionChains(page).key_down("d").perform()
    until(lambda: text(page, "outcome") == "The rod touched a pillar. Press R to try again.")
    ActionChains(page).key_up("d").send_keys("r").perform()
    until(lambda: text(page, "outcome").startswith("Ready"))


def test_assistance_changes_what_is_executed(page):
    assist(page, "always")
    ActionChains(page).key_down(Keys.ARROW_RIGHT).perform()
    until(lambda: text(page, "reading").startswith("Edited"))


def test_a_second_page_watches(page, site):
    first = page.current_window_handle
    page.switch_to.new_window("tab")
    page.get(site)
    until(lambda: text(page, "role").startswith("You watch"))
    assert not page.find_element(By.ID, "again").is_enabled()
    page.close()
    page.switch_to.window(first)


def test_a_lost_connection_comes_back(page):
    page.set_network_conditions(offline=True, latency=0, throughput=0)
    page.delete_network_conditions()
    page.refresh()
    until(lambda: text(page, "role") == "You drive.")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1280, 900), (390, 844)])
def test_it_fits_and_every_control_has_a_name(page, scheme, width, height):
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    until(lambda: page.execute_script("return document.documentElement.scrollWidth") <= width)
    background = page.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert background == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 23, 27)"}[scheme]
    nodes = page.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    controls = {"button", "radio", "slider", "combobox", "application"}
    found = [node for node in nodes if node.get("role", {}).get("value") in controls]
    assert len(found) >= 9 and all(node["name"]["value"].strip() for node in found)
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
