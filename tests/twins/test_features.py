"""Features of a scene, alone and all together: every method does, bit for bit, what the slow obvious twins say.

Each set of features is a compilation of its own, some ten seconds. So alone they run as plain Python here, which
test_plain_python_is_compiled ties to the machine code; with --long each runs compiled.
"""

import itertools
import warnings

import numpy as np
import pytest
from support.anything import anything
from support.compare import assert_parallel_is_grid, assert_same_bits
from support.internals import scramble
from support.processes import assert_clean, run_script
from support.scenes import ZOO, simulate, state_after, zoo
from support.selection import long_but
from support.twins import Twin, assert_is_its_twin

import mpsim

EVERYTHING = ZOO["everything"]
PRECISIONS = ("float64", "float32")
CONTACTS = ("impact", "push")

pytestmark = [
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings(
        "ignore::mpsim.FastWarning"
    ),  # of the tail of the speeds, and of discs dropped on others
]


def check_twin(name, method, precision, contact, count=24, frames=12):
    """One scene of the zoo; returns how many contacts, absorbed discs and entered discs it had."""
    scene = zoo(ZOO[name], count, seed=1)
    settings = {"method": method, "precision": precision, "contact": contact, "dt": 0.05}
    twin = assert_is_its_twin(scene, frames, name, **settings)
    assert twin.contacts > 10, f"{name}: {twin.contacts} contacts test little"
    if scene.absorbing:
        assert twin.gone.sum() >= 2, f"{name}: {twin.gone.sum()} discs left, which tests little"
    if scene.emitters:
        assert len(twin.p) > count, f"{name}: nothing entered"


def check_anything(first, last):
    """Random scenes: the bits of the twin, and every disc finite and inside. Returns the number of contacts."""
    contacts = 0
    for seed in range(first, last):
        scene, settings = anything(seed)
        contacts += assert_is_its_twin(scene, 6, f"scene {seed}, {scene}", **settings).contacts
    return contacts


def check_all_as_they_are():
    """What runs as plain Python: all features alone, and random ones."""
    for kind in (mpsim.errors.EmitterWarning, mpsim.FastWarning):
        warnings.simplefilter("ignore", kind)
    for name, method, precision, contact in itertools.product(ZOO, ("naive", "grid"), PRECISIONS, CONTACTS):
        check_twin(name, method, precision, contact)
    print(check_anything(0, 60))


