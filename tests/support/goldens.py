"""Scenes whose digests are pinned: every feature and every setting that changes bits, alone and all together.

They are made by integer arithmetic alone, so that neither the mathematical library nor the random numbers of NumPy can
change a digest.

python -m support.goldens            what each scene comes to by every method of one process, as JSON
python -m support.goldens --few      by the methods, contacts and precisions of the default suite
python -m support.goldens NAMES      the digests of some of them, likewise
"""

import itertools
import json
import sys
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import mpsim
from mpsim import (
    Circle,
    Emitter,
    FixedDisc,
    Oscillation,
    Piston,
    Polyline,
    Rotation,
    ThermalWalls,
    Thermostat,
    Translation,
)
from mpsim import Path as Track
from support.scenes import lattice, split

FRAMES, DT = 24, 1 / 16
INDEX = np.arange(30)
LATTICE = lattice(6, 5)

KINDS = list(itertools.product(("push", "impact"), ("float32", "float64")))  # contact and precision

MEASURES = (
    "pressure", "pressure_virial", "pressure_xx", "pressure_yy", "pressure_xy", "collision_rate", "contact_rate",
    "overlap", "largest_overlap", "kinetic_energy", "temperature", "speed_kurtosis", "energy_drift", "momentum_drift",
)  # fmt: skip

SIZES = np.array([0.5, 0.375, 0.25])[INDEX % 3]
GIANTS = np.where(INDEX % 17 == 3, 0.5625, 0.1875)
MASSES = np.array([0.5, 1.0, 3.0, 1.5])[INDEX % 4]
PULLS = np.stack([(INDEX % 7 - 3) / 1.0, (INDEX % 5 - 2) / 2], axis=1)
TURNS = (INDEX % 5 - 2) / 2
ROUGH: dict[str, Any] = {"friction": 0.5, "wall_friction": 0.25, "tangential_restitution": 0.5, "spin": TURNS}
CORNER = (7.25, 6.25)
BY_FRAMES = Emitter((9.5, 6.25), (-0.5, -5.0), every=4)
BY_TIME = Emitter((10.25, 0.75), (0.25, 5.0), interval=0.3, limit=3)
PEG = FixedDisc((4.0, 6.25), 0.375)
FUNNEL = Polyline([(0.0, 5.75), (6.5, 6.5), (7.5, 5.0)], thickness=0.125)


def _added(*place: float, **more: Any) -> Callable[[mpsim.Simulation], None]:
    """One disc more, in the middle of a run."""
    return lambda sim: sim.add(place, (-1.5, 0.5), **more)


@dataclass(frozen=True)
class Ran:
    """What a run came to."""

    state: mpsim.State
    collisions: int
    measures: dict[str, str]

    def __str__(self) -> str:
        return f"{self.state.digest()} {self.collisions} contacts"


def _refusal(sim: mpsim.Simulation, measure: str) -> str:
    """Why a simulation cannot have a measure, or ""."""
    try:
        sim.run(frames=0, measures=[measure])
    except mpsim.InputError as error:
        return f"refused: {error}"
    return ""


