"""The page of `jaxik view` in a real browser, headless: `python tests/view_page.py SCREENSHOT.png` (needs Chromium, selenium).

It is no test of pytest's, because a browser is no Python package; CI runs it. A sweep is made, the page opened, the joints, the
target, the map and a fruit's posture changed by its controls; the pictures must differ by what was changed, the words be there,
also on a narrow screen, and the console be clean. The narrow screen's picture lies beside the first.
"""

import io
import itertools
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

import jaxik
from jaxik.view.page import Page
from jaxik.view.robot_drawing import SHOWS
from jaxik.view.solids import frames

STUDY = {
    "robot": "p6r",
    "slides": 11,
    "audited": 0,
    "base": {"z": [0.0, 0.25]},
    "targets": {
        "kind": "grid",
        "x": [-0.2, 1.2, 15],
        "y": [0.1, 0.9, 9],
        "z": [0.0, 1.0, 11],
        "directions": [[0, 1, 0], [0.7, 0.7, 0], [-0.7, 0.7, 0]],
    },
}
PINK = (255, 32, 96)  # of the target's square
TABS = {
    "Robot": ("robot as", "target to drag", "slide [m]", "theta2 [deg]"),
    "Map": ("reachable from every direction", "not reachable", "z [m]"),
    "Fruits": ("p6r can pick 10 of the 12 fruits", "the best posture stays"),
    "Motions": ("p6r picks 9 of 12 fruits in", "Play", "drag the time"),
    "Help": ("Target:", "Inverse kinematics follows"),
}


def browser():
    """Chromium without a window, drawing in software."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("chromium-browser") or ""
    for flag in ("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"):
        options.add_argument(flag)
    options.add_argument("--window-size=1400,900")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))


def picture(driver):
    return np.asarray(Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB"), float)


def settled(driver, seconds=30.0):
    """The page's picture once two in a row are alike."""
    before, start = picture(driver), time.monotonic()
    while time.monotonic() - start < seconds:
        time.sleep(1.0)
        now = picture(driver)
        if np.mean(np.abs(now - before)) < 0.05:
            return now
        before = now
    return before


def look_at_words(driver, out):
    """Each tab's words, and a picture of each beside `out`."""
    for tab, words in TABS.items():
        driver.find_element(By.XPATH, f"//*[text()='{tab}']").click()
        settled(driver)
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_{tab.lower()}")))
        text = driver.find_element(By.TAG_NAME, "body").text
        for word in ("p6r in cucumber_row", "Clear:", "what collides", *words):
            assert word in text, f"the page lacks '{word}' in {tab}"
    driver.find_element(By.XPATH, "//*[text()='Robot']").click()


def drag(driver, across, up):
    """Drags the target by the middle of its pink square."""
    shot = picture(driver)
    rows, columns = np.nonzero(np.all(np.abs(shot[:, :1000] - PINK) < 40.0, axis=2))
    assert len(rows), "the target is not seen"
    page = driver.find_element(By.TAG_NAME, "canvas")
    place = int(np.median(columns)) - page.size["width"] // 2, int(np.median(rows)) - page.size["height"] // 2
    hold = ActionChains(driver).move_to_element_with_offset(page, *place).pause(0.5).click_and_hold().pause(0.5)
    hold.move_by_offset(across // 2, -up // 2).pause(0.5).move_by_offset(across // 2, -up // 2).pause(0.5).release().perform()


COUNT = """window.got = []; const Plain = window.Worker;
window.Worker = class extends Plain { constructor(...given) {
  super(...given); this.addEventListener("message", () => window.got.push(performance.now())) } };"""

PAD = "navigator.getGamepads = () => window.sticks ? [null, {axes: window.sticks}] : [null];"


def push_sticks(driver, page):
    """A game pad of the browser moves the tip: along x until the stick is in its middle; not when the pad has gone."""
    place = lambda: frames(page.chain, page.q)[-1][:3, 3]
    page.move(np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1]))
    time.sleep(1.0)
    start = place()
    for last, least in (("[0, 0.05, 0, 0]", 0.03), ("null", 0.0)):
        driver.execute_script("window.sticks = [-1, 0, 0, 0]")
        time.sleep(1.5)
        driver.execute_script(f"window.sticks = {last}")
        time.sleep(1.5)
        rest = place()
        time.sleep(0.5)
        print(f"pushed by a stick: {np.round(1e3 * (rest - start))} mm")
        assert start[0] - rest[0] > least and np.abs(place() - rest).max() < 0.005, "the tip does not follow the stick"


def tips(page, rows, ended):
    """Where the target and the tip are, a hundred times a second while the target is dragged."""
    while not ended.wait(0.01):
        if page.steering.device.dragged:
            rows.append((*page.gizmo.position, *frames(page.chain, page.q)[-1][:3, 3]))


