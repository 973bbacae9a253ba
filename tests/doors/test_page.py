"""The page in a browser at the sizes of a phone, a laptop and a projector: what can grow stays in its place."""

import pytest
from support.browser import browser, until
from support.scenes import gas
from support.viewing import viewed

import mpsim

SIZES = [(390, 844), (1280, 800), (1920, 1080)]

EXTREME = {
    "temperature": 1.234e-16, "energy_drift": -1.78e-16, "pressure": -1.2345e-16, "pressure_error": 3.3e-18,
    "largest_overlap": 1.234e-5, "collisions_per_second": 33424528.7, "collisions": 33424528123,
    "frames_per_second": 123456.7, "nanoseconds": 9999999.4, "discs": 10000000, "bulk_pressure": -1.234e-16,
    "counting": True,
}  # fmt: skip
"""Gauges with the longest texts."""

PAIR = {
    "first": "grid impact dt=0.001234, passes 10, float32", "second": "event", "exact": True, "note": None,
    "skipped": 0, "time": 1.5, "distance": 1.234e-12, "parted": None, "missed": 123456789012, "missed_fraction": 0.1,
    "collisions": [1, 123456789012], "pressure": [-1.234e-16, 123456.7], "pressure_difference": -1.234e-16,
    "difference_error": 1.2e-18, "cost_ratio": 1234567, "lyapunov_time": None, "agree_until": None,
}  # fmt: skip

SHOW = """async ([gauges, pair]) => {
  const { take } = await import("./link.js"), { state } = await import("./common.js");
  const shown = { ...state.gauges, ...gauges };
  take({ type: "gauges", ...shown });
  take({ type: "pair", ...pair });
}"""

OUTSIDE = """() => {
  const found = [];
  const range = document.createRange();
  const box = (node) => { range.selectNodeContents(node); return range.getBoundingClientRect(); };
  for (const card of document.querySelectorAll(".gauges > div, #trade > div, header, aside")) {
    const { left, right } = card.getBoundingClientRect();
    for (const each of card.querySelectorAll("dt, dd, b, small, span, h1")) {
      const text = box(each);
      if (text.width && (text.left < left - 1 || text.right > right + 1)) found.push(`${each.id} ${each.textContent}`);
    }
  }
  for (const card of document.querySelectorAll(".gauges > div")) {
    const name = box(card.querySelector("dt").firstChild), value = box(card.querySelector("dd"));
    const beside = name.bottom <= value.top || value.bottom <= name.top || name.right <= value.left;
    if (value.width && !beside) found.push(`${card.textContent}: name and value overlap`);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page is wider than its window");
  return found;
}"""

COVERED = """() => {
  const [legend, select] = ["legend", "colour"].map((id) => document.getElementById(id).getBoundingClientRect());
  const size = 0.82 * parseFloat(getComputedStyle(document.documentElement).fontSize); // of the numbers in the legend
  return select.top < legend.bottom - 1.5 * size;
}"""


@pytest.fixture(scope="module")
def opened():
    with browser() as found:
        yield found


@pytest.fixture
def view(capsys):
    settings = mpsim.Settings(method="grid", dt=0.01)
    with viewed(gas(300, 0.4), settings, playing=False, name="A name that is quite long " * 3) as found:
        yield found


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("touch", [False, True])
def test_no_number_leaves_its_card(size, touch, view, opened):
    page = opened.new_page(viewport=dict(zip(("width", "height"), size, strict=True)), has_touch=touch, is_mobile=touch)
    page.goto(view.address)
    temperature = page.locator("#temperature")
    until(lambda: temperature.inner_text()[0] in "0123456789")
    page.evaluate(SHOW, [EXTREME, PAIR])
    assert page.locator("#collisions").inner_text() == "33,424,528,123"
    assert page.evaluate(OUTSIDE) == []
    assert not page.evaluate(COVERED)
    page.close()


def test_the_label_is_that_of_the_disc_that_is_dragged(view, opened):
    page = opened.new_page(viewport={"width": 1280, "height": 800})
    page.goto(view.address)
    until(lambda: page.locator("#stage").get_attribute("data-drawn"))
    where = """async () => {
      const { camera, stage } = await import("./stage.js"), { placeOf } = await import("./hands.js");
      const { state } = await import("./common.js");
      const box = stage.getBoundingClientRect(), ratio = devicePixelRatio;
      return [...Array(state.picture.count).keys()].map((disc) => {
        const [x, y] = camera.pixel(...placeOf(disc));
        return [box.left + stage.clientLeft + x / ratio, box.top + stage.clientTop + y / ratio];
      });
    }"""
    places = page.evaluate(where)
    label = page.locator("#disc-label")
    page.mouse.move(*places[7])
    until(lambda: label.inner_text().startswith("disc 7:"))
    page.mouse.down()
    page.mouse.move(*places[20], steps=5)
    page.keyboard.press("Space")  # other discs come by, where the drag began
    until(lambda: page.locator("#phase").inner_text() == "playing")
    for _ in range(20):
        page.wait_for_timeout(50)
        assert label.is_visible()
        assert label.inner_text().startswith("disc 7:")
    page.keyboard.press("Space")
    until(lambda: page.locator("#phase").inner_text() == "paused")
    page.mouse.up()
    places = page.evaluate(where)
    page.mouse.move(*places[100])
    until(lambda: label.inner_text().startswith("disc 100:"))
    page.close()
