"""`mpsim scenes` and `mpsim show`: lists and describes scenes."""

import dataclasses
import textwrap
from typing import Any

import click
import numpy as np

from mpsim.cli.terminal import complete_scene
from mpsim.core.plain import json_text
from mpsim.features import FEATURES, NUMBERS
from mpsim.scene import scenefile
from mpsim.scene.scenefile import SceneFile
from mpsim.scene.settings import Settings


@click.command(epilog="\b\nExamples:\n  mpsim scenes\n  mpsim scenes --json")
@click.option("--json", "as_json", is_flag=True, help="Print JSON: name and title of each.")
def scenes(as_json: bool) -> None:
    """List the scenes that come with mpsim."""
    titles = scenefile.titles()
    if as_json:
        click.echo(json_text(titles))
        return
    width = max(map(len, titles), default=0)
    for name, title in titles.items():
        click.echo(f"{name:{width}}  {title}")


@click.command(
    short_help="Describe a scene.", epilog="\b\nExamples:\n  mpsim show hopper\n  mpsim show my_scene.toml --json"
)
@click.argument("scene", shell_complete=complete_scene)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def show(scene: str, as_json: bool) -> None:
    """Describe SCENE: box, discs, features, recommended settings, what to look for.

    The whole file is checked; all its problems are reported at once.
    """
    file = scenefile.load(scene)
    if as_json:
        click.echo(json_text(record(file)))
        return
    click.echo(f"{file.name}: {file.title}" if file.title else file.name)
    for text in (file.text, file.look_for and f"Look for: {file.look_for}"):
        if text:
            click.echo("\n" + textwrap.fill(" ".join(text.split()), 100))
    click.echo()
    for name, value in description(file).items():
        click.echo(f"{name:12} {value}")


def description(file: SceneFile) -> dict[str, str]:
    """A scene in words, by subject."""
    scene = file.scene
    x, y = scene.boundary
    boundary = x if x == y else f"{x} along x, {y} along y"
    words = {"box": f"{scene.width:g} x {scene.height:g}, {boundary}"}
    words["discs"] = f"{scene.count}, radius {_range(scene.radii)}, mass {_range(scene.masses)}, "
    words["discs"] += f"packing {scene.packing:.3g}"
    if file.compressed is not None:
        words["start"] = f"compressed to packing {file.compressed['packing']:g} at rate {file.compressed['rate']:g}"
    if scene.count:
        mean = float(np.sqrt((scene.velocity**2).sum(axis=1).mean()))
        words["speed"] = f"{mean:.3g} (root mean square)"
    present = {each.argument: each.description(scene) for each in FEATURES if each.is_in(scene)}
    words |= {name: text for name, text in present.items() if text}
    words["duration"] = "none recommended" if scene.duration is None else f"{scene.duration:g}"
    if scene.picture_interval is not None:
        words["pictures"] = f"every {scene.picture_interval:g}"
    if scene.measures:
        words["measures"] = ", ".join(scene.measures)
    words["settings"] = settings_text(file.settings)
    words["read from"] = ", ".join(map(str, file.read))
    return words


def settings_text(settings: Settings | None) -> str:
    """Settings that differ from the defaults, as written in Python."""
    if settings is None:
        return "none recommended"
    chosen, defaults = vars(settings), vars(Settings())
    changed = [f"{name}={value!r}" for name, value in chosen.items() if name == "dt" or value != defaults[name]]
    return f"Settings({', '.join(changed)})"


def record(file: SceneFile) -> dict[str, Any]:
    """The same as plain values."""
    scene = file.scene
    return {
        "name": file.name,
        "title": file.title,
        "text": file.text,
        "look_for": file.look_for,
        "width": scene.width,
        "height": scene.height,
        "boundary": scene.boundary,
        "count": scene.count,
        "packing": scene.packing,
        "compressed": file.compressed,
        **{feature.argument: feature.record(scene) for feature in FEATURES},
        **{name: getattr(scene, name) for name in NUMBERS},
        "duration": scene.duration,
        "picture_interval": scene.picture_interval,
        "measures": scene.measures,
        "settings": None if file.settings is None else dataclasses.asdict(file.settings),
        "read": [str(path) for path in file.read],
        "digest": scene.digest(),
    }


def _range(values: Any) -> str:
    if not len(values):
        return "-"
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