def steer(out):
    """Drags the tip by the arrow along x: the arm follows, is recorded, and the recording is played and saved."""
    page = Page(jaxik.load("p6r"), port=8092, teleop=True)
    driver, rows, ended = browser(), [], threading.Event()
    try:
        driver.set_window_size(900, 600)
        driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": COUNT + PAD})
        driver.get(page.url)
        settled(driver)
        page.move(np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1]))
        time.sleep(1.0)
        tip = frames(page.chain, page.q)[-1][:3, 3]
        for client in page.server.get_clients().values():
            client.camera.position = tuple(tip + np.array([0.0, -0.9, 0.25]))  # which shifts what it looks at
            client.camera.look_at = tuple(tip)
        first = settled(driver)
        canvas = driver.find_element(By.TAG_NAME, "canvas")
        high, wide = canvas.size["height"], canvas.size["width"]
        found, columns = np.nonzero(np.all(np.abs(first[:high, : int(0.62 * wide)] - PINK) < 40.0, axis=2))
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_to_steer")))
        assert len(found), "the target is not seen"
        head = np.argmax(np.where(np.abs(found - high / 2) < 60, columns, 0))
        place = int(columns[head]) - wide // 2 - 6, int(found[head]) - high // 2
        driver.find_element(By.XPATH, "//*[text()='Steer']").click()
        time.sleep(1.0)
        driver.find_element(By.XPATH, "//*[text()='Record']").click()
        hold = ActionChains(driver, duration=50).move_to_element_with_offset(canvas, *place).pause(0.5).click_and_hold()
        for k in range(40):
            hold = hold.move_by_offset(2 if k < 20 else -1, 0)
        watching = threading.Thread(target=tips, args=(page, rows, ended))
        watching.start()
        driver.execute_script("window.got = []")
        hold.pause(1.0).release().perform()
        ended.set()
        watching.join()
        got = np.array(driver.execute_script("return window.got")) / 1e3
        seen = np.array(rows)
        assert len(seen), "nothing was dragged"
        apart, way = np.linalg.norm(seen[:, :3] - seen[:, 3:], axis=1), np.ptp(seen[:, 3:], axis=0).max()
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_steered")))
        gaps = np.diff(got)
        print(
            f"steered over {1e3 * way:.0f} mm, at most {1e3 * apart.max():.1f} mm behind, {1e3 * apart[-1]:.2f} mm at its end"
        )
        print(
            f"the browser got {1.0 / np.median(gaps):.0f} pictures a second, 95 % within {1e3 * np.percentile(gaps, 95):.0f} ms"
        )
        assert way > 0.02 and apart[-1] < 0.005, "the tip does not follow"
        driver.find_element(By.XPATH, "//*[text()='Stop']").click()
        settled(driver)
        with tempfile.TemporaryDirectory() as folder:
            page.steering.file.value = str(Path(folder) / "motion.json")
            driver.find_element(By.XPATH, "//*[text()='Save']").click()
            settled(driver)
            assert (Path(folder) / "motion.json").stat().st_size > 1000, page.steering.kept.content
        driver.find_element(By.XPATH, "//*[text()='Play the recording']").click()
        settled(driver)
        push_sticks(driver, page)
        text = driver.find_element(By.TAG_NAME, "body").text
        for words in ("Drag the arrows", "virtual springs", "game pad", "Hz", "samples", "near a joint's limit"):
            assert words in text, f"the page lacks '{words}'"
        severe = [e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]]
        assert not severe, severe
    finally:
        ended.set()
        driver.quit()
        page.close()


def main(out):
    scene = jaxik.load_scene("cucumber_row")
    chain = jaxik.load("p6r")
    with tempfile.TemporaryDirectory() as folder:
        done = jaxik.sweep(STUDY, Path(folder) / "view.zarr")
        picked = jaxik.harvest(chain, scene)
        plan = jaxik.harvesting.plan_harvest(picked, order="row", candidates=2)
        page = Page(chain, scene, done.path, picked, port=8091, plan=plan)
        driver = browser()
        try:
            driver.get(page.url)
            time.sleep(5.0)
            first = settled(driver)
            driver.save_screenshot(str(out))
            assert first.std() > 10.0, "the page is empty"
            look_at_words(driver, out)
            views = {"as it opens": settled(driver)}
            page.player.show(plan.rows[0].stages[2].end)
            views["with a fruit"] = settled(driver)
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_with_a_fruit")))
            page.player.show(0.0)
            page.map.visible.value = False
            views["without the map"] = settled(driver)
            page.move(np.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1]))
            views["in a fruit"] = settled(driver)
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_collision")))
            assert "Collides: gripper and fruit_2, by 9.0 mm" in driver.find_element(By.TAG_NAME, "body").text
            page.move(np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1]))
            settled(driver)
            before = page.q
            drag(driver, 30, 20)
            views["dragged"] = settled(driver)
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_dragged")))
            assert not np.array_equal(page.q, before) or "No posture" in page.said.content, "the robot does not follow"
            print("dragged:", page.said.content)
            page.robot.style.value = SHOWS[1]
            views["its volumes"] = settled(driver)
            page.robot.style.value = SHOWS[3]
            views["joints alone"] = settled(driver)
            page.map.visible.value, page.map.variant.value = True, list(page.map.indices)[1]
            assert np.isclose(page.chain.world_T_base[2, 3] - chain.world_T_base[2, 3], 0.25), "the robot stands elsewhere"
            views["from a higher base"] = settled(driver)
            page.map.rest.value = "faint"
            views["what is not reachable, too"] = settled(driver)
            for a, b in itertools.pairwise(views):
                change = np.mean(np.abs(views[a] - views[b]) > 20.0)
                print(f"{a} -> {b}: {change:.2%} of the pixels")
                assert change > 0.0005, f"{b}: nothing changed"
            driver.set_window_size(420, 900)
            settled(driver)
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_narrow")))
            assert "p6r in cucumber_row" in driver.find_element(By.TAG_NAME, "body").text
            errors = [
                e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]
            ]
            assert not errors, errors
        finally:
            driver.quit()
            page.close()
    steer(out)
    print("2 passed, 0 failed")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
