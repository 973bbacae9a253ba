"""The settings that a trade-off study compares by default."""

from dataclasses import replace

from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

STEP_FRACTIONS = (0.2, 0.1, 0.05, 0.02, 0.01)
"""Steps of the default candidates, in units of the time in which a disc at typical speed moves one diameter."""


def step(scene: Scene, speed: float, h: float) -> float:
    """dt for h = dt x speed / smallest diameter, rounded to two digits [time]."""
    return float(f"{h * 2 * scene.smallest_radius / speed:.2g}")


def families(dt: float = 0.01) -> list[Settings]:
    """Families of stepped settings that are useful at any step: one of each contact, and a second pass."""
    fine = Settings(dt=dt)
    return [fine, replace(fine, passes=2), replace(fine, contact="push")]


def default_candidates(scene: Scene, speed: float, contact_time: float | None = None) -> list[Settings]:
    """The exact solver, each family over STEP_FRACTIONS, and rows for law, precision, substeps and method.

    Args:
        scene: to be run.
        speed: root mean square of one velocity component [length/time].
        contact_time: of the exact solver [time].
    """
    steps = [step(scene, speed, h) for h in STEP_FRACTIONS]
    candidates = [Settings(method="event", contact_time=contact_time)]
    candidates += [replace(family, dt=dt) for family in families() for dt in steps]
    middle = Settings(dt=steps[2])
    candidates += [
        replace(middle, precision="float32"),
        replace(middle, precision="float32", dt=steps[-1]),
        replace(middle, law="reflect", contact="push"),
        replace(middle, dt=2 * middle.dt, substeps=2),
        replace(middle, method="naive"),
        replace(middle, method="grid"),
        replace(middle, method="parallel"),
    ]
    return [each for each in candidates if not (each.method == "naive" and scene.count > NAIVE_UP_TO)]


NAIVE_UP_TO = 3000
"""Number of discs above which testing all pairs is left out: it would take longer than all other rows together."""
