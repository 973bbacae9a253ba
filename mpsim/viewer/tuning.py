"""Searches for settings in a thread, and reports its progress."""

from collections.abc import Callable, Mapping
from typing import Any

from mpsim.errors import MpsimError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.tune import tune
from mpsim.viewer.background import Background, Check

SECONDS = 60.0
"""Approximate time limit of a search [s]."""


class Tuning:
    """Runs one search at a time.

    Args:
        news: called when there is new progress to report.
        finished: called with the number of the search and the settings that it has found. The thread of the search
            calls both.

    Attributes:
        number: number of the present search. A result with another number is out of date.

    >>> tuning = Tuning(news=lambda: None, finished=print)
    >>> tuning.told()["phase"]
    'none'
    """

    def __init__(self, news: Callable[[], None], finished: Callable[[int, Settings], None]):
        self._news, self._finished = news, finished
        self.number: int = 0
        self._work = Background("mpsim view: tune")
        self._told: dict[str, Any] = {"phase": "none", "text": "", "done": 0, "of": 1}

    @property
    def running(self) -> bool:
        """Whether a search is under way."""
        return self._told["phase"] == "searching"

    def told(self) -> dict[str, Any]:
        """The message for pages, for `wire.text_of`.

        phase: "none", "searching", "found" or "failed". text: the present step, the result, or why there is none.
        """
        return dict(self._told)

    def start(self, scene: Scene, budgets: Mapping[str, float]) -> None:
        """Start a search and cancel a running one; budgets: as in `mpsim.tune`."""
        self.stop()
        self._told = {"phase": "searching", "text": "preliminary run", "done": 0, "of": 1}
        number = self.number
        self._work.start(lambda check: self._search(scene, budgets, check, number))

    def stop(self) -> None:
        """Cancel the search; it ends when it next reports its progress."""
        self.number += 1
        self._work.stop()
        self._told = {**self._told, "phase": "none"}

    def _search(self, scene: Scene, budgets: Mapping[str, float], check: Check, number: int) -> None:
        def progress(done: int, of: int, what: str) -> None:
            check()
            self._tell(phase="searching", text=what, done=done, of=of)

        try:
            found = tune(scene, budgets, seconds=SECONDS, progress=progress)
        except Exception as error:  # any error: the stages must not wait any longer
            check()
            self._tell(phase="failed", text=str(error) or type(error).__name__)
            if isinstance(error, MpsimError):
                return
            raise
        check()
        self._tell(phase="found", text=str(found))
        self._finished(number, found.settings)

    def _tell(self, **values: Any) -> None:
        self._told = {**self._told, **values}
        self._news()
