"""The page of `jaxik view` in a real browser, headless: `python tests/view_page.py SCREENSHOT.png` (needs Chromium, selenium).

It is no test of pytest's, because a browser is no Python package; CI runs it. A sweep is made, the page opened, the joints, the
map and a fruit's posture changed by its controls; the pictures must differ by what was changed, and the console be clean.
"""

import io
import itertools
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

import jaxik
from jaxik.view.page import Page

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


def main(out):
    scene = jaxik.load_scene("cucumber_row")
    chain = jaxik.load("p6r")
    with tempfile.TemporaryDirectory() as folder:
        done = jaxik.sweep(STUDY, Path(folder) / "view.zarr")
        picked = jaxik.harvest(chain, scene, angles=12, slides=11)
        page = Page(chain, scene, done.path, picked, port=8091)
        driver = browser()
        try:
            driver.get(page.url)
            time.sleep(5.0)
            first = settled(driver)
            driver.save_screenshot(out)
            assert first.std() > 10.0, "the page is empty"
            views = {"as it opens": first}
            page.map.visible.value = False
            page.map.draw()
            views["without the map"] = settled(driver)
            page.move(np.array([0.9, 0.5, -0.9, -0.2, 0.3, 0.5, 0.1]))
            views["another posture"] = settled(driver)
            page.volumes.value = False
            page._robot()
            views["bones alone"] = settled(driver)
            page.map.visible.value, page.map.variant.value = True, list(page.map.indices)[1]
            page.map.stand()
            page.map.draw()
            assert np.isclose(page.chain.world_T_base[2, 3] - chain.world_T_base[2, 3], 0.25), "the robot stands elsewhere"
            views["from a higher base"] = settled(driver)
            names = list(views)
            for a, b in itertools.pairwise(names):
                change = np.mean(np.abs(views[a] - views[b]) > 20.0)
                print(f"{a} -> {b}: {change:.2%} of the pixels")
                assert change > 0.0005, f"{b}: nothing changed"
            words = driver.find_element("tag name", "body").text
            for word in ("p6r", "slide [m]", "theta2 [deg]", "share reachable", "fruits"):
                assert word in words, f"the page lacks '{word}'"
            errors = [
                e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]
            ]
            assert not errors, errors
        finally:
            driver.quit()
            page.close()
    print("1 passed, 0 failed")


if __name__ == "__main__":
    main(sys.argv[1])