@pytest.mark.slow
def test_each_feature_alone_and_any_of_them_together_are_what_the_slow_twin_says():
    outcome = run_script(
        "from twins.test_features import check_all_as_they_are; check_all_as_they_are()",
        env={"NUMBA_DISABLE_JIT": "1"},
        bound=120,
    )
    assert_clean(outcome)
    assert int(outcome.out) > 800, "too few contacts to show anything"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "precision"),
    [
        pytest.param("naive", "float64", marks=pytest.mark.long),
        ("grid", "float64"),
        pytest.param("grid", "float32", marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("contact", CONTACTS)
def test_all_features_together_are_what_the_slow_twin_says_compiled(method, precision, contact):
    check_twin("everything", method, precision, contact, count=40, frames=30)


@pytest.mark.long
@pytest.mark.parametrize("method", ["naive", "grid"])
@pytest.mark.parametrize("contact", CONTACTS)
def test_giants_in_a_periodic_box_are_what_the_slow_twin_says_compiled(method, contact):
    scene = zoo("giants periodic", 30, seed=2)
    settings = {"method": method, "contact": contact, "dt": 0.05}
    assert assert_is_its_twin(scene, 30, "giants", **settings).contacts > 100


@pytest.mark.long
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method", ["naive", "grid"])
@pytest.mark.parametrize("name", ZOO)
def test_each_feature_alone_is_what_the_slow_twin_says_compiled(name, method, precision):
    for contact in CONTACTS:
        check_twin(name, method, precision, contact)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_any_features_are_what_the_slow_twin_says_in_thousands_of_scenes():
    text = """
    import warnings
    warnings.simplefilter("ignore")
    from twins.test_features import check_anything
    check_anything(300, 8000)
    """
    assert_clean(run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=500))


def check_that_wrong_friction_is_seen():
    """A twin whose contacts stick a millionth too much, of discs or of walls."""
    scene = zoo(ZOO["rough and gravity"], 24, seed=1)
    settings = {"method": "grid", "contact": "impact", "dt": 0.05}
    for law in ("friction", "wall_friction"):
        twin = Twin(scene, **settings)
        coefficient, sticking = getattr(twin, law)
        setattr(twin, law, (coefficient, sticking * (1 + 1e-6)))
        twin.run(12)
        with pytest.raises(AssertionError, match="discs differ"):
            assert_same_bits(state_after(scene, 12, **settings), twin.state, law)


def test_a_twin_with_wrong_friction_is_seen():
    """The control."""
    text = "from twins.test_features import *; check_that_wrong_friction_is_seen()"
    assert_clean(run_script(text, env={"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}, bound=60))


PLAIN = """
import warnings
warnings.simplefilter("ignore")
from support.scenes import digest_after, zoo
for seed in range({seeds}):
    scene = zoo({words!r}, 24, seed=seed)
    for precision in ("float64", "float32"):
        for contact in ("impact", "push"):
            print(digest_after(scene, 12, method="grid", precision=precision, contact=contact, dt=0.05))
"""


@pytest.mark.timeout(400)
@pytest.mark.parametrize("seeds", long_but([1, 3]))
def test_plain_python_is_compiled(seeds):
    text = PLAIN.format(words=ZOO["everything rough"], seeds=seeds)
    outcomes = [run_script(text, env={"NUMBA_DISABLE_JIT": flag}, bound=180) for flag in ("0", "1")]
    assert all(outcome.code == 0 for outcome in outcomes), outcomes[1].err
    compiled, plain = (outcome.out.split() for outcome in outcomes)
    assert plain == compiled
    assert len(set(compiled)) == 4 * seeds, "the cases hardly differ: they test little"


# --- workers


@pytest.mark.slow
@pytest.mark.parametrize("contact", long_but(CONTACTS, "impact"))
def test_workers_do_not_change_all_features_together(contact):
    assert_parallel_is_grid(zoo(EVERYTHING, 500, seed=3, side=24.0), contact=contact)


@pytest.mark.long
@pytest.mark.parametrize("side", [6.0, 6.1, 9.5, 20.0, 21.0])
def test_workers_do_not_change_giants_in_periodic_boxes_of_any_number_of_columns(side):
    """6 is exactly two diameters of a giant; odd numbers of columns are made even."""
    assert_parallel_is_grid(zoo("giants periodic", int(side**2), seed=4, side=side), contact="impact")


@pytest.mark.long
def test_workers_do_not_change_giants_on_borders_and_corners():
    side = 12.0
    scene = zoo("giants periodic", 150, seed=5, side=side)
    for corner in ([0, 0], [side, side / 2], [side / 2, 0], [1e-9, side - 1e-9]):
        position = scene.position.copy()
        position[0] = corner
        there = scene.starting_from(mpsim.State(position, scene.velocity))
        assert_parallel_is_grid(there, workers=(2, 3), contact="impact")
        assert assert_is_its_twin(there, 10, f"giant at {corner}", method="grid", dt=0.03).contacts > 50


@pytest.mark.slow
@pytest.mark.parametrize("until", [0.5, 3.0])
def test_a_piston_that_starts_inside_is_what_the_slow_twin_says(until):
    """On its way (0.75 in 0.5), and arrived."""
    scene = zoo("piston lossy")
    with simulate(scene, method="grid", dt=0.03) as sim:
        sim.run(until=until)
        there = scene.starting_from(sim.state)
    assert there.piston.start == (8 - 1.5 * 0.51 if until == 0.5 else 6.4)
    for contact in CONTACTS:
        assert assert_is_its_twin(there, 15, f"start {until}", method="grid", contact=contact, dt=0.03).contacts > 20


NARROW = [(2.0, 40.0), (40.0, 2.0), (2.0, 2.0), (3.0, 3.0), (5.0, 2.5)]


@pytest.mark.long
@pytest.mark.parametrize(("width", "height"), NARROW)
def test_periodic_boxes_of_two_columns_or_rows_are_what_the_slow_twin_says(width, height):
    """Two diameters are the least; discs then meet each other from both sides."""
    rng = np.random.default_rng(6)
    count = int(width * height)
    radius = np.where(np.arange(count) % 2, 0.5, 0.4)
    places = rng.random((count, 2)) * [width, height]
    scene = mpsim.Scene(
        width=width, height=height, position=places, velocity=rng.normal(size=(count, 2)), radius=radius,
        boundary="periodic",
    )  # fmt: skip
    for contact in CONTACTS:
        twin = assert_is_its_twin(scene, 15, f"{width} x {height}", method="grid", contact=contact, dt=0.05)
        assert twin.contacts > 3
    assert_parallel_is_grid(scene, workers=(2, 3), contact="impact")


@pytest.mark.long
@pytest.mark.parametrize("name", ZOO)
def test_workers_do_not_change_each_feature_alone(name):
    assert_parallel_is_grid(zoo(ZOO[name], 400, seed=7, side=22.0), contact="impact")


# --- slices, memory order, growth


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(["naive", "grid"], "grid"))
def test_a_run_in_pieces_has_the_bits_of_one_run_with_all_features(method):
    scene, settings = zoo(EVERYTHING, 60, seed=8, side=10.0), {"method": method, "contact": "impact", "dt": 0.03}
    with simulate(scene, **settings) as whole, simulate(scene, **settings) as cut:
        whole.run(frames=40)
        for frames in (1, 2, 0, 7, 1, 1, 20, 8):
            cut.run(frames=frames)
        assert_same_bits(cut.state, whole.state, "in pieces")
        assert whole.count > 60
        assert whole.absorbed.any()
        assert cut.absorbed.tolist() == whole.absorbed.tolist()


@pytest.mark.slow
def test_the_order_in_memory_does_not_matter_with_all_features():
    scene, settings = zoo(EVERYTHING, 60, seed=9, side=10.0), {"method": "grid", "contact": "impact", "dt": 0.03}
    expected = state_after(scene, 24, **settings)
    with simulate(scene, **settings) as sim:
        for piece in range(8):
            scramble(sim, seed=piece)
            sim.run(frames=3)
        assert_same_bits(sim.state, expected, "scrambled")


@pytest.mark.slow
def test_added_discs_bring_their_radius_and_mass_on_any_number_of_workers():
    """Small discs are added until the large ones are giants, and the block must grow on the way."""
    scene = zoo(EVERYTHING, 14, seed=10, side=10.0)
    rng, states = np.random.default_rng(11), []
    added = [(rng.uniform(2, 7, 2), rng.normal(size=2), rng.choice([0.1, 0.3]), rng.uniform(1, 2)) for _ in range(30)]
    twin = Twin(scene, method="grid", contact="impact", dt=0.03)
    for disc in added:
        twin.run(1)
        twin.add(*disc)
    twin.run(5)
    for method, workers in (("grid", 1), ("parallel", 2), ("parallel", 3)):
        with simulate(scene, method=method, workers=workers, contact="impact", dt=0.03) as sim:
            for position, velocity, radius, mass in added:
                sim.run(frames=1)
                sim.add(position, velocity, radius=radius, mass=mass)
            sim.run(frames=5)
            states.append(sim.state)
    for state in states:
        assert_same_bits(state, twin.state, "growth with radii and masses")


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("method", ["naive", "grid", "parallel"])
def test_no_disc_one_and_two_run_with_all_features(count, method):
    scene = zoo(EVERYTHING.replace("giants", "radii"), count, seed=12)  # what enters is of another size
    settings = {"method": method, "workers": 2, "contact": "impact", "dt": 0.05}
    twin = Twin(scene, **{**settings, "method": "grid" if method == "parallel" else method})
    twin.run(20)
    assert_same_bits(state_after(scene, 20, **settings), twin.state, f"{count} discs by {method}")
