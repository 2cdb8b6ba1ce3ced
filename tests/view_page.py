"""The page of `jaxik view` in a real browser, headless: `python tests/view_page.py SCREENSHOT.png` (needs Chromium, selenium).

It is no test of pytest's, because a browser is no Python package; CI runs it. A sweep is made, the page opened, the joints, the
target, the map and a fruit's posture changed by its controls; the pictures must differ by what was changed, the words be there,
also on a narrow screen, and the console be clean. The narrow screen's picture lies beside the first.
"""

import io
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from PIL import Image
from robot_files import ARM, write
from selenium import webdriver
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

import jaxik
from jaxik.view import Page
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
BUSY = 6.0  # [s] the longest to wait for a picture of a loop that goes on, which need not come to rest
CHANGE = 0.0005  # of the pixels, by which pictures differ that show something else
TABS = {
    "Robot": ("volumes kept clear", "target to drag", "slide [m]", "theta2 [deg]"),
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
    options.add_argument("--window-size=1200,800")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))


def picture(driver, patience=3):
    """Asked for again while the browser is too busy to draw it."""
    try:
        shot = driver.get_screenshot_as_png()
    except TimeoutException:
        if not patience:
            raise
        return picture(driver, patience - 1)
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), float)


def until(condition, seconds=30.0):
    """Waits until it holds; whether it does by then."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > seconds:
            return False
        time.sleep(0.1)
    return True


def changed(before, now):
    """The share of the pixels that differ."""
    return np.mean(np.abs(now - before) > 20.0)


def settled(driver, before=None, pause=0.4, seconds=30.0):
    """The page's picture once two in a row are alike, but for the words at its right, which tell rates, and once it is another
    than `before`."""
    last = picture(driver)
    left = slice(int(0.6 * last.shape[1]))

    def still():
        nonlocal last
        time.sleep(pause)
        now, then = picture(driver), last
        last = now
        return np.mean(np.abs(now - then)[:, left]) < 0.05 and (before is None or changed(before, now) > CHANGE)

    until(still, seconds)
    return last


def read(driver, *words):
    """Asserts that the page says so, sooner or later."""
    body = lambda: driver.find_element(By.TAG_NAME, "body").text
    until(lambda: all(word in body() for word in words))
    for word in words:
        assert word in body(), f"the page lacks '{word}'"


def look_at_words(driver, out):
    """Each tab's words, and a picture of each beside `out`."""
    for tab, words in TABS.items():
        driver.find_element(By.XPATH, f"//*[text()='{tab}']").click()
        read(driver, "p6r in cucumber_row", "Clear:", "what collides", *words)
        settled(driver)
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_{tab.lower()}")))
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
    place = lambda: frames(page.robot, page.q)[-1][:3, 3]
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
            rows.append((*page.gizmo.position, *frames(page.robot, page.q)[-1][:3, 3]))


def steer(out):
    """Drags the tip by the arrow along x: the arm follows, is recorded, and the recording is played and saved."""
    page = Page(jaxik.load("p6r"), port=8092, teleop=True)
    driver, rows, ended = browser(), [], threading.Event()
    try:
        driver.set_window_size(900, 600)
        driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": COUNT + PAD})
        driver.get(page.url)
        read(driver, "Steer")
        page.move(np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1]))
        time.sleep(1.0)
        tip = frames(page.robot, page.q)[-1][:3, 3]
        for client in page.server.get_clients().values():
            client.camera.position = tuple(tip + np.array([0.0, -0.9, 0.25]))  # which shifts what it looks at
            client.camera.look_at = tuple(tip)
        first = settled(driver, pause=1.0, seconds=BUSY)
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
        settled(driver, seconds=BUSY)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "motion.json"
            page.steering.file.value = str(file)
            driver.find_element(By.XPATH, "//*[text()='Save']").click()
            assert until(lambda: file.exists() and file.stat().st_size > 1000), page.steering.kept.content
        driver.find_element(By.XPATH, "//*[text()='Play the recording']").click()
        assert until(lambda: page.steering.playing, 10.0) and until(lambda: not page.steering.playing), "it is not played"
        push_sticks(driver, page)
        read(driver, "Drag the arrows", "virtual springs", "game pad", "Hz", "samples", "near a joint's limit")
        severe = [e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]]
        assert not severe, severe
    finally:
        ended.set()
        driver.quit()
        page.close()


