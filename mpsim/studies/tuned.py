"""The result of a search for settings: each candidate with its verdict, and the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mpsim.core.views import view
from mpsim.scene.settings import Settings
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import Deviation
from mpsim.studies.tradeoff import Row, label

NO_DEARER = 1.05
"""Ratio of costs below which one is no more than the other in words."""


@dataclass(frozen=True)
class Trial:
    """One candidate of the search.

    Attributes:
        row: its settings, cost and errors.
        verdict: "inside all budgets", or the budget that it exceeds and by how much.
        inside: whether all budgets are met, standard errors included.
        warning: what mpsim warns of with these settings, if they are inside; or "".
    """

    row: Row
    verdict: str
    inside: bool
    warning: str = ""


@dataclass(frozen=True)
class Tuned:
    """The answer of `tune`.

    Attributes:
        settings: the cheapest settings found whose errors are within all budgets.
        cost: their cost.
        errors: their errors, from runs that were not used in the search.
        budgets: as given.
        reference: of the errors, in words.
        starts: of the runs, in words.
        until: length of the runs [time].
        warning: the warning that mpsim raises when these settings are used on the scene; "" where others are inside
            all budgets without one.
        tried: every candidate of the search with its verdict, cheapest first.
        tighter: estimated cost for half of every budget, from the fitted order, over the cost of these settings [1].
        contact_time: that was given for the reference, which makes it a model, not exact [time]; None if none was
            given.
    """

    settings: Settings
    cost: Cost
    errors: dict[str, Deviation]
    budgets: dict[str, float]
    reference: str
    tried: tuple[Trial, ...]
    tighter: float
    starts: str = ""
    until: float = math.nan
    warning: str = ""
    contact_time: float | None = None

    @property
    def exact(self) -> bool:
        """Whether these settings are the exact solver, so that their errors are 0 by definition."""
        return self._is_reference and self.contact_time is None

    @property
    def verified(self) -> bool:
        """Whether each error was within its budget in new, independent runs."""
        return not self._is_reference and all(error.inside(self.budgets[name]) for name, error in self.errors.items())

    @property
    def _is_reference(self) -> bool:
        """Whether these settings are the reference itself, exact or a model."""
        return all(error.exact for error in self.errors.values())

    def _repr_html_(self) -> str:
        return view("tuned_html", self)

    def __str__(self) -> str:
        lines = [f"{label(self.settings)}: {self.cost.median:.3g} ns per disc and unit of time ({self.cost.method})"]
        for name, budget in self.budgets.items():
            error = self.errors[name]
            of_reference = "exact" if self.contact_time is None else "which is a model, not exact"
            claim = of_reference if error.exact else "verified with new runs"
            lines.append(f"  {name}: {error!r}, budget {budget:g} ({claim}{_where(error, self.until)})")
        cheaper = [
            each for each in self.tried if (each.warning or not each.inside) and each.row.settings != self.settings
        ]
        cheaper = [each for each in cheaper if each.row.cost and each.row.cost.median < self.cost.median]
        lines += ["cheaper, but not chosen:"] if cheaper else ["nothing cheaper was found"]
        for each in cheaper:
            assert each.row.cost is not None
            lines.append(f"  {each.row.label}, {each.row.cost.median:.3g} ns: {each.verdict}")
        lines += [f"  {each.row.label} failed: {each.row.failure}" for each in self.tried if each.row.cost is None]
        dearer = f"about {self.tighter:.2g} times as much" if self.tighter >= NO_DEARER else "no more"
        lines.append(f"halving all error budgets would cost {dearer}")
        lines.append(f"errors against {self.reference}; averages over {self.starts}, runs of {self.until:.3g}")
        if self.warning:
            lines.append(f"with these settings mpsim warns: {self.warning} The errors above include it.")
        return "\n".join(lines)


def _where(error: Deviation, until: float) -> str:
    """The time span of an error, in words."""
    if error.exact:
        return ""
    if error.largest is None and error.span == (0.0, 1.0):
        return ""
    first, end = (fraction * until for fraction in error.span)
    if error.largest is None:
        return f"; where nothing changes with time, {first:.3g} to {end:.3g}"
    later = "" if error.steady is None else f"; nothing changes with time from {error.steady * until:.3g} on"
    return f"; mean over windows, {first:.3g} to {end:.3g}{later}"
