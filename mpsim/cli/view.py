"""`mpsim view`: a scene as it runs, on a page in the browser."""

import signal
from typing import Any

import click

from mpsim.cli import terminal
from mpsim.scene import scenefile

VIEW_EXAMPLES = """\b
Examples:
  mpsim view                                    the scene gas
  mpsim view hopper --paused
  mpsim view my_scene.toml --method parallel --workers 2
  mpsim view gas --port 8000 --no-browser       on a machine without a screen: ssh -L 8000:127.0.0.1:8000 there
"""


@click.command(epilog=VIEW_EXAMPLES, short_help="Watch a scene run, in the browser.")
@click.argument("scene", shell_complete=terminal.complete_scene, default="gas")
@click.option("--host", default="127.0.0.1", show_default=True, help="Where it listens; the default is this machine.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Else one that is free.")
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open it in the browser.")
@click.option("--paused", is_flag=True, help="Wait for the page's button.")
@terminal.settings_options
def view(scene: str, host: str, port: int, browser: bool, paused: bool, **options: Any) -> None:
    """Show SCENE (else gas) as it runs, on a page in the browser, until Ctrl-C.

    It runs while a page shows it. Only this machine can open the page, unless --host is given: then all who can reach
    that address and know the token in it, without encryption.
    """
    from mpsim.viewer import live  # noqa: PLC0415 - other commands need no server

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends it as Ctrl-C does
    file = scenefile.load(scene)
    settings = terminal.settings_of(file, options)
    live.view(file.scene, settings, host=host, port=port, browser=browser, playing=not paused, name=file.name)
