"""Makes the gallery of the docs: a picture and an animation of each named scene.

python scripts/run_gallery.py                    all scenes, under results/gallery/
python scripts/run_gallery.py hopper galton      some of them
python scripts/run_gallery.py --out docs/gallery --page docs/gallery.md
"""

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, cast

import matplotlib
import numpy as np
from harness import exit_code, make_folder, parser_of, say
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from PIL import Image

import mpsim
from mpsim.output.animation import Picture, image_of, moment_of, moments_of
from mpsim.output.drawing import LIGHT, STYLE, ColourScale
from mpsim.scene.scene import frames_between_pictures, settings_for
from mpsim.scene.scenefile import SceneFile, load, names
from mpsim.studies.findings import PROMISES, Compression, Cooling, Galton, Hopper, Promise

WHOLE = (
    "brazil-nut", "brownian", "cooling", "cradle", "flipper", "galton", "growth", "partition", "pi", "piston",
    "rough-sediment",
)  # fmt: skip
"""Scenes that are shown to the end of their duration; of the others as many pictures, at their own interval."""

LOGARITHMIC = {"cooling"}
"""Scenes whose speeds span decades."""

STILLS = {"sediment": 0.4}
"""Where in the animation a still is taken, if not at two thirds: grains that still move."""

PICTURES = 120
"""Pictures of an animation, and pictures in a second: ten seconds."""
RATE = 12

PIXELS = 200
STILL_PIXELS = 400
SIZE = 500_000
"""Largest size of an animation [bytes]: all of them together are loaded with one page."""


# --- trails, counters and curves over the discs

INK, LAW = "#D55E00", "#000000"
PLAIN = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}

Mark = Callable[[Axes, mpsim.Simulation, Promise], Sequence[Artist]]
"""Draws on the axes of the box, from the simulation and what was seen so far; returns what it drew."""


def _words(axes: Axes, text: str) -> Artist:
    return axes.text(0.03, 0.97, text, transform=axes.transAxes, va="top", fontsize=8, bbox=PLAIN, zorder=9)


