"""A list of the fruits on the page: choosing one shows its posture, or what is in its way."""

from __future__ import annotations

from typing import Any

from jaxik.harvesting.driver import HarvestResult
from jaxik.view.harvest_picture import fate, posture
from jaxik.view.palette import marked
from jaxik.view.stage import Stage


class FruitList:
    """The controls of the list. The first fruit that can be picked is shown."""

    def __init__(self, page: Stage, harvest: HarvestResult):
        gui, solved = page.server.gui, int(harvest.success.sum())
        self.page, self.rows = page, {f"{'✓' if row.success else '✗'} {row.fruit}": row for row in harvest}
        gui.add_markdown(f"**{page.robot.name} can pick {solved} of the {len(self.rows)} fruits.** Choose one:")
        self.chosen, self.said = gui.add_dropdown("fruit", list(self.rows)), gui.add_html("")
        self.chosen.on_update(lambda _: self.show())
        self.chosen.value = next((k for k, row in self.rows.items() if row.success), next(iter(self.rows)))
        self.show()

    def show(self) -> None:
        """The one that is chosen."""
        row: Any = self.rows[self.chosen.value]
        q, words = posture(row), "the best posture stays" if row.success else "no posture:"
        more = " of all but the fruit itself." if row.success else "." if q is None else ". Shown is what that would open."
        self.said.content = marked(row.success, row.fruit, f": {words} {fate(row)}{more}")
        if q is not None:
            self.page.move(q)
