"""Compares the exact solver with published numbers, with chi^2: the tables of docs/validation.md.

python scripts/run_validation.py                   some twenty minutes of one core
python scripts/run_validation.py --quick           half a minute, with errors ten times as large
python scripts/run_validation.py --only haff two   some groups of rows; the others stay as they were

Groups: dense (pressures of Li et al. 2022), state (equation of state), two (two discs in a box), haff (cooling), motion
(velocity autocorrelation and diffusion). Rows go to --out as soon as a group is done.
"""

import dataclasses
import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import harness
import numpy as np
from harness import DOCS, exit_code, fill_page, made_by, parser_of, say
from numpy.polynomial.hermite_e import hermegauss
from numpy.polynomial.laguerre import laggauss
from numpy.typing import NDArray

import mpsim
from mpsim.measure import Measure, independent_average, kinetic_energy, reference
from mpsim.scene.settings import MethodName
from mpsim.studies.findings import haff_rate

FAR = 5.0
"""Standard errors by which a control must be off."""

QUICK = 0.01


# --- expected numbers: kinetic theory, corrections for few discs, chi^2
#
# Discs have mass 1, diameter 1 and mean square 1 of one velocity component, unless a row says otherwise; periodic boxes
# are at rest.

Floats = NDArray[np.float64]

VIRIAL_ERRORS = (0.0, 0.0, 0.0, 1e-8, 4.2e-6, 4.3e-6, 3.4e-6, 3.5e-6, 8.0e-6)
"""Standard errors of reference.VIRIAL, from the same table."""

SONINE = 8
"""Polynomials in which distributions of velocities are expanded; the diffusion constant then has six digits."""


def compressibility(virial: Floats, packing: float, top: int) -> float:
    """Z by the [top / 9 - top] Pade approximant of a series."""
    above, below = reference.pade(virial.tolist(), top)
    return float(np.polyval(above[::-1], 2 * packing) / np.polyval(below[::-1], 2 * packing))


def bulk(packing: float) -> Measure:
    """Z of infinitely many discs from nine virial coefficients.

    Its error has a part from that of each coefficient, and the difference of the [4/5] and [5/4] approximants for the
    coefficients that are not known.
    """
    virial = np.array(reference.VIRIAL)
    value = compressibility(virial, packing, 4)
    parts = [value - compressibility(virial, packing, 5)]
    for index, error in enumerate(VIRIAL_ERRORS):
        other = virial.copy()
        other[index] += error
        parts.append(compressibility(other, packing, 4) - value)
    return Measure(value, float(np.linalg.norm(parts)), 1)


def third_moment(degrees: int) -> float:
    """Mean |u|^3 of one velocity component at fixed energy of so many degrees of freedom, over that of a Maxwellian."""
    half = degrees / 2
    return math.exp(1.5 * math.log(half) + math.lgamma(half) - math.lgamma(half + 1.5))


def transfer_rate(packing: float, count: int) -> float:
    """-d ln <v(t).v(0)> / dt at t = 0 in a periodic gas of N discs at rest [1/time].

    Enskog's collision rate, which is exact at this order; for N discs the density at contact is that of Z_N, and
    relative velocities have the third moment of a fixed energy.
    """
    temperature, bulk_part = count / (count - 1), reference.compressibility(packing) - 1
    contact = 1 + reference.finite_size(packing, count) / bulk_part
    return reference.enskog_rate(packing) * temperature**1.5 * third_moment(2 * (count - 1)) * contact


def collision_operator() -> Floats:
    """How collisions with a Maxwell gas change the velocity of one disc, in units of the collision rate.

    Matrix of the linearised Enskog operator between the functions v L_k^(1)(v^2 / 2), normalised; shape (SONINE,
    SONINE). In a collision equal discs exchange their components along the line of centres (a, b), and c is kept. With
    s = (a - b)/sqrt(2), the rate is proportional to |s|.
    """
    s2, s_weight = laggauss(2 * SONINE + 2)
    nodes, weights = hermegauss(2 * SONINE + 2)
    s = np.sqrt(2 * s2)[:, None, None]
    mean, c = nodes[None, :, None], nodes[None, None, :]
    a, b = (mean + s) / math.sqrt(2), (mean - s) / math.sqrt(2)
    weight = s_weight[:, None, None] * weights[None, :, None] * weights[None, None, :]
    weight = weight / weight.sum()
    before, after = (_sonine((x * x + c * c) / 2) for x in (a, b))
    along, across = before * a - after * b, (before - after) * c
    found = sum(np.einsum("iabc,jabc,abc->ij", part, part, weight) for part in (along, across))
    norm = np.sqrt(2.0 * np.arange(1, SONINE + 1))
    return found / 2 / np.outer(norm, norm)


