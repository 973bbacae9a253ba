"""Small commands: scenes, show, plot, animate, warmup, clean."""

import textwrap
import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from mpsim.cli import terminal
from mpsim.cli.run import MEASURES, RunFolder
from mpsim.cli.terminal import complete_scene
from mpsim.core.checks import refusal
from mpsim.core.progress import shown
from mpsim.engine.simulation import Simulation
from mpsim.engine.workers import shared
from mpsim.features.feature import chosen
from mpsim.kernels.compiling import compiled_kernels
from mpsim.scene import scenefile
from mpsim.scene.scenefile import SceneFile
from mpsim.scene.settings import Settings

# --- `mpsim warmup` and `mpsim clean`: compiles ahead; removes shared memory left by killed programs

WARMUP_EXAMPLES = """\b
Examples:
  mpsim warmup                         for all scenes that come with mpsim: minutes, once
  mpsim warmup gas hopper
  mpsim warmup my_scene.toml --precision float32
"""


@click.command(epilog=WARMUP_EXAMPLES, short_help="Compile ahead of the first run.")
@click.argument("scenes", nargs=-1, shell_complete=complete_scene)
@terminal.settings_options
@terminal.quiet_option
def warmup(scenes: tuple[str, ...], quiet: bool, **options: Any) -> None:
    """Compile the loops that SCENES need, so that their first run starts at once. The result is kept.

    A kernel is compiled for each combination of features, so scenes with the same ones share theirs.
    """
    files = [scenefile.load(scene) for scene in scenes or scenefile.names()]
    with shown(not quiet) as progress:
        for number, file in enumerate(files):
            progress(number, len(files), file.name)
            before, started = compiled_kernels(), time.perf_counter()
            with Simulation(file.scene, terminal.settings_of(file, options)) as sim:
                sim.run(frames=0)
            seconds, kernels = time.perf_counter() - started, compiled_kernels() - before
            click.echo(f"{file.name:12} {seconds:6.1f} s, {kernels} kernels compiled or loaded")


@click.command(
    short_help="Remove shared memory of programs that were killed.",
    epilog="\b\nExamples:\n  mpsim clean --dry-run\n  mpsim clean",
)
@click.option("--dry-run", is_flag=True, help="Only list what would be removed.")
def clean(dry_run: bool) -> None:
    """Remove shared memory of mpsim whose owner is dead, and nothing else.

    It is left behind only if a simulation and its helper processes are all killed at the same moment.
    """
    blocks = shared.stale_blocks() if dry_run else shared.remove_stale_blocks()
    for block in blocks:
        click.echo(f"{block.name}  {block.nbytes:,} bytes, of process {block.pid}")
    total = sum(block.nbytes for block in blocks)
    verb = "would be removed" if dry_run else "removed"
    click.echo(f"{len(blocks)} blocks {verb}, {total:,} bytes")


# --- `mpsim scenes` and `mpsim show`: lists and describes scenes


@click.command(epilog="\b\nExamples:\n  mpsim scenes")
def scenes() -> None:
    """List the scenes that come with mpsim."""
    titles = scenefile.titles()
    width = max(map(len, titles), default=0)
    for name, title in titles.items():
        click.echo(f"{name:{width}}  {title}")


@click.command(short_help="Describe a scene.", epilog="\b\nExamples:\n  mpsim show hopper\n  mpsim show my_scene.toml")
@click.argument("scene", shell_complete=complete_scene)
def show(scene: str) -> None:
    """Describe SCENE: box, discs, features, recommended settings, what to look for.

    The whole file is checked; all its problems are reported at once.
    """
    file = scenefile.load(scene)
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
    sizes = f"radius {_range(scene.radii)}, mass {_range(scene.masses)}"
    words["discs"] = f"{scene.count}, {sizes}, packing {scene.packing:.3g}"
    if file.compressed is not None:
        words["start"] = f"compressed to packing {file.compressed['packing']:g} at rate {file.compressed['rate']:g}"
    if scene.count:
        words["speed"] = f"{np.sqrt((scene.velocity**2).sum(axis=1).mean()):.3g} (root mean square)"
    present = {each.argument: each.description(scene) for each in scene._features}
    words |= {name: text for name, text in present.items() if text}
    words["duration"] = "none recommended" if scene.duration is None else f"{scene.duration:g}"
    if scene.picture_interval is not None:
        words["pictures"] = f"every {scene.picture_interval:g}"
    if scene.measures:
        words["measures"] = ", ".join(scene.measures)
    words["settings"] = settings_text(scene.settings)
    words["read from"] = ", ".join(map(str, file.read))
    return words