def trail(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The path of the large disc."""
    _, path = promise.series
    return axes.plot(*path.reshape(-1, 2).T, color=INK, linewidth=1.2, zorder=8)


def heap(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The binomial curve of as many balls as lie in the bins, as high as they would stand, and their number."""
    galton = cast(Galton, promise)
    x = galton.binned(sim)
    words = [_words(axes, f"{len(x)} balls in the bins")]
    if len(x) < 10:
        return words
    _, curve = galton.heap(x)
    ball = np.pi * sim.scene.largest_radius**2 / 0.8  # area, with the gaps between balls
    middles = np.arange(len(curve)) + 0.5
    inner = 1 - 0.1  # width of a bin between its walls
    return [*axes.plot(middles, curve * ball / inner, color=INK, linewidth=1.5, zorder=8), *words]


def passed(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """Grains that have come through the gap."""
    times, numbers = promise.series
    late = times >= Hopper.STEADY
    if np.count_nonzero(late) < 2:
        return []
    flow = (numbers[-1] - numbers[late][0]) / (times[-1] - times[late][0])
    return [_words(axes, f"{numbers[-1]:.0f} passed\n{flow:.0f} per unit of time")]


def collisions(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """Collisions so far, in the title: the box is too low for words."""
    axes.set_title(f"time {sim.time:.2f}, {len(promise.observers[0].table)} collisions")
    return []


def _curve(
    axes: Axes,
    found: tuple[Any, Any],
    law: tuple[Any, Any],
    name: str,
    place: tuple[float, float, float, float],
    scale: str,
    corner: Literal["upper left", "upper right"],
) -> Sequence[Artist]:
    """An inset with what was found, and the law, dashed, over the whole duration; name: of the law."""
    inset = axes.inset_axes(place, zorder=9)
    inset.plot(*law, color=LAW, linewidth=1, linestyle="--", label=name)
    inset.plot(*found, color=INK, linewidth=1.5, label="temperature")
    inset.set(xlim=(0, law[0][-1]), xticks=[], yscale=scale)
    inset.tick_params(left=False, labelleft=False, which="both")
    # In the corner that the curves do not come to.
    inset.legend(loc=corner, fontsize=6, handlelength=1.2, borderaxespad=0.2, labelspacing=0.2, handletextpad=0.4)
    inset.grid(False)
    inset.set_facecolor("#FFFFFFFF")
    return [inset]


def haff(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The temperature, and Haff's law."""
    times, found = promise.series
    moments = np.linspace(0, promise.scene.duration or 1.0, 200)
    law = found[0] / (1 + moments / cast(Cooling, promise).haff_time) ** 2
    return _curve(axes, (times, found), (moments, law), "Haff's law", (0.55, 0.68, 0.44, 0.31), "log", "upper right")


def adiabat(axes: Axes, sim: mpsim.Simulation, promise: Promise) -> Sequence[Artist]:
    """The temperature, and that of a slow compression, on the region behind the piston."""
    times, found = promise.series
    moments = np.linspace(0, promise.scene.duration or 1.0, 100)
    law = [cast(Compression, promise).adiabat(each) for each in moments.tolist()]
    if sim.state.box is None or promise.scene.width - sim.state.box[1] < 0.36 * promise.scene.width:
        return []  # there is no room behind it yet
    return _curve(axes, (times, found), (moments, law), "adiabat", (0.68, 0.15, 0.29, 0.7), "linear", "upper left")


MARKS: dict[str, Mark] = {
    "brownian": trail,
    "cooling": haff,
    "galton": heap,
    "hopper": passed,
    "pi": collisions,
    "piston": adiabat,
    "rough-hopper": passed,
}
"""By the name of the scene."""


# --- pictures


def scale_of_run(found: SceneFile, pictures: int, every: int) -> ColourScale | None:
    """The scale of the speeds of all pictures, with a number of frames between two."""
    kind = "log" if found.name in LOGARITHMIC else "linear"
    with (
        mpsim.Simulation(found.scene, settings_for(found.scene, None)) as sim,
        moments_of(sim, pictures, every, "speed", kind) as (_, scale),
    ):
        return scale


def show(found: SceneFile, folder: Path) -> None:
    """Write <name>.gif, and <name>.png: the last picture where the whole is shown, else one of the course."""
    scene, settings, number = found.scene, settings_for(found.scene, None), PICTURES
    every = frames_between_pictures(scene, settings) or 1
    if found.name in WHOLE and scene.duration:
        every = max(every, round(scene.duration / settings.dt / (PICTURES - 1)))
    if scene.duration:
        number = min(number, int(scene.duration / (every * settings.dt) + 1e-9) + 1)
    still = number - 1 if found.name in WHOLE else round(STILLS.get(found.name, 0.67) * number)
    promise = PROMISES[found.name](scene, settings) if found.name in PROMISES else None
    mark = MARKS.get(found.name)
    scale = scale_of_run(found, number, every)
    images: list[Image.Image] = []
    with mpsim.Simulation(scene, settings) as sim, matplotlib.rc_context(fname=STYLE):
        film, large = (Picture(scene, pixels, scale) for pixels in (PIXELS, STILL_PIXELS))
        if scene.height < scene.width * 0.6:
            film.figure.axes[-1].set_ylabel("speed")  # there is no room for the dimension
        for shown in range(number):
            if shown:
                sim.run(frames=every, observe=promise.observers if promise else [])
            images.append(drawn(film, sim, promise, mark))
            if shown == still:
                image = drawn(large, sim, promise, mark).quantize(palette=palette(256), dither=Image.Dither.NONE)
                image.save(folder / f"{found.name}.png", optimize=True)
    save(images, folder / f"{found.name}.gif")


def drawn(picture: Picture, sim: mpsim.Simulation, promise: Promise | None, mark: Mark | None) -> Image.Image:
    """The picture of this moment, with its mark."""
    picture.show(moment_of(sim, coloured=True))
    over = mark(picture.axes, sim, promise) if mark and promise and sim.frame else []
    image = image_of(picture.figure)
    for each in over:
        each.remove()
    return image


def palette(colours: int) -> Image.Image:
    """Most of the colours for the scale, so that no bands show in it, the others for greys and what is drawn over."""
    scale = matplotlib.colormaps["viridis"](np.linspace(0, 1, colours * 3 // 4))[:, :3]
    ink = [to_rgb(each) for each in (INK, LIGHT.solid, LIGHT.behind)]
    greys = np.linspace(0, 1, colours - len(scale) - len(ink))[:, None].repeat(3, axis=1)
    found = Image.new("P", (1, 1))
    found.putpalette(np.rint(255 * np.concatenate([scale, ink, greys])).astype(np.uint8).tobytes())
    return found


def save(images: list[Image.Image], path: Path) -> None:
    """Write a GIF whose pictures share one palette; if it is too large, with fewer colours or pictures."""
    for step, colours in ((1, 128), (1, 64), (2, 64), (2, 32), (3, 32), (4, 32), (6, 32)):
        shown, few = images[::step], palette(colours)
        small = [image.quantize(palette=few, dither=Image.Dither.NONE) for image in shown]
        durations = [1000 // RATE * step] * (len(small) - 1) + [2000]
        small[0].save(path, save_all=True, append_images=small[1:], duration=durations, loop=0)
        if path.stat().st_size < SIZE:
            return


def page(scenes: list[SceneFile], folder: str) -> str:
    """The gallery as a page of the docs."""
    lines = [
        "# Gallery",
        "",
        "These scenes come with mpsim. `mpsim show NAME` tells more of one; `mpsim.Scene.load(NAME)` loads it. Each "
        "is a small file in `mpsim/scene/named/`, which you can copy and change. Colours show speeds, in `cooling` "
        "on a logarithmic scale.",
        "",
    ]
    for found in scenes:
        lines += [f"## {found.title}", "", f"![{found.title}, moving]({folder}/{found.name}.gif)", ""]
        lines += [f"`{found.name}` ([still]({folder}/{found.name}.png)): {' '.join(found.look_for.split())}", ""]
    return "\n".join(lines)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("scenes", nargs="*", help="names; default: all")
    parser.add_argument("--out", type=Path, default=Path("results/gallery"))
    parser.add_argument("--page", type=Path, help="also write the page of the docs to this file")
    options = parser.parse_args()
    make_folder(options.out)
    scenes = [load(name) for name in options.scenes or names()]
    for found in scenes:
        started = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
            show(found, options.out)
        size = sum((options.out / f"{found.name}.{ending}").stat().st_size for ending in ("gif", "png")) / 1000
        say(f"{found.name}: {time.perf_counter() - started:.1f} s, {size:.0f} kB")
    if options.page:
        folder = options.out.relative_to(options.page.parent)
        options.page.write_text(page(scenes, str(folder)))


if __name__ == "__main__":
    sys.exit(exit_code(main))
