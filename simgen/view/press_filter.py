"""Filters of the presses that a dataset's page walks through."""

from collections.abc import Callable

import numpy as np
from nicegui import ui

from simgen.dataset.splits import SPLITS
from simgen.view.press_table import STATUSES, Filter, PressTable


class PressFilter:
    """Fields to filter presses by.

    on_change : is called with the numbers (n,) of the presses that match
    """

    def __init__(self, table: PressTable, on_change: Callable[[np.ndarray], None]):
        self._table, self._on_change = table, on_change
        with ui.expansion("Filter", icon="filter_alt").props("dense").classes("filter").style("width: 100%"):
            with ui.element("div").classes("row-line"):
                self._indenter = self._select("indenter", table.indenters)
                self._split = self._select("split", SPLITS)
                self._status = self._select("status", STATUSES)
                self._depth = self._number("reaches at least, mm")
                self._error = self._number("estimated error at most, um") if table.has_estimates else None
            self._found = ui.label().classes("small")

    def _select(self, label: str, names) -> ui.select:
        options = {None: "all", **{name: name for name in names}}
        chosen = ui.select(options, value=None, label=label, on_change=self._changed)
        return chosen.props("dense outlined").style("min-width: 150px")

    def _number(self, label: str) -> ui.number:
        return ui.number(label, min=0, on_change=self._changed).props("dense outlined clearable").style("width: 210px")

    def _changed(self) -> None:
        error = None if self._error is None else self._error.value
        chosen = Filter(self._indenter.value, self._split.value, self._status.value, error, self._depth.value)
        found = self._table.matching(chosen)
        self._found.text = f"{len(found):,} of {len(self._table):,} presses match"
        self._on_change(found)