def settings_text(settings: Settings | None) -> str:
    """Settings that differ from the defaults, as written in Python."""
    if settings is None:
        return "none recommended"
    changed = {"dt": settings.dt, **chosen(settings)}
    return f"Settings({', '.join(f'{name}={value!r}' for name, value in changed.items())})"


def _range(values: Any) -> str:
    if not len(values):
        return "-"
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


# --- `mpsim plot` and `mpsim animate`: pictures and animations of scenes and runs

PLOT_EXAMPLES = """\b
Examples:
  mpsim plot run                    writes run/plot.png
  mpsim plot run -o story.pdf --force
"""


@click.command(epilog=PLOT_EXAMPLES, short_help="Draw the results of a run.")
@click.argument("folder", type=terminal.PATH)
@terminal.option(
    "--out -o",
    terminal.PATH,
    "Picture to write: .png, .pdf, .svg or another format.  [default: plot.png in the folder, replaced]",
)
@terminal.force_option
def plot(folder: Path, out: Path | None, force: bool) -> None:
    """Draw the results of the run in FOLDER: energy, overlap, collision rate, and the last frame.

    The run may still be in progress.
    """
    from mpsim.output.drawing import checked_picture, save_figure  # noqa: PLC0415 - with matplotlib, see run.py
    from mpsim.output.history import history, read_table  # noqa: PLC0415
    from mpsim.output.trajectory import Trajectory  # noqa: PLC0415

    found = RunFolder.open(folder)
    if out is not None:
        terminal.existing_refused(checked_picture(out), force)
    table, frames = read_table(found[MEASURES]), Trajectory(found.trajectory)
    if not len(frames) or not len(table["time"]):
        raise refusal(repr(str(folder)), "hold a frame", "an empty trajectory", "Let the run continue for a while.")
    title = f"{found.record['scene']}, frame {table['frame'][-1]:.0f}, {found.record['status']}"
    figure = history(table, found.scene, frames[-1], title)
    click.echo(f"written: {save_figure(figure, out or folder / 'plot.png')}")


ANIMATE_EXAMPLES = """\b
Examples:
  mpsim animate gas gas.gif
  mpsim animate galton galton.gif --until 20 --fps 12
  mpsim animate cooling cooling.gif --frames 200 --until 400 --scale log --theme dark
  mpsim animate hopper hopper.mp4 --frames 300 --every 4      (needs ffmpeg or mpsim[film])
"""


@click.command(epilog=ANIMATE_EXAMPLES, short_help="Write an animation.")
@click.argument("scene", shell_complete=complete_scene)
@click.argument("out", type=terminal.FILE)
@terminal.option(
    "--frames", click.IntRange(1, 100_000), "Number of pictures; default: to the end of the scene's duration."
)
@terminal.option("--until", terminal.POSITIVE, "Time of the last picture.")
@terminal.option("--every", click.IntRange(1), "Frames of the simulation per picture; default: the scene's own.")
@terminal.option("--fps", click.IntRange(1, 50), "Pictures per second.", 25)
@terminal.option("--pixels", click.IntRange(100, 4000), "Pixels along the longer side of the box.", 480)
@terminal.option("--colour --color", click.Choice(["speed", "none"]), "What discs are coloured by.", "speed")
@terminal.option(
    "--scale",
    click.Choice(["linear", "log"]),
    "How speeds become colours; log tells slow discs apart where speeds span decades.",
    "linear",
)
@terminal.option("--theme", click.Choice(["light", "dark"]), "", "light")
@terminal.settings_options
@terminal.force_option
@terminal.quiet_option
def animate(
    scene: str,
    out: Path,
    frames: int | None,
    until: float | None,
    every: int | None,
    fps: int,
    colour: str,
    force: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Simulate SCENE and write an animation to OUT: a .gif, or an .mp4 if ffmpeg is installed."""
    from mpsim.output import animation  # noqa: PLC0415 - with matplotlib, see run.py

    terminal.existing_refused(out, force)
    animation.checked_target(out)  # before the scene is made, which may take a while
    file = scenefile.load(scene)
    look = {"pictures_per_second": fps, "colour": None if colour == "none" else colour}
    look |= {name: options.pop(name) for name in ("pixels", "scale", "theme")}
    settings = terminal.settings_of(file, options)
    frames, every = animation.pictures_of(file.scene, settings, frames, every, until)
    try:
        animation.animate(file.scene, settings, out, frames, every=every, **look, progress=not quiet)
    except KeyboardInterrupt:
        raise terminal.Interrupted(f"Interrupted; {str(out)!r} was not written.") from None
    click.echo(f"written: {out}, {frames} pictures, {frames / fps:.3g} s, {out.stat().st_size / 1000:.0f} kB")
