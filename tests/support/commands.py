"""The command `mpsim` run in the test's own process, and what the library finds for the same scene."""

from click.testing import CliRunner, Result

import mpsim
from mpsim.cli.app import main
from mpsim.scene import scenefile

SHORT = ("--method", "grid", "--frames", "30", "--every", "4", "--quiet")


def mpsim_command(*arguments: object) -> Result:
    """Run the command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def library_digest(frames: int, **settings) -> str:
    file = scenefile.load("gas")
    with mpsim.Simulation(
        file.scene, mpsim.Settings(**{**vars(file.scene.settings), "method": "grid", **settings})
    ) as sim:
        sim.run(frames=frames)
        return sim.digest()
