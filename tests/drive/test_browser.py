"""The pages in a real browser: Chromium, driven by Selenium, against `gloves drive` itself and a replay's file."""

import shutil
from types import SimpleNamespace

import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.select import Select

from lerobot_gloves.drive.driver import Driver, Skill
from lerobot_gloves.drive.slalom import SlalomView
from lerobot_gloves.report.replay_page import replay_html
from scripts.benchmark_drive import Watcher, press
from tests.drive.serving import served, until

BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.together,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="needs Chromium and chromedriver: bash scripts/browser.sh"),
]


@pytest.fixture(scope="module")
def site():
    with served({"mode": "1 1 1"}) as address:
        yield address


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


def test_a_corridor_is_completed_by_keys(page, site):
    """Pressed by a quick driver who sees the page, and may try again: other tests run beside it."""
    assist(page, "off")
    watcher, view = Watcher(site), SlalomView()
    until(lambda: "task" in watcher.about)
    seen = SimpleNamespace(place=lambda state: state["place"], steer=view.steer, targets=view.targets)
    for attempt in range(3):
        skill = Skill(reaction=(0.2, 0.0), foresees=1.0, thinks=0.1, misjudges=0.0, slips=0.0)
        driver, down = Driver("gloves_slalom", seen, skill, attempt, watcher.about["task"]), set()
        while watcher.next()["phase"] in ("ready", "driving"):
            down = press(page, down, *driver.command(watcher.state)[:2])
        press(page, down, 0, 0)
        if watcher.state["phase"] == "success":
            break
        page.find_element(By.ID, "again").click()
        until(lambda: watcher.next()["phase"] == "ready")
    watcher.close()
    assert text(page, "outcome").startswith("Success!")


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


def test_a_study_is_blind_and_ends_with_its_results(browser, tmp_path):
    with served({"episode_length": 10}, study=2, output_dir=tmp_path / "study") as address:
        browser.get(address)
        for episode in (1, 2):
            until(lambda: text(browser, "progress") == f"Study: episode {episode} of 2.")  # noqa: B023
            until(lambda: text(browser, "outcome").startswith("Ready"))
            hidden = ("settings", "strip", "again", "results")
            assert not any(browser.find_element(By.ID, name).is_displayed() for name in hidden)
            ActionChains(browser).key_down(Keys.ARROW_RIGHT).perform()
            until(lambda: text(browser, "outcome").startswith("The time is up."))
            ActionChains(browser).key_up(Keys.ARROW_RIGHT).send_keys("n").perform()
        until(lambda: text(browser, "progress") == "Study: all 2 episodes are done.")
        rows = browser.find_elements(By.CSS_SELECTOR, "#table tbody tr")
        assert [row.find_element(By.TAG_NAME, "th").text for row in rows] == [
            "without assistance",
            "with assistance",
            "difference",
        ]
        until(lambda: browser.execute_script("return document.getElementById('paths').naturalWidth") > 0)
        until((tmp_path / "study" / "dataset" / "README.md").is_file)
        assert browser.get_log("browser") == []
        browser.get("about:blank")  # else it tells of a server that is gone


def test_a_replay_is_scrubbed_through_by_keys_from_the_disk(browser, tmp_path):
    line = {"length": 4, "score": None, "distance": 0.5, "milliseconds": 3.0, "evaluations": 2.0}
    actions = {"proposed": [[0.0, 1.0]] * 4, "executed": [[0.5, 1.5]] * 4}
    chunks = [{**line, **actions, "step": 4 * i, "p_value": 0.5 / (i + 1), "edited": i in (1, 2)} for i in range(4)]
    page = tmp_path / "page.html"
    page.write_text(replay_html({7: chunks, 8: chunks[:1]}, {}, about="a log", rate=20))
    browser.get(page.as_uri())
    assert text(browser, "count") == "2 of 4 chunks edited" and text(browser, "heading").endswith(
        "executed as proposed"
    )
    seen = []
    for key in ("n", "n", "n", Keys.ARROW_RIGHT, "p"):
        ActionChains(browser).send_keys(key).perform()
        seen.append((browser.find_element(By.ID, "step").get_property("value"), text(browser, "heading")))
    second, third = "Chunk 2: edited", "Chunk 3: edited"
    assert seen == [("4", second), ("8", third), ("8", third), ("9", third), ("8", third)]
    assert "0.167" in text(browser, "facts") and browser.find_element(By.ID, "plot").is_displayed()
    assert text(browser, "missing") == "This episode has no video."
    Select(browser.find_element(By.ID, "episode")).select_by_visible_text("8 (no video)")
    assert text(browser, "count") == "0 of 1 chunks edited" and not browser.find_element(By.ID, "next").is_enabled()
    nodes = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    controls = [node for node in nodes if node.get("role", {}).get("value") in ("button", "slider", "combobox")]
    assert len(controls) >= 5 and all(node["name"]["value"].strip() for node in controls)
    assert browser.get_log("browser") == []
