"""Compares frame times of three scenes with an earlier version; fails if one is much slower three times in a row.

python scripts/check_speed.py                       against the commit before
python scripts/check_speed.py --before REVISION

Both versions are timed in turns, each time in a process of its own, so that other load falls on both. Ratios are always
printed. Only scenes that were slower by a factor of LOSS are timed again, so a slow turn alone is no loss. Where the
revision is not there, as in a clone of one commit, or cannot run these scenes, it says so and passes.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import feature_cost

from mpsim.errors import InputError

SCENES = {
    "bare, grid": {"method": "grid", "precision": "float32"},
    "bare, 2 workers": {"method": "parallel", "workers": 2, "precision": "float32"},
    "friction and gravity": {
        "method": "grid",
        "precision": "float64",
        "features": {"gravity": (0.0, -1.0), "restitution": 0.6, "friction": 0.5, "wall_friction": 0.5},
    },
}
"""10,000 discs, packing 0.4. Each has kernels that the default tests have compiled: of the bare scene, and those of the
named scene rough-sediment."""

LOSS = 1.3
"""Time of a frame over that of the earlier version from which on it counts as a loss."""

TURNS = 3
"""Turns in each of which a scene must have lost, for the check to fail."""

TIMER = """
import json
import warnings
import numpy as np
import mpsim
warnings.simplefilter("ignore")
rng = np.random.default_rng(1)
places = (np.arange({side}) + 0.5) * {pitch}
position = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
velocity = rng.normal(size=position.shape)
found = {{}}
for name, settings in json.loads({scenes!r}).items():
    features = settings.pop("features", {{}})
    scene = mpsim.Scene(width={side} * {pitch}, height={side} * {pitch}, position=position, velocity=velocity,
                        radius=0.5, **features)
    with mpsim.Simulation(scene, mpsim.Settings(dt={dt}, **settings)) as sim:
        sim.run(frames={warm_up})
        medians = [float(np.median(sim.run(frames={frames}).frame_seconds)) for _ in range({rounds})]
    found[name] = min(medians) / scene.count * 1e9
print(json.dumps(found))
"""
"""Prints nanoseconds per disc and frame of scenes: the least of several medians, as other load only adds to it."""


def timer_of(names: Sequence[str]) -> str:
    """The script that times scenes of these names."""
    return TIMER.format(
        side=feature_cost.SIDE,
        pitch=feature_cost.PITCH,
        dt=feature_cost.DT,
        warm_up=feature_cost.WARM_UP,
        frames=feature_cost.FRAMES,
        rounds=feature_cost.ROUNDS,
        scenes=json.dumps({name: SCENES[name] for name in names}),
    )


Costs = dict[str, float]
"""Nanoseconds per disc and frame, by the name of the scene."""


def confirmed_losses(
    time_turn: Callable[[int, Sequence[str]], tuple[Costs, Costs]], say: Callable[[str], None]
) -> list[str]:
    """Names of the scenes that have lost in each of TURNS turns; every ratio is said.

    Args:
        time_turn: costs here and before, of scenes of these names, in a turn of this number.
        say: called with each line.
    """
    suspects = list(SCENES)
    for turn in range(TURNS):
        here, before = time_turn(turn, suspects)
        for name in suspects:
            ratio = here[name] / before[name]
            say(f"turn {turn + 1}: {name}: {here[name]:.2f} ns per disc and frame, {ratio:.2f} of {before[name]:.2f}")
        suspects = [name for name in suspects if here[name] / before[name] >= LOSS]
        if not suspects:
            break
    return suspects


def compare(here: Path, there: Path, say: Callable[[str], None]) -> list[str]:
    """`confirmed_losses` of one checkout against another."""

    def time_turn(turn: int, names: Sequence[str]) -> tuple[Costs, Costs]:
        printed = feature_cost.one_turn(timer_of(names), here, there, turn)
        return json.loads(printed[0]), json.loads(printed[1])

    return confirmed_losses(time_turn, say)


def check(here: Path, revision: str, say: Callable[[str], None]) -> int:
    """Exit code: 1 where a scene has lost for certain."""
    try:
        with feature_cost.checkout_of(revision) as there:
            losses = compare(here, there, say)
    except InputError as error:
        say(f"nothing to compare with: {error}")
        return 0
    except feature_cost.OtherVersionError as error:
        say(f"nothing to compare with: {revision} cannot run these scenes: {str(error).splitlines()[-1]}")
        return 0
    for name in losses:
        say(f"{name}: slower by {LOSS} or more than {revision} in {TURNS} turns out of {TURNS}.")
    return 1 if losses else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", default="HEAD~1", metavar="REVISION", help="default: HEAD~1, the commit before")
    return check(feature_cost.TOP, parser.parse_args().before, print)


if __name__ == "__main__":
    sys.exit(main())
