"""`mpsim view`: a running scene, or a recorded run, on a page in the browser."""

import contextlib
import dataclasses
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mpsim.cli import terminal
from mpsim.cli.run import RECORD, RunFolder
from mpsim.errors import InputError
from mpsim.features.edges import BOUNDARIES
from mpsim.output.trajectory import READERS, ending_of
from mpsim.scene import scenefile

if TYPE_CHECKING:
    from mpsim.viewer.playback import Recording

VIEW_EXAMPLES = """\b
Examples:
  mpsim view                                    the scene gas
  mpsim view hopper --paused
  mpsim view gas --beside event                 the exact solver beside it, from the same start
  mpsim view dense --beside dt=0.001,passes=2
  mpsim view my_scene.toml --method parallel --workers 2
  mpsim view '?scene=gas&dt=0.005&seed=3&wait'  a link from the page of another view
  mpsim view run                                the folder of a run, which may still be in progress
  mpsim view trajectory.xyz
  mpsim view plain.xyz --box 8,6 --radius 0.5   what another program left out of its file
  mpsim view gas --port 8000 --no-browser       on a machine without a screen: ssh -L 8000:127.0.0.1:8000 there
"""


@click.command(epilog=VIEW_EXAMPLES, short_help="Watch a scene run, in the browser.")
@click.argument("scene", shell_complete=terminal.complete_scene, default="gas")
@terminal.option("--host", click.STRING, "Address to listen on; the default accepts this machine only.", "127.0.0.1")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port to listen on; default: a free one.")
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open the page in the browser.")
@click.option("--paused", is_flag=True, help="Start paused, until the page's play button is pressed.")
@click.option("--beside", metavar="SETTINGS", help="A second stage: a method, or settings such as dt=0.001,passes=2.")
@click.option("--box", metavar="WIDTH,HEIGHT", help="Of a file whose frames hold none; or X_LOW,X_HIGH,Y_LOW,Y_HIGH.")
@click.option("--boundary", type=click.Choice(BOUNDARIES), help="Of a file whose frames do not say it.")
@click.option("--radius", type=terminal.POSITIVE, help="Of all discs of a file whose frames hold none.")
@terminal.settings_options
def view(
    scene: str,
    host: str,
    port: int,
    browser: bool,
    paused: bool,
    beside: str | None,
    **options: Any,
) -> None:
    """Show SCENE (default: gas) in the browser while it runs, until Ctrl-C.

    SCENE may also be the folder of a run or the file of a trajectory: it is shown with a time line, and followed
    while another process writes it. Or it is an address that was copied from the page of another view: only the part
    from the question mark on is used, and nothing is fetched. A scene runs while a page shows it. Only this machine
    can open the page, unless --host is given. Then anyone who can reach that address and knows the token in it can
    open the page; the connection is not encrypted.
    """
    from mpsim.viewer import live, share_url  # noqa: PLC0415 - other commands need no server

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends it as Ctrl-C does
    where: dict[str, Any] = {"host": host, "port": port, "browser": browser, "playing": not paused}
    own = {name: options.pop(name) for name in ("box", "boundary", "radius")}
    given = {name: value for name, value in own.items() if value is not None}
    is_link = share_url.is_link(scene)
    if given and (is_link or not _is_recording(scene)):
        raise click.UsageError(f"--{next(iter(given))} can be given only with the file of a trajectory. Leave it out.")
    if is_link:
        with _named("the address SCENE"):
            link = share_url.read(scene)
        changed = {name: value for name, value in options.items() if value is not None}
        settings = dataclasses.replace(link.settings, **changed)
        with _named("--beside"):
            second = link.beside if beside is None else share_url.beside_of(settings, beside)
        where["playing"] &= "wait" not in link.seen
        live.view(link._replace(settings=settings, beside=second), name=link.scene, **where)
    elif _is_recording(scene):
        live.view(_recording(scene, given, {**options, "beside": beside}), name=Path(scene).name, **where)
    else:
        file = scenefile.load(scene)
        settings = terminal.settings_of(file, options)
        with _named("--beside"):
            second = None if beside is None else share_url.beside_of(settings, beside)
        live.view(file.scene, settings, name=file.name, beside=second, **where)


@contextlib.contextmanager
def _named(part: str) -> Iterator[None]:
    """Errors of names inside of a part of the command line, which are no options, name that part."""
    try:
        yield
    except InputError as error:
        raise click.BadParameter(str(error), param_hint=part) from None


def _is_folder(path: str) -> bool:
    """Whether a path leads to the folder of a run."""
    return Path(path).is_dir() and (path not in scenefile.names() or Path(path, RECORD).exists())


def _is_recording(path: str) -> bool:
    """Whether a path leads to the folder of a run or the file of a trajectory."""
    return _is_folder(path) or ending_of(path) in READERS


def _recording(path: str, given: dict[str, Any], options: dict[str, Any]) -> "Recording":
    """The recording that a path leads to; `given` is for its `Trajectory`."""
    from mpsim.viewer.playback import Recording  # noqa: PLC0415 - as above

    if wrong := sorted(name for name, value in options.items() if value is not None):
        raise click.UsageError(
            f"--{wrong[0].replace('_', '-')} can be given only with a scene; {path!r} is a recording, which is only "
            "shown. Leave it out."
        )
    if isinstance(given.get("box"), str):
        try:
            given["box"] = [float(word) for word in given["box"].split(",")]
        except ValueError:
            raise click.BadParameter(f"{given['box']!r} must be numbers, such as 10,8.", param_hint="--box") from None
    if not _is_folder(path):
        return Recording(Path(path), **given)
    run = RunFolder.open(path)
    return Recording(run.trajectory, run.scene, follow=run.record["status"] == "running", **given)