def _sonine(x: Floats) -> Floats:
    """L_k^(1)(x) for k < SONINE, one more axis in front."""
    found = [np.ones_like(x), 2 - x]
    for k in range(1, SONINE - 1):
        found.append(((2 * k + 2 - x) * found[k] - (k + 1) * found[k - 1]) / (k + 1))
    return np.array(found)


def decay(collisions: float) -> float:
    """<v(t).v(0)> / <v^2> after so many collisions per disc in a dilute gas, by Boltzmann's equation."""
    rates, vectors = np.linalg.eigh(collision_operator())
    return float((vectors[0] ** 2 * np.exp(-rates * collisions)).sum())


def diffusion_factor() -> float:
    """Diffusion constant of a dilute gas over that of first Sonine order."""
    return float(np.linalg.inv(collision_operator())[0, 0])


def chi2_probability(chi2: float, degrees: int) -> float:
    """Probability that chi^2 of so many degrees of freedom is at least as large.

    >>> round(chi2_probability(3.841, 1), 3), round(chi2_probability(18.307, 10), 3)
    (0.05, 0.05)
    """
    half, term = chi2 / 2, degrees % 2 / 2
    found = math.erfc(math.sqrt(half)) if degrees % 2 else 0.0
    while term < degrees / 2:
        found += math.exp(-half + (term * math.log(half) if term else 0.0) - math.lgamma(term + 1))
        term += 1
    return found


# --- rows: each has an expected number and one found by the exact solver

LI = "Li 2022"
SHAPES = {
    "1 : 1": 1.0,
    "1 : √3/2": math.sqrt(3) / 2,
    "9 : 8√3/2": 8 * math.sqrt(3) / 2 / 9,
    "29 : 30√3/2": 30 * math.sqrt(3) / 2 / 29,
}
"""Width : height of the boxes, and height over width."""

PRESSURES: dict[tuple[int, str, float], tuple[float, float]] = {
    (72, "1 : 1", 0.65): (6.901074, 7.1e-5),
    (72, "1 : 1", 0.68): (8.23631, 34e-5),
    (72, "1 : 1", 0.70): (8.55170, 59e-5),
    (72, "1 : √3/2", 0.65): (6.945931, 6.6e-5),
    (72, "1 : √3/2", 0.70): (9.48035, 18e-5),
    (72, "9 : 8√3/2", 0.65): (6.895819, 4.4e-5),
    (72, "9 : 8√3/2", 0.70): (8.21941, 99e-5),
    (224, "1 : 1", 0.67): (7.979479, 5.8e-5),
    (870, "1 : 1", 0.67): (7.986779, 2.5e-5),
    (870, "1 : 1", 0.68): (8.513249, 3.7e-5),
    (870, "29 : 30√3/2", 0.67): (7.986735, 2.6e-5),
    (870, "29 : 30√3/2", 0.68): (8.513233, 3.7e-5),
}
"""P sigma^2 / kT by discs, box and packing, with standard errors: event-chain Monte Carlo of Li, Nishikawa, Hollmer,
Carillo, Maggs and Krauth (J. Chem. Phys. 157, 234111, 2022), from the table in their data repository."""

DENSER = (6.996291, 8.9e-5)
"""Of 72 discs in a square box at packing 0.652, from the same table."""

COLLISIONS = {72: 1e8, 224: 1e8, 870: 2e8}
"""In the runs of one pressure, by the number of discs."""

STARTS = 4
PACKINGS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
COUNT = 1024
"""Discs in the equation of state."""


@dataclass(frozen=True)
class Row:
    """A number as expected and as found. A control is a number that is wrong, which must be far from what is found."""

    what: str
    source: str
    expected: Measure
    found: Measure
    control: bool = False

    @property
    def deviation(self) -> float:
        """In standard errors of the difference."""
        return (self.found.value - self.expected.value) / math.hypot(self.found.error, self.expected.error)


