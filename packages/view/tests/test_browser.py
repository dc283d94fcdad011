"""The page in a real browser: it loads, moves, reconnects, and moves an arm while a button is held."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

import urlink
from tests.waiting import until
from urlink.robot import View
from urlink.simulator import Controller

pytestmark = pytest.mark.real_time

DRIVER = shutil.which("chromedriver")
#: Maximum wait, in s. Without a graphics card, a computer needs half a minute to draw the first image.
SOON = 120.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    pytest.importorskip("viser", reason="needs viser: uv pip install viser")
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium: uv pip install selenium")
    if DRIVER is None:
        pytest.skip("needs chromedriver, of the system's package chromium-driver")
    options = webdriver.ChromeOptions()
    for option in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "enable-unsafe-swiftshader"):
        options.add_argument(f"--{option}")
    options.add_argument("--window-size=900,900")
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def said(browser: Any, name: str) -> str:
    """Return the value of a row in the page's table; an empty text if there is no such row."""
    found = browser.execute_script(
        "return [...document.querySelectorAll('tr')].filter(r => r.cells[0]?.innerText === arguments[0])"
        ".map(r => r.cells[1].innerText)[0]",
        name,
    )
    return "" if found is None else str(found)


def button(browser: Any, label: str) -> Any:
    """Return the button with this label; None if there is none."""
    return next((each for each in browser.find_elements("tag name", "button") if each.text.strip() == label), None)


def opened(browser: Any, view: View) -> None:
    browser.get(view.address)
    until(lambda: said(browser, "connection") == "live", SOON)


def test_page_shows_motion_and_reconnects(browser: Any) -> None:
    with urlink.connect("sim://ur5e?firmware=5.11&motion=demo") as robot:
        with robot.view() as view:
            opened(browser, view)
            assert said(browser, "arm") == "UR5e"
            assert said(browser, "safety") == "NORMAL"
            assert browser.find_elements("tag name", "canvas")
            place = said(browser, "TCP, mm")
            until(lambda: said(browser, "TCP, mm") != place, SOON)
            port = int(view.address.rpartition(":")[2].rstrip("/"))
        # The open page finds a new view at the same address.
        with robot.view(plots=["I_actual"], port=port):
            until(lambda: "I_actual" in browser.find_element("tag name", "body").text, SOON)
            place = said(browser, "TCP, mm")
            until(lambda: said(browser, "TCP, mm") not in ("", place), SOON)


def test_disconnected_arm_is_not_shown_as_live(browser: Any) -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot, robot.view() as view:
        opened(browser, view)
        controller.close()
        until(lambda: "shown state is" in said(browser, "connection"), SOON)


def test_arm_moves_while_button_is_held(browser: Any) -> None:
    actions = pytest.importorskip("selenium.webdriver").ActionChains
    with urlink.connect("sim://ur5e?firmware=5.11") as robot, robot.view(jog=True, plots=()) as view:
        opened(browser, view)
        start = robot.realtime.wait().q_actual.copy()
        # Without the check mark, the page only shows the arm.
        until(lambda: button(browser, "base +"), SOON)
        assert not button(browser, "base +").is_enabled()
        box = browser.find_elements("css selector", "input[type=checkbox]")[-1]
        browser.execute_script("arguments[0].click()", box)
        until(lambda: button(browser, "base +").is_enabled(), SOON)
        actions(browser).click_and_hold(button(browser, "base +")).perform()
        until(lambda: robot.realtime.wait().q_actual[0] - start[0] > 0.05, SOON)
        # Release the mouse button outside the page's button.
        actions(browser).move_by_offset(0, 60).release().perform()
        until(lambda: not any(abs(robot.realtime.wait().qd_target) > 1e-6))
        end = robot.realtime.wait().q_actual
        assert end[0] > start[0]
        assert abs(end[1:] - start[1:]).max() < 1e-3
        # Removing the check mark ends the program.
        browser.execute_script("arguments[0].click()", box)
        until(lambda: not button(browser, "base +").is_enabled(), SOON)
        robot.motion.move_joints(start, wait=True)
