"""The gallery of the docs: each named scene as a picture and a short animation, with what to look for.

python scripts/run_gallery.py                    all scenes, under results/gallery/
python scripts/run_gallery.py hopper galton      some of them
python scripts/run_gallery.py --out docs/gallery --page docs/gallery.md
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import matplotlib
from PIL import Image
from rich.console import Console

import mpsim
from mpsim.output.animation import DPI, STYLE, Picture, animate
from mpsim.scene.recommended import settings_for
from mpsim.scene.scenefile import SceneFile, load, names

LENGTHS = {
    "brownian": 20.0, "channel": 20.0, "cooling": 60.0, "cradle": 20.0, "dense": 5.0, "galton": 45.0, "gas": 10.0,
    "growth": 12.0, "hopper": 12.0, "mixture": 10.0, "pi": 12.0, "piston": 200.0,
    "rough-hopper": 12.0, "rough-sediment": 16.0, "sediment": 8.0,
}  # fmt: skip
"""Time of each scene that is shown; what there is to see happens in it."""

OTHERWISE = 10.0

PICTURES = 32
"""Pictures of an animation: under three seconds."""

PIXELS = 220
STILL_PIXELS = 400
COLOURS = 16
"""Colours of an animation: fewer than 256 halve the file and hardly show."""

console = Console()


def show(found: SceneFile, folder: Path) -> None:
    """Write <name>.gif and <name>.png, the state at two thirds of the time."""
    length = LENGTHS.get(found.name, OTHERWISE)
    settings = settings_for(found.scene, None)
    every = max(round(length / settings.dt / PICTURES), 1)
    path = folder / f"{found.name}.gif"
    animate(found.scene, settings, path, PICTURES, every=every, pictures_per_second=12, pixels=PIXELS, progress=False)
    shrink(path)
    with mpsim.Simulation(found.scene, settings) as sim, matplotlib.rc_context(fname=STYLE):
        sim.run(frames=every * PICTURES * 2 // 3)
        picture = Picture(sim, STILL_PIXELS)
        picture.update()
        picture.figure.savefig(folder / f"{found.name}.png", dpi=DPI)
    with Image.open(folder / f"{found.name}.png") as still:
        still.convert("RGB").quantize(64).save(folder / f"{found.name}.png", optimize=True)


def shrink(path: Path) -> None:
    """Write a GIF again with fewer colours, the same for all its pictures."""
    with Image.open(path) as film:
        duration = film.info["duration"]
        frames = []
        for number in range(getattr(film, "n_frames", 1)):
            film.seek(number)
            frames.append(film.convert("RGB"))
    palette = frames[len(frames) // 2].quantize(COLOURS)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    small[0].save(path, save_all=True, append_images=small[1:], duration=duration, loop=0, optimize=True)


def page(scenes: list[SceneFile], folder: str) -> str:
    """The gallery as a page of the docs."""
    lines = [
        "# Gallery",
        "",
        "These scenes come with mpsim. `mpsim show NAME` describes one, and `mpsim.Scene.load(NAME)` loads it. Each is "
        "a small file in `mpsim/scene/named/`, which you can copy and change. Colours show speeds. The pictures were "
        "made by `scripts/run_gallery.py`.",
        "",
    ]
    for found in scenes:
        lines += [f"## {found.title}", "", f"![{found.title}, moving]({folder}/{found.name}.gif)", ""]
        lines += [f"`{found.name}`: {oneline(found.text)}", "", f"**Look for:** {oneline(found.look_for)}", ""]
        lines += [f"[A still picture]({folder}/{found.name}.png)", ""]
    return "\n".join(lines)


def oneline(text: str) -> str:
    return " ".join(text.split())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="names; default: all")
    parser.add_argument("--out", type=Path, default=Path("results/gallery"))
    parser.add_argument("--page", type=Path, help="also write the page of the docs to this file")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        scenes = [load(name) for name in options.scenes or names()]
    except mpsim.MpsimError as error:
        console.print(f"run_gallery: {error}", style="red", highlight=False, soft_wrap=True)
        return 2
    for found in scenes:
        started = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", mpsim.EmitterWarning)
            show(found, options.out)
        size = sum((options.out / f"{found.name}.{ending}").stat().st_size for ending in ("gif", "png")) / 1000
        console.print(f"{found.name}: {time.perf_counter() - started:.1f} s, {size:.0f} kB", highlight=False)
    if options.page:
        folder = options.out.relative_to(options.page.parent)
        options.page.write_text(page(scenes, str(folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
