"""Kinds of boundary: one table, whose facts all other modules ask for."""

import ast

import pytest
from support.script_server import PACKAGE_PARENT

import mpsim
from mpsim.engine import feature_arrays
from mpsim.engine.workers.arrays import grid_for
from mpsim.features import edges
from mpsim.features.edges import BOUNDARIES, Boundary, demand_wall
from mpsim.kernels.layout import ContactLaw

PACKAGE = PACKAGE_PARENT / "mpsim"


def compared_words(text):
    """Lines on which a word for a boundary is compared with something."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Compare):
            words = {leaf.value for leaf in ast.walk(node) if isinstance(leaf, ast.Constant)}
            found += [node.lineno] if words & BOUNDARIES.keys() else []
    return found


def test_nobody_compares_the_words():
    files = {path: compared_words(path.read_text()) for path in PACKAGE.rglob("*.py")}
    assert {str(path.relative_to(PACKAGE)): lines for path, lines in files.items() if lines} == {}


def test_a_comparison_would_be_noticed():
    assert compared_words('if word == "walls":\n    pass\nx = 2 if "periodic" in pair else 1') == [1, 3]
    assert compared_words('ends = {"walls": 1}\nbox(boundary="periodic")') == []


@pytest.fixture
def a_third_kind(monkeypatch):
    """Ends at which nothing happens: neither walls nor a border to another image."""
    kind = Boundary(
        wraps=False,
        has_walls=False,
        least_diameters=1,
        largest_radius="half an open axis",
        not_exact="boundary='open', which it does not know",
    )
    monkeypatch.setitem(edges.BOUNDARIES, "open", kind)


@pytest.mark.usefixtures("a_third_kind")
def test_a_third_kind_is_neither_of_the_others():
    disc = {"position": [[0.25, 2.0]], "velocity": [[0.0, 0.0]], "radius": 0.5}
    scene = mpsim.Scene(width=4, height=4, boundary=("open", "walls"), **disc)
    assert scene.periodic == (False, False)
    assert [limit.tolist() for limit in scene.limits(0.5)] == [[0.0, 0.5], [4.0, 3.5]]
    assert feature_arrays.wall_limits(scene) == (0.0, 4.0, 0.5, 3.5)
    assert not {"wrap_x", "wrap_y"} & feature_arrays.feature_specs(scene, 1, "float64").keys()
    with pytest.raises(mpsim.InputError, match=r"must name a wall; got 'left', and boundary is open along x"):
        demand_wall("piston", "left", scene.boundary)
    with pytest.raises(mpsim.InputError, match=r"half an open axis, 0\.4 here"):
        mpsim.Scene(width=0.8, height=4, boundary=("open", "walls"), **disc)
    with pytest.raises(mpsim.InputError, match="radius from the walls"):
        mpsim.Scene(width=4, height=4, **disc)


@pytest.mark.slow
@pytest.mark.usefixtures("a_third_kind")
def test_the_exact_solver_refuses_a_kind_it_does_not_know():
    """Otherwise it would take that for walls, and nothing would show."""
    disc = {"position": [[1.0, 2.0]], "velocity": [[0.0, 0.0]], "radius": 0.5}
    scene = mpsim.Scene(width=4, height=4, boundary=("open", "walls"), **disc)
    with pytest.raises(mpsim.InputError, match="method='event' cannot do boundary='open', which it does not know"):
        mpsim.Simulation(scene, mpsim.Settings(method="event"))
    event = mpsim.Settings(method="event")
    for known in ("walls", "periodic"):
        mpsim.Simulation(mpsim.Scene(width=4, height=4, boundary=known, **disc), event).close()


def test_what_the_exact_solver_cannot_do_must_be_said():
    """A default would let a new kind, or a new law, pass in silence."""
    for kind in (Boundary, ContactLaw):
        assert not kind._field_defaults


@pytest.mark.parametrize("room", [2, 3])
def test_a_border_that_wraps_has_an_even_number_of_columns_whatever_room_it_needs(monkeypatch, room):
    """Column 0 and the last one meet in the odd pass, where neither may be in another pair."""
    monkeypatch.setitem(edges.BOUNDARIES, "periodic", BOUNDARIES["periodic"]._replace(least_diameters=room))
    for width in (3.0, 5.5, 7.5, 9.0):
        assert grid_for(1000, width, 6.5, 1.0, "float64", ("periodic", "periodic")).columns % 2 == 0
    assert grid_for(1000, 7.5, 6.5, 1.0, "float64", ("walls", "periodic")).columns == 7
    assert grid_for(1, 1.0, 1.0, 1.0, "float64", ("periodic", "periodic")).rows == 2
