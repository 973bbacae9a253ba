"""A page of a view in a real browser, under the hands of somebody: pointer, fingers, keys, and what is seen."""

import contextlib
import io
import time

import numpy as np
from PIL import Image

import mpsim
from support.browser import until as until_it_happens

WHITE = [255, 255, 255]
"""The ground below the discs."""


def until(holds):
    """What a function gives once that is true; a simulation that undo has just replaced is asked again."""

    def asked():
        with contextlib.suppress(mpsim.errors.ClosedError):
            return holds()
        return None

    return until_it_happens(asked)


class Table:
    """A page of a view, under the hands of somebody."""

    def __init__(self, opened, view, query="", size=(1280, 800), **options):
        self.view, self.complaints = view, []
        self.context = opened.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        self.page = self.context.new_page()
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda each: each.type == "error" and self.complaints.append(each.text))
        self.page.goto(view.address + query)
        until(lambda: self.text("phase") in ("paused", "playing") and self.page.get_attribute("#stage", "data-frame"))

    @property
    def sim(self):
        return self.view._session._sim

    def text(self, name):
        return self.page.inner_text(f"#{name}")

    def pixel(self, x, y):
        """Where a place of the box is on the screen."""
        box = self.page.locator("#discs-canvas").bounding_box()
        scene = self.sim.scene
        scale = 0.96 * min(box["width"] / scene.width, box["height"] / scene.height)
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        return middle[0] + (x - scene.width / 2) * scale, middle[1] - (y - scene.height / 2) * scale

    def drag(self, start, end, steps=6, pause=0.15):
        """Press at a place, go to another one, stay there for some time, and let go."""
        mouse = self.page.mouse
        mouse.move(*self.pixel(*start))
        mouse.down()
        mouse.move(*self.pixel(*end), steps=steps)
        time.sleep(pause)
        mouse.up()

    def gesture(self, *places, apart=0.02, rest=0.01, finger=False):
        """Press at the first of some places, go to the others, and let go. The times of the events [s] are those given,
        however busy the machine is: between two places, and from the last one to letting go."""
        session, begun, last = self.context.new_cdp_session(self.page), time.time(), len(places) - 1
        names = ("touchStart", "touchMove", "touchEnd") if finger else ("mousePressed", "mouseMoved", "mouseReleased")
        for k, kind in enumerate([names[0], *[names[1]] * last, names[2]]):
            x, y = self.pixel(*places[min(k, last)])
            event = {"type": kind, "timestamp": begun + apart * min(k, last) + rest * (k > last)}
            if finger:
                points = [] if k > last else [{"x": x, "y": y}]
                session.send("Input.dispatchTouchEvent", {**event, "touchPoints": points})
            else:
                button = {"button": "left", "buttons": 1, "clickCount": 1}
                session.send("Input.dispatchMouseEvent", {**event, **button, "x": x, "y": y})
        session.detach()

    def settle(self):
        """Wait until the page shows the discs where they are: it acts on the discs that are seen."""
        places = "import('./common.js').then(({state}) => [...state.picture.places])"

        def settled():
            size, here = (self.sim.scene.width, self.sim.scene.height), self.sim.state.present
            found = np.reshape(self.page.evaluate(places), (-1, 2)) / 65535 * size
            return len(found) == self.sim.count and np.allclose(found[here], self.sim.state.position[here], atol=0.01)

        until(settled)

    def seen(self, x, y):
        """Colour of the screen at a place of the box."""
        picture = np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"), int)
        x, y = self.pixel(x, y)
        return picture[int(y), int(x)].tolist()

    def disc(self, number):
        return self.sim.state.position[number]

    def holding(self):
        return next(iter(self.view._session._hands._held.values()), None)

    def what(self):
        return [change.what for change in self.sim.journal]

    def keys(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def download(self, button):
        self.show("keep")
        with self.page.expect_download() as waiting:
            self.page.click(f"#{button}")
        path = waiting.value.path()
        with open(path, "rb") as file:
            return waiting.value.suggested_filename, file.read()

    def box(self, name):
        """Where something is on the screen, after scrolling to it."""
        found = self.page.locator(f"#{name}")
        found.scroll_into_view_if_needed()
        return found.bounding_box()

    def show(self, panel):
        if self.page.get_attribute(f"#{panel}", "open") is None:
            self.page.click(f"#{panel} summary")
