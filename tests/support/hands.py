"""A page of a view in a real browser, under the hands of somebody: pointer, fingers, keys, and what is seen."""

import base64
import io
import time

import numpy as np
from PIL import Image

from support.browser import until
from support.visitor import Visitor, kept

WHITE = [255, 255, 255]
"""The ground below the discs."""


class Table:
    """A page of a view. Attributes: page (of Playwright), watch (another page, without a browser), complaints."""

    def __init__(self, opened, view, query="", size=(1280, 800), **options):
        self.view, self.complaints = view, []
        self.watch = Visitor(view.address)
        self.context = opened.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        self.page = self.context.new_page()
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda each: each.type == "error" and self.complaints.append(each.text))
        self.page.goto(view.address + query)
        until(lambda: self.text("phase") in ("paused", "playing") and self.page.get_attribute("#stage", "data-frame"))
        self.watch.say("visible", value=True)
        until(lambda: self.picture is not None and "scene" in self.watch.last)

    def close(self):
        self.context.close()
        self.watch.__exit__(None, None, None)

    # --- what the view says of itself

    def last(self, kind):
        """The last message of a kind to another page."""
        self.watch.hear_for(0.02)
        return self.watch.last.get(kind, {})

    @property
    def picture(self):
        self.watch.hear_for(0.02)
        return self.watch.picture

    @property
    def present(self):
        return self.picture.colour != 255

    def disc(self, number):
        return self.picture.position[number]

    def holding(self):
        return self.last("hands")["held"]

    def values(self):
        self.watch.hear_for(0.02)
        return self.watch.values

    def what(self):
        return kept(self.view.address).changes

    # --- what is seen

    def text(self, name):
        return self.page.inner_text(f"#{name}")

    @property
    def frame(self):
        return int(self.page.get_attribute("#stage", "data-frame") or -1)

    def canvas(self, name="discs-canvas"):
        """What is drawn there, without what lies below it: shape (height, width, 4)."""
        url = self.page.evaluate(f"document.getElementById('{name}').toDataURL()")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGBA"))

    def seen(self, x, y):
        """Colour of the screen at a place of the box."""
        picture = np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"), int)
        x, y = self.pixel(x, y)
        return picture[int(y), int(x)].tolist()

    def pixel(self, x, y):
        """Where a place of the box is on the screen."""
        box, scene = self.page.locator("#discs-canvas").bounding_box(), self.watch.last["scene"]
        scale = 0.96 * min(box["width"] / scene["width"], box["height"] / scene["height"])
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        return middle[0] + (x - scene["width"] / 2) * scale, middle[1] - (y - scene["height"] / 2) * scale

    def box(self, name):
        """Where something is on the screen, after scrolling to it."""
        found = self.page.locator(f"#{name}")
        found.scroll_into_view_if_needed()
        return found.bounding_box()

    def show(self, panel):
        if self.page.get_attribute(f"#{panel}", "open") is None:
            self.page.click(f"#{panel} summary")

    # --- what is done

    def keys(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def click(self, x, y):
        self.page.mouse.click(*self.pixel(x, y))

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
            found = np.reshape(self.page.evaluate(places), (-1, 2)) / 65535 * np.array(self.picture.extent)
            return len(found) == len(self.watch.picture.colour) and np.allclose(
                found[self.present], self.watch.picture.position[self.present], atol=0.01
            )

        until(settled)

    def download(self, button):
        self.show("keep")
        with self.page.expect_download() as waiting:
            self.page.click(f"#{button}")
        with open(waiting.value.path(), "rb") as file:
            return waiting.value.suggested_filename, file.read()