Rows = Iterator[Row]


def known(value: float, error: float = 0.0) -> Measure:
    """An expected number."""
    return Measure(value, error, 1)


def combined(each: list[Measure]) -> Measure:
    """Mean of runs of equal length; settled if all are."""
    error = math.sqrt(sum(one.error**2 for one in each)) / len(each)
    settled = all(one.settled for one in each)
    return Measure(float(np.mean([one.value for one in each])), error, len(each), settled)


def pressure(
    count: int, packing: float, shape: float, collisions: float, method: MethodName = "event", step: float = 0.0
) -> Measure:
    """P sigma^2 / kT of a periodic gas at rest, over runs with so many collisions in all.

    mpsim's pressure in such a box is kT / area below that of a canonical ensemble, and kT is E / (N - 1).
    """
    width = math.sqrt(count * math.pi / 4 / packing / shape)
    height, temperature = shape * width, count / (count - 1)
    rate = reference.enskog_rate(min(packing, reference.LARGEST_PACKING))
    settings = mpsim.Settings(dt=step or 20 / rate, method=method, workers=1)
    frames = max(round(2 * collisions / STARTS / count / rate / settings.dt), 64)
    found = []
    for seed in range(STARTS):
        scene = mpsim.Scene.lattice(count=count, radius=0.5, width=width, height=height, seed=seed, boundary="periodic")
        with mpsim.Simulation(scene, settings) as sim:
            sim.run(frames=frames // 8)
            found.append(sim.run(frames=frames, measures=["pressure"]).measures["pressure"])
    mean = combined(found)
    value = mean.value / temperature + 1 / (width * height)
    return Measure(value, mean.error / temperature, mean.samples, mean.settled)


def dense(share: float) -> Rows:
    """Pressures of Li and others, and what is not theirs."""
    found = {key: pressure(key[0], key[2], SHAPES[key[1]], share * COLLISIONS[key[0]]) for key in PRESSURES}
    for (count, shape, packing), published in PRESSURES.items():
        what = f"P (2R)²/kT, {count} discs, box {shape}, packing {packing}"
        yield Row(what, LI, known(*published), found[count, shape, packing])
    square, published = found[72, "1 : 1", 0.65], known(*PRESSURES[72, "1 : 1", 0.65])
    yield Row("72 discs at packing 0.65, as if published for 0.652", LI, known(*DENSER), square, control=True)
    other = known(*PRESSURES[72, "1 : √3/2", 0.65])
    yield Row("box 1 : 1, as if published for 1 : √3/2", LI, other, square, control=True)
    area = 4 * 0.65 / math.pi / 72
    naive = Measure((square.value - 72 * area) * 71 / 72 + 72 * area, square.error, STARTS)
    yield Row("kT = E/N in place of E/(N - 1)", LI, published, naive, control=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.FastWarning)  # the step is too long: that is the control
        stepped = pressure(72, 0.65, 1.0, share * 2e6, "grid", 0.02)
    yield Row("method `grid`, steps of 0.02 (2R)/√kT", LI, published, stepped, control=True)


def state(share: float) -> Rows:
    """The equation of state, with the correction for 1,024 discs."""
    for packing in PACKINGS:
        scale = math.pi / 4 / packing
        one = pressure(COUNT, packing, 1.0, share * 1e8)
        found = Measure(one.value * scale, one.error * scale, one.samples, one.settled)
        infinite, shift = bulk(packing), reference.finite_size(packing, COUNT)
        expected = known(infinite.value + shift, math.hypot(infinite.error, shift**2))
        yield Row(f"Z, {COUNT} discs, packing {packing}", "virial series", expected, found)
        if packing == 0.3:
            what = f"Z at {packing} without the correction for {COUNT} discs"
            yield Row(what, "virial series", infinite, found, control=True)


def two_discs(share: float) -> Rows:
    """Two discs in a box: closed forms."""
    exact, found = reference.two_discs(1, 1, 0.2, energy=2), {}
    for name, seeds in (("pressure", range(24)), ("collision_rate", range(24, 48))):
        values = []
        for seed in seeds:
            with mpsim.Simulation(pair_in_a_box(seed), mpsim.Settings(dt=1.0, method="event", workers=1)) as sim:
                values.append(sim.run(frames=max(round(share * 20_000), 64), measures=[name]).measures[name].value)
        found[name] = independent_average(values)
    force, rate = found["pressure"], found["collision_rate"]
    yield Row("force on a wall, two discs of radius 0.2 in 1 x 1", "phase space", known(exact.force_x), force)
    yield Row("collisions per time, two discs of radius 0.2 in 1 x 1", "phase space", known(exact.pair_rate), rate)
    wider = reference.two_discs(1.01, 1.0, 0.2, energy=2)
    yield Row("force on a wall of a box 1.01 wide", "phase space", known(wider.force_x), force, control=True)


def pair_in_a_box(seed: int) -> mpsim.Scene:
    """Two discs with energy 2 and a total momentum: opposite velocities of equal size would be a special start."""
    placed = mpsim.Scene.random(count=2, width=1, height=1, radius=0.2, seed=seed)
    velocity = np.random.default_rng(seed).normal(size=(2, 2))
    velocity *= 2 / np.linalg.norm(velocity)
    return mpsim.Scene(width=1, height=1, radius=0.2, position=placed.position, velocity=velocity)


def haff(share: float) -> Rows:
    """How fast granular gases cool: the slope of 1/sqrt(T), from five collisions per disc on."""
    packing, starts = 0.05, max(round(share * 64), 8)
    nu = reference.enskog_rate(packing)
    for restitution, count, until in ((0.99, 1024, 105.0), (0.95, 256, 25.0)):
        values = []
        for seed in range(starts):
            gas: Any = {"count": count, "packing": packing, "radius": 0.5, "boundary": "periodic"}
            scene = mpsim.Scene.random(seed=seed, restitution=restitution, **gas)
            settings = mpsim.Settings(dt=5 / nu, method="event", workers=1)
            with warnings.catch_warnings(), mpsim.Simulation(scene, settings) as sim:
                roots = []
                warnings.simplefilter("ignore", mpsim.errors.GuardWarning)  # one contact in millions
                for time in (5 / nu, max(share, 0.4) * until / nu):
                    sim.run(until=time)
                    roots.append((sim.time, math.sqrt(count / kinetic_energy(sim.state, scene))))
            values.append((roots[1][1] - roots[0][1]) / (roots[1][0] - roots[0][0]))
        found = independent_average(values)
        what = f"d(T^-1/2)/dt, {count} discs, restitution {restitution}, packing {packing}"
        rate = transfer_rate(packing, count)  # so that what is expected is d(T^-1/2)/dt where T is 1
        yield Row(what, "Haff 1983", known(haff_rate(rate, restitution)), found)
        if restitution == 0.99:
            other = haff_rate(rate, 0.989)
            yield Row("the same for restitution 0.989", "Haff 1983", known(other), found, control=True)


def correlations(packing: float, every: float, samples: float, seed: int = 0) -> mpsim.Correlations:
    """Averages over n samples, one each `every` mean free times."""
    scene = mpsim.Scene.random(count=COUNT, packing=packing, radius=0.5, seed=seed, boundary="periodic")
    step = every / reference.enskog_rate(packing)
    found = mpsim.Correlations()
    with mpsim.Simulation(scene, mpsim.Settings(dt=step, method="event", workers=1)) as sim:
        sim.run(frames=math.ceil(20 / every))
        sim.run(frames=max(round(samples), 100), observe=found)
    return found


def motion(share: float) -> Rows:
    """Velocity autocorrelation and diffusion constant."""
    for packing in (0.1, 0.3, 0.5):
        short = 0.02
        velocity = correlations(packing, short, share * 3e4).velocity
        rate, lag, start = transfer_rate(packing, COUNT), velocity.lag[1], velocity[0].value
        found = Measure((1 - velocity[1].value / start) / lag, velocity[1].error / start / lag, 1, velocity[1].settled)
        curved = (1 - decay(short)) / short
        expected = known(rate * curved, rate * 0.1 * (1 - curved))
        yield Row(f"(1 - <v(t)·v>/<v²>)/t after {short} mean free times, packing {packing}", "Enskog", expected, found)
        if packing == 0.3:
            wrong = known(1.02 * expected.value, expected.error)
            yield Row("the same, with 2 % more collisions", "Enskog", wrong, found, control=True)
    dilute = 0.005
    velocity = correlations(dilute, 0.2, share * 2e4, seed=1).velocity
    start, later = velocity[0].value, velocity[5]
    ratio = Measure(later.value / start, later.error / start, 1, later.settled)
    decayed = known(decay(velocity.lag[5] * transfer_rate(dilute, COUNT)))
    yield Row(f"<v(t)·v>/<v²> after one mean free time, packing {dilute}", "Boltzmann", decayed, ratio)
    yield Row("the same, as one exponential", "Boltzmann", known(math.exp(-1.0)), ratio, control=True)
    constant = correlations(dilute, 0.2, share * 4e4, seed=2).diffusion()
    first = reference.enskog_diffusion(dilute)
    tail = 1 / (8 * math.pi * 4 * dilute / math.pi * 2 * first)
    expected = known(first * diffusion_factor(), tail)
    yield Row(f"diffusion constant, packing {dilute}", "Boltzmann", expected, constant)


GROUPS: dict[str, Callable[[float], Rows]] = {
    "dense": dense, "state": state, "two": two_discs, "haff": haff, "motion": motion,
}  # fmt: skip
"""By the name of the command line."""


# --- tables


def measured(names: list[str], share: float, out: Path) -> tuple[dict[str, list[Row]], float]:
    """Rows by group: those that are measured now, and those that the file has of the others; time for all [s]."""
    kept = json.loads(out.read_text()) if out.exists() else {}
    out.parent.mkdir(parents=True, exist_ok=True)
    for name in names:
        began = time.process_time()
        rows = list(GROUPS[name](share))
        kept[name] = {"rows": list(map(dataclasses.asdict, rows)), "seconds": time.process_time() - began}
        out.write_text(json.dumps(kept, indent=1))
        say(table(rows))
    groups = {name: [row_of(row) for row in kept[name]["rows"]] for name in GROUPS if name in kept}
    return groups, sum(kept[name]["seconds"] for name in groups)


def row_of(values: dict) -> Row:
    """From the file."""
    expected, found = Measure(**values["expected"]), Measure(**values["found"])
    return Row(**{**values, "expected": expected, "found": found})


def table(rows: list[Row]) -> str:
    """Markdown, a line for each."""
    cells = []
    for row in rows:
        expected = row.expected if row.expected.error else f"{row.expected.value:.6g}"
        cells.append((row.what, row.source, expected, row.found, f"{row.deviation:+.1f}"))
    return harness.table(("", "source", "expected", "found", "deviation"), cells, right=1)


def summary(rows: list[Row]) -> str:
    """chi^2 of the settled rows, and how near the nearest control is."""
    settled = [row for row in rows if row.found.settled and not row.control]
    chi2 = sum(row.deviation**2 for row in settled)
    left = sum(not row.control for row in rows) - len(settled)
    probability = chi2_probability(chi2, len(settled))
    words = (
        f"χ² = {chi2:.1f} for {len(settled)} rows; probability of a larger one: {probability:.2g}. "
        f"The largest deviation is {max(abs(row.deviation) for row in settled):.1f} standard errors."
    )
    if left:
        words += f" Left out because their errors are not settled: {left}."
    controls = [abs(row.deviation) for row in rows if row.control]
    if controls:
        far = sum(each > FAR for each in controls)
        words += f" Controls that deviate by more than {FAR:g}: {far} of {len(controls)}."
    return words


def main() -> None:
    """Measure, and write the tables into the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), metavar="GROUP")
    parser.add_argument("--out", type=Path, default=Path("results/validation/rows.json"))
    parser.add_argument("--page", type=Path, help="default: docs/validation.md; of --quick none")
    options = parser.parse_args()
    groups, seconds = measured(options.only, QUICK if options.quick else 1.0, options.out)
    rows = [row for group in groups.values() for row in group]
    words = f"{summary(rows)}\n\n{made_by()} It took {math.ceil(seconds / 60)} minutes of one core."
    say(words)
    page = options.page or (None if options.quick else DOCS / "validation.md")
    if page is not None:
        blocks = {"controls": table([row for row in rows if row.control]), "summary": words}
        blocks |= {name: table([row for row in group if not row.control]) for name, group in groups.items()}
        fill_page(page, blocks)


if __name__ == "__main__":
    sys.exit(exit_code(main))
