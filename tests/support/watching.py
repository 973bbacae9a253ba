"""The session of a view without a server: an audience that keeps what it is shown, and actions on the session."""

import json
import threading
import time

from mpsim.viewer import wire

PATIENCE = 150.0


class Watcher:
    """An audience that keeps what it is shown."""

    def __init__(self):
        self.pictures, self.told = [], {}
        self.news = threading.Condition()

    def show(self, picture):
        with self.news:
            self.pictures.append(picture)
            self.news.notify()

    def tell(self, kind, text):
        with self.news:
            self.told[kind] = json.loads(text)
            self.news.notify()

    def wait(self, holds):
        with self.news:
            assert self.news.wait_for(lambda: holds(self), PATIENCE), (len(self.pictures), self.told)

    def see(self, session, holds):
        """Ask for pictures until something holds."""
        end = time.monotonic() + PATIENCE
        while not holds(self):
            assert time.monotonic() < end, (len(self.pictures), self.told, session.error)
            session.ask()
            time.sleep(0.005)

    @property
    def phase(self):
        return self.told.get("status", {}).get("phase")

    @property
    def frame(self):
        return wire.unpack(self.pictures[-1].packed).header.frame if self.pictures else -1


def do(session, name, **values):
    session.submit(wire.Action(name, values))


def step_to(session, watcher, frame):
    """Run to a frame and no further."""
    watcher.wait(lambda w: w.phase in ("playing", "paused"))
    do(session, "step", frames=frame - session._sim.frame)
    while session._sim.frame < frame:
        assert session.error is None
        session.ask()
        time.sleep(0.002)