def choose_a_pair(out):
    """A model beside its meshes: a row of the list of pairs that are not checked colours its two links, and none again."""
    with tempfile.TemporaryDirectory() as folder:
        file = write(Path(folder), "arm.urdf", ARM)
        page = Page(jaxik.load(file, meshes=True), port=8093, meshes=jaxik.files.link_meshes(file))
    driver = browser()
    try:
        driver.get(page.url)
        read(driver, "volumes kept clear", "2 pairs of links are not checked")
        driver.find_element(By.XPATH, "//*[contains(text(),'pairs of links are not checked')]").click()
        read(driver, "never touch (2)")
        first = settled(driver, pause=1.0)
        row = driver.find_element(By.CSS_SELECTOR, "[data-pair='1']")
        row.click()
        assert until(lambda: page.drawing.chosen == set(page.unchecked.rows[1].links)), "the row is not chosen"
        print(f"a pair: {(change := changed(first, settled(driver, first))):.2%} of the pixels")
        assert change > CHANGE, "a pair that is chosen is not seen"
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_pair")))
        row.click()
        assert until(lambda: not page.drawing.chosen), "the row stays chosen"
        severe = [e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]]
        assert not severe, severe
    finally:
        driver.quit()
        page.close()


def main(out):
    scene = jaxik.load_scene("cucumber_row")
    robot = jaxik.load("p6r")
    with tempfile.TemporaryDirectory() as folder:
        done = jaxik.sweep(STUDY, Path(folder) / "view.zarr")
        picked = jaxik.harvest(robot, scene, margin=0.005)
        plan = jaxik.harvesting.plan_harvest(picked, order="row", candidates=2, margin=0.002)
        page = Page(robot, scene=scene, store=done.path, harvest=picked, port=8091, plan=plan)
        driver = browser()
        try:
            driver.get(page.url)
            read(driver, "p6r in cucumber_row")
            first = settled(driver, pause=1.0)
            driver.save_screenshot(str(out))
            assert first.std() > 10.0, "the page is empty"
            look_at_words(driver, out)
            views = [settled(driver)]

            def look(name):
                """The next picture, once it is another than the last."""
                views.append(settled(driver, views[-1]))
                print(f"{name}: {(change := changed(*views[-2:])):.2%} of the pixels")
                assert change > CHANGE, f"{name}: nothing changed"

            page.player.show(plan[0].stages[2].end)
            look("with a fruit")
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_with_a_fruit")))
            page.player.show(0.0)
            page.map.visible.value = False
            look("without the map")
            page.move(np.array([0.3, 0.2, -0.5, -0.4, 0.3, 0.5, 0.1]))
            look("in a fruit")
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_collision")))
            read(driver, "Collides: gripper and fruit_2, by 9.0 mm")
            page.move(np.array([0.5, 0.1, 0.1, -0.9, 0.2, 0.6, 0.1]))
            look("out of it")
            before = page.q
            drag(driver, 30, 20)
            look("dragged")
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_dragged")))
            assert not np.array_equal(page.q, before) or "No posture" in page.said.content, "the robot does not follow"
            print("dragged:", page.said.content)
            page.drawing.volumes.value = True
            look("its volumes, too")
            page.drawing.shape.value = page.drawing.volumes.value = False
            look("joints alone")
            page.map.visible.value, page.map.variant.value = True, list(page.map.indices)[1]
            assert np.isclose(page.robot.world_T_base[2, 3] - robot.world_T_base[2, 3], 0.25), "the robot stands elsewhere"
            look("from a higher base")
            page.map.rest.value = "faint"
            look("what is not reachable, too")
            driver.set_window_size(420, 900)
            settled(driver)
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_narrow")))
            read(driver, "p6r in cucumber_row")
            errors = [
                e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]
            ]
            assert not errors, errors
        finally:
            driver.quit()
            page.close()
    choose_a_pair(out)
    steer(out)
    print("3 passed, 0 failed")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