@dataclass(frozen=True)
class Pinned:
    """A scene and its settings.

    features: arguments of the scene, by default 30 discs of radius 0.5 in a box of 8 x 7.
    settings: other than method, contact and precision.
    midway: what is done to the simulation after half of the frames.
    acts: whether a run shows what the feature is for; every run must also differ from that of the bare scene.
    """

    features: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    midway: Callable[[mpsim.Simulation], None] | None = None
    acts: Callable[[mpsim.State], Any] = lambda state: True

    def scene(self) -> mpsim.Scene:
        bare = {"width": 8.0, "height": 7.0, "radius": 0.5, "position": LATTICE.position, "velocity": LATTICE.velocity}
        return mpsim.Scene(**(bare | self.features))

    def start(self, **how: Any) -> mpsim.Simulation:
        """A simulation by a method, a contact and a precision.

        Raises:
            InputError: for what the method cannot do.
        """
        return mpsim.Simulation(self.scene(), **split({"dt": DT, **self.settings, **how}))

    def run(self, measures: Iterable[str] = (), **how) -> Ran:
        """Run it, with those of the measures that its second half can have."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            with self.start(**how) as sim:
                first = sim.run(frames=FRAMES // 2)
                if self.midway is not None:
                    self.midway(sim)
                refused = {name: reason for name in measures if (reason := _refusal(sim, name))}
                names = [name for name in measures if name not in refused]
                second = sim.run(frames=FRAMES - FRAMES // 2, measures=names)
                # The last digits of a mean are NumPy's, whose order of summation is that of the processor.
                found = {name: f"{round(second.measures[name].value, 9) + 0.0:.10g}" for name in names}
                return Ran(sim.state, first.collisions + second.collisions, found | refused)


def _piston(wall: str, speed: float, stop: float, start: float | None = None) -> Pinned:
    box = (0.0, 8.0, 0.0, 7.0)
    edge = ("left", "right", "bottom", "top").index(wall)
    place = (box[edge] if start is None else start) + speed * FRAMES * DT
    place = min(place, stop) if speed > 0 else max(place, stop)
    return Pinned(
        {"piston": Piston(wall, speed, stop, start)},
        acts=lambda state: state.box == (*box[:edge], place, *box[edge + 1 :]),
    )


def _moved(motion: Any) -> list[Any]:
    """A paddle beside the discs, by a motion."""
    return [Polyline([(6.0, 5.9), (7.8, 5.9)], thickness=0.25, motion=motion)]


def _crossed(*axes: int) -> Callable[[mpsim.State], Any]:
    """Discs have moved through the borders of these axes, and of no other."""
    return lambda state: state.image is not None and [a for a in (0, 1) if state.image[:, a].any()] == list(axes)


def _absorbing(*edges: str) -> Pinned:
    return Pinned({"absorbing": edges}, acts=lambda state: not state.present.all())


def _entered(discs: int) -> Callable[[mpsim.State], Any]:
    """So many discs or more have entered."""
    return lambda state: len(state.position) >= len(INDEX) + discs


EVERYTHING: dict[str, Any] = {
    "gravity": (0.375, -2.0),
    "acceleration": PULLS,
    "radius": SIZES,
    "mass": MASSES,
    "restitution": 0.75,
    "wall_restitution": 0.5,
    "boundary": ("periodic", "walls"),
    "obstacles": [FUNNEL, FixedDisc((7.5, 2.5), 0.25), FixedDisc((4.0, 0.0), 0.125)],
    "emitters": [
        Emitter(CORNER, (-3.0, 1.5), every=4, radius=0.25, mass=2.0),
        Emitter((0.625, 6.3125), (2.5, 0.25), interval=0.3, limit=3, radius=0.375, mass=0.5),
    ],
    "absorbing": ("bottom",),
    "piston": Piston("top", -0.5, 6.5),
}


def _all_act(state: mpsim.State) -> bool:
    moved = state.image is not None and state.image[:, 0].any() and not state.image[:, 1].any()
    return bool(moved and not state.present.all() and len(state.position) > 32 and state.box and state.box[3] == 6.5)


def _spun(state: mpsim.State) -> bool:
    """Contacts have changed spins."""
    return state.spin is not None and not np.isin(state.spin, TURNS).all()


SCENES: dict[str, Pinned] = {
    "bare": Pinned(),
    "law reflect": Pinned(settings={"law": "reflect"}),
    "passes": Pinned(settings={"passes": 2}),
    "sub-steps": Pinned(settings={"substeps": 3}),
    "sub-steps where fast": Pinned(settings={"on_fast": "substep", "dt": 4 * DT}),
    "unguarded": Pinned(settings={"unguarded": True}),
    "discs added": Pinned(midway=_added(0.5, 6.5), acts=_entered(1)),
    "gravity": Pinned({"gravity": (0.375, -2.0)}),
    "acceleration": Pinned({"acceleration": PULLS}),
    "radii": Pinned({"radius": SIZES}),
    "giants": Pinned({"radius": GIANTS}),
    "masses": Pinned({"mass": MASSES}),
    "restitution": Pinned({"restitution": 0.75}),
    "contact time": Pinned({"restitution": 0.75}, {"contact_time": 0.25}),
    "wall restitution": Pinned({"wall_restitution": 0.5}),
    "periodic x": Pinned({"boundary": ("periodic", "walls")}, acts=_crossed(0)),
    "periodic y": Pinned({"boundary": ("walls", "periodic")}, acts=_crossed(1)),
    "periodic": Pinned({"boundary": "periodic"}, acts=_crossed(0, 1)),
    "fixed disc": Pinned({"obstacles": PEG}),
    "polyline": Pinned({"obstacles": FUNNEL}),
    "container": Pinned({"obstacles": Circle((4.0, 3.5), 4.75, inside=True), "gravity": (0.375, -2.0)}),
    "container that moves": Pinned(
        {
            "obstacles": Circle(
                (4.0, 3.5), 4.75, inside=True, surface_velocity=2.0, motion=Rotation((4.25, 3.5), rate=2.0)
            ),
            **ROUGH,
        },
        acts=_spun,
    ),
    "translation": Pinned({"obstacles": _moved(Translation((-2.0, -1.0), stop=0.75))}),
    "oscillation": Pinned({"obstacles": _moved(Oscillation((0.125, 0.5), period=0.375, phase=1.0, start=0.125))}),
    "rotation": Pinned({"obstacles": _moved(Rotation((6.9, 5.9), rate=-5.0, stop=4.0))}),
    "path": Pinned({"obstacles": _moved(Track([0.0, 0.25, 0.5], [(0, 0), (-0.5, -1), (0, 0.5)]))}),
    "moving, everything": Pinned(
        {
            **{name: EVERYTHING[name] for name in ("gravity", "radius", "mass", "boundary", "wall_restitution")},
            **ROUGH,
            "obstacles": [
                *_moved(Rotation((6.9, 5.9), rate=-5.0)),
                Polyline([(0.0, 6.9), (8.0, 6.9)], motion=Oscillation((0.25, 0.0625), period=0.375)),
                FixedDisc((7.5, 1.0), 0.25, surface_velocity=-2.0),
            ],
        },
        {"contact_time": 1 / 256},
        acts=_spun,
    ),
    "emitter by time": Pinned({"width": 11.0, "emitters": BY_TIME}, acts=_entered(3)),
    "emitter by frames": Pinned({"width": 11.0, "emitters": BY_FRAMES}, acts=_entered(3)),
    "absorbing left": _absorbing("left"),
    "absorbing right": _absorbing("right"),
    "absorbing bottom": _absorbing("bottom"),
    "absorbing top": _absorbing("top"),
    "piston left": _piston("left", 0.75, 1.0),
    "piston right": _piston("right", -1.0, 6.0, 7.75),
    "piston bottom": _piston("bottom", 0.25, 1.0),
    "piston top": _piston("top", -1.5, 5.5),
    "walls that run": Pinned(
        {"piston": [Piston("bottom", 0.25, 1.0, surface_velocity=2.0), Piston("left", surface_velocity=-1.5)], **ROUGH},
        acts=_spun,
    ),
    "emitter under gravity": Pinned({"width": 11.0, "emitters": BY_TIME, "gravity": (0.375, -2.0)}, acts=_entered(3)),
    "obstacles, periodic": Pinned(
        {"boundary": "periodic", "obstacles": [FUNNEL, FixedDisc((8.0, 3.0), 0.25)], "radius": SIZES, "mass": MASSES},
        acts=_crossed(0, 1),
    ),
    "everything": Pinned(
        EVERYTHING,
        {"substeps": 2, "passes": 2},
        _added(7.375, 0.625, radius=0.25, mass=2.0, acceleration=(1.0, 2.0)),
        _all_act,
    ),
    "everything exact": Pinned(
        {
            **{name: EVERYTHING[name] for name in ("gravity", "radius", "mass", "restitution", "wall_restitution")},
            "boundary": ("periodic", "walls"),
            "emitters": [
                Emitter(CORNER, (-3.0, -0.5), every=5, radius=0.5, mass=1.0),
                Emitter((0.625, 6.3125), (2.5, -0.25), interval=0.3, radius=0.375, mass=2.0),
            ],
        },
        midway=_added(7.25, 3.375, radius=0.375, mass=2.0),
        acts=lambda state: _crossed(0)(state) and len(state.position) > 34,
    ),
    "stream exact": Pinned(
        {
            **{name: EVERYTHING[name] for name in ("gravity", "radius", "mass", "restitution", "wall_restitution")},
            **{name: EVERYTHING[name] for name in ("boundary", "absorbing", "piston")},
            **ROUGH,
            "obstacles": [FixedDisc((7.5, 2.5), 0.25), Polyline([(3.5, 0.0), (4.0, 0.5)], 0.125)],
            "emitters": [Emitter((0.625, 6.3125), (2.5, 0.25), interval=0.3, limit=3, radius=0.375, mass=0.5)],
        },
        {"contact_time": 1 / 256},
        acts=lambda state: _spun(state) and not state.present.all() and len(state.position) > 30,
    ),
    "friction": Pinned({"friction": 0.5, "spin": TURNS}, acts=_spun),
    "friction of walls": Pinned({"wall_friction": 0.25, "tangential_restitution": 0.5}, acts=_spun),
    "everything rough": Pinned(
        {**EVERYTHING, **ROUGH},
        {"substeps": 2, "passes": 2},
        _added(7.375, 0.625, radius=0.25, mass=2.0, acceleration=(1.0, 2.0), spin=3.0),
        lambda state: _all_act(state) and _spun(state),
    ),
    "rough exact": Pinned(
        {
            **{name: EVERYTHING[name] for name in ("gravity", "radius", "mass", "restitution", "wall_restitution")},
            **ROUGH,
            "boundary": ("periodic", "walls"),
        },
        midway=_added(7.25, 3.375, radius=0.375, mass=2.0, spin=-2.0),
        acts=lambda state: _crossed(0)(state) and _spun(state),
    ),
    "thermostat": Pinned(
        {"thermostat": Thermostat(16.0, 0.5, seed=2**60 + 3), "mass": EVERYTHING["mass"]},
        {"substeps": 2},
        acts=lambda state: np.abs(state.velocity).max() > 6,
    ),
    "thermal walls": Pinned(
        {"thermal_walls": ThermalWalls(left=25.0, right=16.0, top=36.0, seed=5)},
        acts=lambda state: np.abs(state.velocity).max() > 4,
    ),
    "pistons in and out": Pinned(
        {
            "piston": [
                Piston("left", motion=Oscillation((0.25, 0), 0.75, phase=3 * np.pi / 2), start=0.25),
                Piston("top", motion=Track([0.25, 0.5, 1.25], [(0, 0), (0, -0.5), (0, 0)])),
                Piston("right", -0.25, 7.75),
            ],
        },
        acts=lambda state: state.box[:2] == (0.0, 7.75) and state.box[3] == 7.0,
    ),
}
"""By name. A periodic axis, a piston and so on are arrays of their own to the kernels."""


def methods(names: Iterable[str] = ("naive", "grid", "event")) -> dict[str, dict[str, Any]]:
    """Settings by their words, of a family of methods that need not have the same bits."""
    found: dict[str, dict[str, Any]] = {
        f"{method} {contact} {precision}": {"method": method, "contact": contact, "precision": precision}
        for method in names
        if method != "event"
        for contact, precision in KINDS
    }
    return found | ({"event": {"method": "event"}} if "event" in names else {})


OF_ITS_OWN = {"bare": 0, "periodic": 1, "giants": 2, "everything": 3, "everything rough": 1}
"""Scenes in which `naive` runs other code than in the bare one, or has other neighbours, and its kind in each."""

EXACT = {
    "bare", "giants", "periodic", "periodic y", "everything exact", "stream exact", "thermostat", "thermal walls",
    "absorbing left", "absorbing right", "absorbing top", "piston left", "piston right", "piston bottom",
    "law reflect", "acceleration", "unguarded", "everything", "everything rough", "moving, everything",
    "container", "container that moves", "pistons in and out",
}  # fmt: skip
"""Scenes that `event` refuses or plays by code, or with ends, that the two exact ones of many features lack."""


def few(name: str) -> dict[str, dict[str, Any]]:
    """The methods of a scene in the default suite: `grid` by all contacts and precisions where all features are, else
    by one of them.

    These change from scene to scene, so that all of them occur.
    """
    found, turn = methods(), list(SCENES).index(name)
    kinds = range(len(KINDS)) if name == "everything" else [turn + 2]
    words = [f"grid {' '.join(KINDS[kind % len(KINDS)])}" for kind in kinds]
    if name in OF_ITS_OWN:
        words.append(f"naive {' '.join(KINDS[OF_ITS_OWN[name]])}")
    return {word: found[word] for word in (*words, *(["event"] if name in EXACT else []))}


def ran(name: str, **how: Any) -> Ran | str:
    """A run of a scene, or why it is refused."""
    if how["method"] == "event":  # which alone refuses any of these scenes
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                SCENES[name].start(**how).close()
        except mpsim.InputError as error:
            return f"refused: {error}"
    return SCENES[name].run(**how)


def outcome(name: str, **how: Any) -> str:
    """Digest and contacts of a scene in words, or why it is refused."""
    return str(ran(name, **how))


def measured(name: str, method: str) -> dict[str, str]:
    """Digest and values of measures of a scene."""
    ran = SCENES[name].run(MEASURES, method=method)
    return {"outcome": str(ran), **ran.measures}


def report(choose: Callable[[str], dict[str, dict[str, Any]]]) -> dict[str, Any]:
    """What is pinned of these scenes by the methods chosen for each, and those in which a feature did not act."""
    found = {name: {words: ran(name, **how) for words, how in choose(name).items()} for name in SCENES}
    cases = [("bare", "grid"), ("gravity", "grid"), ("periodic", "grid"), ("everything", "grid"), ("bare", "event")]
    cases.append(("everything exact", "event"))
    return {
        "digests": {name: {words: str(run) for words, run in runs.items()} for name, runs in found.items()},
        "measures": {f"{name} by {method}": measured(name, method) for name, method in cases},
        "idle": [
            name
            for name, runs in found.items()
            if not all(SCENES[name].acts(run.state) for words, run in runs.items() if words.startswith("grid"))
        ],
    }


FILE = Path(__file__).parents[1] / "contracts" / "golden.json"


def pins() -> dict[str, Any]:
    """What is pinned."""
    return json.loads(FILE.read_text())


def renew(found: dict[str, Any]) -> None:
    """Pin what was found; what is not of it stays."""
    FILE.write_text(json.dumps(pins() | found, indent=2) + "\n")


def main() -> None:
    """Print the report, or digests of named scenes."""
    if names := [word for word in sys.argv[1:] if word in SCENES]:
        found: Any = {name: {words: outcome(name, **how) for words, how in few(name).items()} for name in names}
    else:
        found = report(few if "--few" in sys.argv else lambda name: methods())
    json.dump(found, sys.stdout, indent=2)


if __name__ == "__main__":
    main()
