"""Chromium looks at a world that is sensed, and at a replanner's log: `python tests/live_page.py OUT.png`; needs what
`view_page.py` needs.

A log is written by a replanner, and played by the page: the robot moves, what appears is seen, and the event is told. Then a
cell with a cloud and a grid that a camera has seen: points, what was not seen, and a slice through a field. Pictures lie beside
OUT.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np
from selenium.webdriver.common.by import By
from view_page import CHANGE, browser, changed, picture, read, settled, until

import jaxik
from jaxik import sensing
from jaxik.cli.view import ViewArguments
from jaxik.replanning import load_log
from jaxik.view import Page

RATE, BALL = 30.0, ([0.55, 0.1, 0.35, 0.08],)
START, GOAL = (np.array([side * 0.8, 0.3, 0.0, -2.0, 0.0, 2.2, 0.8]) for side in (-1.0, 1.0))


def written(path):
    """The log of a Panda that goes around a ball, which appears while it moves."""
    scene = jaxik.make_scene(boxes=[[0.5, 0.0, -0.2, 1.0, 1.6, 0.1]]).with_room(spheres=16, boxes=16)
    replanner = jaxik.Replanner(jaxik.load("panda"), START, scene=scene, log=path, margin=0.01)
    replanner.go(GOAL)
    for number in range(150):
        scene = scene.with_("ball", spheres=BALL) if number == 8 else scene
        if replanner.update(number / RATE, scene).event == "arrived":
            return path
    raise AssertionError("the robot does not arrive")


def severe(driver):
    """The errors that the browser has told."""
    return [e["message"] for e in driver.get_log("browser") if e["level"] == "SEVERE" and "favicon" not in e["message"]]


def play(out, folder):
    """The log in the browser: words, the robot's way, what appears, and the end of the slider."""
    log = load_log(written(Path(folder) / "run.jsonl"))
    page = Page(log.robot, scene=log.scene, log=log, port=8094)
    driver = browser()
    try:
        driver.get(page.url)
        read(driver, "jaxik: panda", "Log")
        driver.find_element(By.XPATH, "//*[text()='Log']").click()
        read(driver, f"{len(log.records)} updates", "replanned: there is a new way to the goal")
        views = [settled(driver, pause=1.0)]
        assert views[0].std() > 10.0, "the page is empty"
        for name, t in (("before", 7.0 / RATE), ("appeared", 8.5 / RATE), ("amid", 0.6 * page.log.duration)):
            page.log.show(t)
            views.append(settled(driver, views[-1]))
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_{name}")))
            print(f"log, {name}: {(change := changed(*views[-2:])):.2%} of the pixels")
            assert change > CHANGE, f"{name}: nothing changed"
            if name == "appeared":
                assert "ball" in page.scene.object_names
                read(driver, "on the former way", "and ball are apart by")
        page.log.time.value = 0.0
        driver.find_element(By.XPATH, "//*[text()='Play']").click()
        assert until(page.log.playing.is_set, 10.0), "it is not played"
        first = picture(driver)
        assert until(lambda: not page.log.playing.is_set(), 60.0) and page.log.time.value == page.log.time.max
        read(driver, "arrived: the robot stands where it is to go")
        assert changed(first, settled(driver)) > CHANGE, "the robot does not move"
        np.testing.assert_allclose(page.q, GOAL, atol=1e-6)
        assert not severe(driver), severe(driver)
    finally:
        driver.quit()
        page.close()


def cell():
    """A cloud of a ball's points, and a grid of which half was seen, with a crate in it."""
    rng = np.random.default_rng(0)
    way = rng.normal(size=(20_000, 3))
    points = [0.5, -0.4, 0.5] + 0.15 * way / np.linalg.norm(way, axis=1)[:, None]
    grid = sensing.Occupancy.unseen_box([0.3, -0.1, 0.0], [1.1, 0.9, 0.8], spacing=0.02)
    state = np.zeros(grid.state.shape, np.uint8)
    state[:, :25] = 1
    state[5:15, 5:20, :15] = 2
    grid = dataclasses.replace(grid, state=state)
    return grid.in_scene(jaxik.make_scene().with_cloud(points.astype(np.float32), 0.005))


def look(out):
    """The sensed world: its legend, what was not seen on and off, and slices."""
    page = Page(jaxik.load("panda"), scene=cell(), port=8095)
    driver = browser()
    try:
        driver.get(page.url)
        read(driver, "points of clouds, surfaces of fields", "not seen", "what no camera has seen", "slice of a field")
        views = [settled(driver, pause=1.0)]
        driver.save_screenshot(str(out.with_stem(f"{out.stem}_sensed")))
        slices = page.surroundings, page.slices

        def next_view(name):
            views.append(settled(driver, views[-1]))
            driver.save_screenshot(str(out.with_stem(f"{out.stem}_{name}")))
            print(f"{name}: {(change := changed(*views[-2:])):.2%} of the pixels")
            assert change > CHANGE, f"{name}: nothing changed"

        slices[0].unseen.value = False
        next_view("seen_alone")
        slices[1].shown.value = True
        next_view("slice")
        read(driver, "Distances: what is inside of something in red")
        slices[1].field.value, slices[1].axis.value = "unseen", "x"
        next_view("slice_of_unseen")
        assert not severe(driver), severe(driver)
    finally:
        driver.quit()
        page.close()


def main(out):
    with tempfile.TemporaryDirectory() as folder:
        play(out, folder)
        try:
            ViewArguments(robot=str(Path(folder) / "none.jsonl")).run()
        except ValueError as error:
            print("no log:", error)
        else:
            raise AssertionError("a log that is not there is shown")
    look(out)
    print("2 passed, 0 failed")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
