"""The search for settings in a thread, with messages about its progress."""

from collections.abc import Callable, Mapping
from typing import Any

from mpsim.core.errors import MpsimError
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.studies.tune import tune
from mpsim.viewer.background import Background, Check

SECONDS = 60.0
"""Time that a search may take, about."""


class Tuning:
    """One search at a time.

    Args:
        news: called when there is something new to tell, from the thread of the search.
        finished: called with the number of the search and the settings that it has found, likewise.

    Attributes:
        number: that of the search that counts: an answer with another one comes too late.

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
        """What pages are told, as `wire.text_of` takes it.

        phase: "none", "searching", "found" or "failed". text: what is done now, the answer, or why there is none.
        """
        return dict(self._told)

    def start(self, scene: Scene, budgets: Mapping[str, float]) -> None:
        """Start a search; one that is under way is given up. budgets: as of `mpsim.tune`."""
        self.stop()
        self._told = {"phase": "searching", "text": "preliminary run", "done": 0, "of": 1}
        number = self.number
        self._work.start(lambda check: self._search(scene, budgets, check, number))

    def stop(self) -> None:
        """Give a search up, at the next moment at which it reports its progress."""
        self.number += 1
        self._work.stop()
        self._told = {**self._told, "phase": "none"}

    def _search(self, scene: Scene, budgets: Mapping[str, float], check: Check, number: int) -> None:
        def progress(done: int, of: int, what: str) -> None:
            check()
            self._tell(phase="searching", text=what, done=done, of=of)

        try:
            found = tune(scene, budgets, seconds=SECONDS, progress=progress)
        except Exception as error:  # whatever it is, the stages wait no longer
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
