"""`mpsim plot` and `mpsim animate`: pictures and animations of scenes and runs."""

from pathlib import Path
from typing import Any, Literal

import click

from mpsim.cli import terminal
from mpsim.cli.runfolder import MEASURES, RunFolder
from mpsim.core.plain import json_text
from mpsim.errors import InputError
from mpsim.scene import scenefile

PLOT_EXAMPLES = """\b
Examples:
  mpsim plot run                    writes run/plot.png
  mpsim plot run -o story.pdf --force
"""


@click.command(epilog=PLOT_EXAMPLES, short_help="Draw the results of a run.")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    type=click.Path(path_type=Path),
    help="Picture to write: .png, .pdf, .svg or another format.  [default: plot.png in the folder, replaced]",
)
@click.option("--force", is_flag=True, help="Replace an existing file.")
@terminal.json_option
def plot(folder: Path, out: Path | None, force: bool, as_json: bool) -> None:
    """Draw the results of the run in FOLDER: energy, overlap, collision rate, and the last frame.

    The run may still be in progress.
    """
    from mpsim.output.drawing import checked_picture, save_figure  # noqa: PLC0415 - with matplotlib, see run.py
    from mpsim.output.history import history  # noqa: PLC0415
    from mpsim.output.recorder import read_table  # noqa: PLC0415

    found = RunFolder.open(folder)
    if out is not None:
        terminal.existing_refused(checked_picture(out), force)
    table, frames = read_table(found[MEASURES]), found.frames
    if not len(frames) or not len(table["time"]):
        raise InputError(
            f"{str(folder)!r} holds no frame yet; got an empty trajectory. Let the run continue for a while."
        )
    title = f"{found.record['scene']}, frame {table['frame'][-1]:.0f}, {found.record['status']}"
    figure = history(table, found.scene, frames[-1], title)
    path = save_figure(figure, out or folder / "plot.png")
    click.echo(json_text({"picture": str(path)}) if as_json else f"written: {path}")


ANIMATE_EXAMPLES = """\b
Examples:
  mpsim animate gas gas.gif
  mpsim animate galton galton.gif --until 20 --fps 12
  mpsim animate cooling cooling.gif --seconds 8 --scale log --theme dark
  mpsim animate hopper -o hopper.mp4 --frames 300 --every 4      (needs ffmpeg or mpsim[film])
  mpsim animate dense passes.gif --colour parity --method parallel --workers 2
"""


@click.command(epilog=ANIMATE_EXAMPLES, short_help="Write an animation.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@click.argument("out", required=False, type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--out", "-o", "out_option", type=click.Path(path_type=Path, dir_okay=False), help="Another way to give OUT."
)
@click.option(
    "--frames", type=terminal.Whole(1, 100_000), help="Number of pictures; default: to the end of the scene's duration."
)
@click.option("--until", type=terminal.Positive("time"), help="Time of the last picture, in place of --frames.")
@click.option(
    "--seconds",
    type=terminal.Positive("seconds"),
    help="How long the animation lasts, in place of --frames; its pictures are spread over the time to --until or "
    "the scene's duration.",
)
@click.option("--every", type=terminal.Whole(1), help="Frames of the simulation per picture; default: the scene's own.")
@click.option("--fps", type=terminal.Whole(1, 50), default=25, show_default=True, help="Pictures per second.")
@click.option(
    "--pixels",
    type=terminal.Whole(100, 4000),
    default=480,
    show_default=True,
    help="Pixels along the longer side of the box.",
)
@click.option(
    "--colour",
    "--color",
    type=terminal.Choice(["speed", "worker", "parity", "none"]),
    default="speed",
    show_default=True,
    help="worker: by the worker that owns the disc's column; parity: by even and odd columns.",
)
@click.option(
    "--scale",
    type=terminal.Choice(["linear", "log"]),
    default="linear",
    show_default=True,
    help="How speeds become colours; log tells slow discs apart where speeds span decades.",
)
@click.option("--theme", type=terminal.Choice(["light", "dark"]), default="light", show_default=True)
@terminal.settings_options
@click.option("--force", is_flag=True, help="Replace an existing file.")
@terminal.json_option
@terminal.quiet_option
def animate(
    scene: str,
    out: Path | None,
    out_option: Path | None,
    frames: int | None,
    until: float | None,
    seconds: float | None,
    every: int | None,
    fps: int,
    pixels: int,
    colour: str,
    scale: Literal["linear", "log"],
    theme: Literal["light", "dark"],
    force: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Simulate SCENE and write an animation to OUT: a .gif, or an .mp4 if ffmpeg is installed."""
    from mpsim.output import animation  # noqa: PLC0415 - with matplotlib, see run.py

    out = _target(out, out_option)
    terminal.existing_refused(out, force)
    animation.checked_target(out)  # before the scene is made, which may take a while
    file = scenefile.load(scene)
    settings = terminal.settings_of(file, options)
    frames, every = animation.pictures_of(file.scene, settings, frames, every, until, seconds, fps)
    try:
        with terminal.progress(quiet) as progress:
            animation.animate(
                file.scene,
                settings,
                out,
                frames,
                every=every,
                pictures_per_second=fps,
                pixels=pixels,
                colour=None if colour == "none" else colour,
                scale=scale,
                theme=theme,
                progress=False if progress is None else lambda done, of: progress(done, of, "pictures"),
            )
    except KeyboardInterrupt:
        raise terminal.Interrupted(f"Interrupted; {str(out)!r} was not written.") from None
    size = out.stat().st_size
    if as_json:
        click.echo(
            json_text({"animation": str(out), "pictures": frames, "seconds": round(frames / fps, 3), "bytes": size})
        )
    else:
        click.echo(f"written: {out}, {frames} pictures, {frames / fps:.3g} s, {size / 1000:.0f} kB")


def _target(out: Path | None, out_option: Path | None) -> Path:
    """The one of the two that was given."""
    target = out_option or out
    if target is None or (out and out_option):
        raise click.UsageError("Give the file to write once, as OUT or by --out, such as gas.gif.")
    return target
