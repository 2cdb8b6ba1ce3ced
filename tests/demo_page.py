"""The documentation's demo in a real browser: `PYTHONPATH=batch_eval python tests/demo_page.py SITE PICTURE.png`.

It needs Chromium and selenium. As `view_page.py`, it is called by CI, after the site is built. The target is moved by the
page's sliders; the posture that the page tells has the target's pose by Pinocchio, and the words are there where there is none.
"""

import functools
import http.server
import itertools
import sys
import threading
from pathlib import Path

import numpy as np
from robots import pinocchio
from selenium.webdriver.common.by import By
from view_page import browser, picture, read, until

import jaxik

POINTS = ((0.4, 0.2, 0.4), (-0.3, 0.5, 0.2), (0.1, -0.6, 0.5), (0.55, 0.4, 0.1))
TOLERANCE = 1e-6  # [m, 1] of the search's own 1e-4
MOVE = """for (const [k, value] of arguments[0].entries()) {
  const slider = document.querySelectorAll("#arm-demo input")[k];
  slider.value = value;
  slider.dispatchEvent(new Event("input"));
}"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    """The files of a folder, without a line a request."""

    def log_message(self, *_):
        pass


def served(folder):
    """A server of the folder on a free port."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def answer(driver, point):
    """The posture that the page tells for a point, or its words."""
    driver.execute_script(MOVE, list(point))
    place = driver.find_element(By.ID, "arm-demo")
    told = place.get_attribute("data-posture")
    return np.array(told.split(), float) if told else place.find_element(By.TAG_NAME, "p").text


def main(site, out):
    pose, server, driver = pinocchio(jaxik.load("ur5e")), served(site), browser()
    try:
        driver.get(f"http://127.0.0.1:{server.server_port}/how-to/export/")
        read(driver, "Out of Python", "its inverse kinematics runs on this page")
        place = driver.find_element(By.ID, "arm-demo")
        assert until(lambda: place.find_elements(By.TAG_NAME, "canvas")), place.text
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", place)
        pictures = []
        for point in POINTS:
            q = answer(driver, point)
            assert not isinstance(q, str), (point, q)
            away = pose(q)
            assert np.abs(away[:3, 3] - point).max() < TOLERANCE, (point, away)
            assert np.abs(away[:3, :3] - np.diag([1.0, -1.0, -1.0])).max() < TOLERANCE, (point, away)
            pictures.append(picture(driver))
        driver.save_screenshot(str(out))
        shares = [np.mean(np.abs(a - b) > 20.0) for a, b in itertools.pairwise(pictures)]
        assert min(shares) > 1e-3, f"the arm is not drawn anew: {shares}"
        print(f"{len(POINTS)} targets met; {place.find_element(By.TAG_NAME, 'p').text}")
        assert answer(driver, (0.8, 0.8, 0.9)).startswith("out of reach")
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_out_of_reach")))
        print(f"at the base: {answer(driver, (0.0, 0.0, 0.1))}")
        severe = [e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]]
        assert not severe, severe
    finally:
        driver.quit()
        server.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
