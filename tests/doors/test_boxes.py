"""A frame means the same wherever its box begins, and whichever image of a disc it holds: in every measure and picture.

LAMMPS writes boxes from -L/2 to L/2 without an origin, OVITO any origin, HOOMD-blue centred boxes.
"""

import inspect

import matplotlib as mpl
import numpy as np
import pytest
from support.scenes import gas, scene_of
from support.visitor import Visitor, viewed

import mpsim
from mpsim import measure

pytestmark = pytest.mark.plain

mpl.use("Agg")
SCENE = gas(64, 0.4, seed=2, boundary="periodic")
WALLED = gas(64, 0.4, seed=3, boundary=("periodic", "walls"), gravity=(0, -1))
SIDE = SCENE.width


def frame_of(path, scene, corner=(0.0, 0.0), borders=0, origin=True, precision=""):
    """A frame in a file of another program; borders: each disc lies some whole boxes away, along periodic axes."""
    away = np.random.default_rng(1).integers(-borders, borders + 1, (scene.count, 2)) * scene.periodic
    places = (scene.position + corner + away * [scene.width, scene.height]).tolist()
    head = (
        f'Lattice="{scene.width!r} 0 0 0 {scene.height!r} 0 0 0 1" Properties=species:S:1:pos:R:3:radius:R:1:velo:R:3'
    )
    head += f' pbc="{" ".join("FT"[each] for each in scene.periodic)} F"{precision}'
    head += f' Origin="{corner[0]!r} {corner[1]!r} 0"' if origin else ""
    rows = zip(places, scene.velocity.tolist(), strict=True)
    path.write_text(
        f"{len(places)}\n{head}\n" + "".join(f"A {x!r} {y!r} 0 0.5 {u!r} {v!r} 0\n" for (x, y), (u, v) in rows)
    )
    return mpsim.Trajectory(path)[0]


def earlier(scene):
    return mpsim.State(np.clip(scene.position - 0.1 * scene.velocity, 0, scene.height - 1e-9), scene.velocity)


ELSEWHERE = {
    "centred": {"corner": (-SIDE / 2, -SIDE / 2)},
    "centred, without origin": {"corner": (-SIDE / 2, -SIDE / 2), "origin": False},
    "far": {"corner": (1000.0, -300.0)},
    "unwrapped": {"borders": 3},
    "far and unwrapped": {"corner": (-64.0, 100.0), "borders": 2},
}

OF_STATES = {
    "kinetic_energy": measure.kinetic_energy,
    "mean_squared_displacement": lambda state, scene: measure.mean_squared_displacement(earlier(scene), state, scene),
    "momentum": measure.momentum,
    "overlap": lambda state, scene: vars(measure.overlap(state, scene, radii=np.full(scene.count, 0.55))),
    "potential_energy": measure.potential_energy,
    "rotational_energy": measure.rotational_energy,
    "speed_distribution": lambda state, scene: vars(measure.speed_distribution(state)),
    "speed_kurtosis": lambda state, scene: measure.speed_kurtosis(state),
    "temperature": measure.temperature,
    "trajectory_error": lambda state, scene: vars(measure.trajectory_error(state, earlier(scene), scene)),
    "starting_from": lambda state, scene: scene.starting_from(state).position,
}


OF_PLACES = ("mean_squared_displacement", "starting_from", "trajectory_error")
"""What depends on where the discs are in the box, which a file without its origin does not say."""


def flat(found):
    """All numbers of a result."""
    if isinstance(found, dict):
        return np.concatenate([flat(value) for value in found.values()])
    if isinstance(found, measure.Measure):
        return np.array([found.value, found.error])
    return np.ravel(np.asarray([] if found is None else found, complex))


def test_the_table_has_every_measure_of_states():
    functions = {name: getattr(measure, name) for name in measure.__all__ if inspect.isfunction(getattr(measure, name))}
    first = {name: {*inspect.signature(each).parameters} for name, each in functions.items()}
    of_states = {name for name, parameters in first.items() if {"state", "states", "before"} & parameters}
    assert of_states - set(OF_STATES) == {"to_freud"}, "a measure of states that this test leaves out"


@pytest.mark.parametrize("name", OF_STATES)
def test_a_measure_does_not_depend_on_where_the_box_is(name, tmp_path):
    """Along walls only the origin says where it is."""
    for scene in (SCENE, WALLED):
        expected = flat(OF_STATES[name](frame_of(tmp_path / "a.xyz", scene).state, scene))
        assert expected.size
        for how in ELSEWHERE.values():
            if "origin" in how and (name in OF_PLACES or scene is WALLED):
                continue
            found = flat(OF_STATES[name](frame_of(tmp_path / "a.xyz", scene, **how).state, scene))
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-9, nan_ok=True), how


def test_discs_beyond_walls_are_refused_where_places_count(tmp_path):
    scene = WALLED
    state = frame_of(tmp_path / "a.xyz", scene, corner=(0.0, -scene.height / 2), origin=False).state
    for name in ("overlap", "potential_energy"):
        with pytest.raises(mpsim.InputError, match=r"must be in its box, .* x .*; got disc \d+ at .*Lattice and Orig"):
            OF_STATES[name](state, scene)
    assert measure.temperature(state, scene) == measure.temperature(mpsim.State(scene.position, scene.velocity), scene)
    with pytest.raises(mpsim.InputError, match="must be in its box"):
        mpsim.draw(state, scene)


def test_single_precision_far_away_is_no_overlap(tmp_path):
    """Touching discs at 100,000 lie on a grid of 1/128: overlaps of that size are those of the numbers in the file."""
    place = np.stack([np.arange(9) % 3, np.arange(9) // 3], axis=1) * 0.3 + 0.1
    scene = mpsim.Scene(width=0.9, height=0.9, position=place, velocity=0 * place, radius=0.15, boundary="periodic")
    frame = frame_of(tmp_path / "a.xyz", scene, corner=(100_000.3, 7.7), precision=" precision=float32")
    assert frame.position.dtype == np.float32
    assert measure.overlap(frame.state, scene).pairs == 0
    deeper = mpsim.State(scene.position, scene.velocity)
    assert measure.overlap(deeper, scene, radii=np.full(9, 0.151)).pairs == 18, "the control: all neighbours"


def test_across_borders_the_sides_of_a_box_are_those_of_its_state():
    """Files round boxes: the sides of the scene would make neighbours across a border overlap."""
    place, wider = np.stack(np.divmod(np.arange(16), 4), axis=1) + 0.5, 1 + 5e-5
    scene = mpsim.Scene(width=4, height=4, position=place, velocity=0 * place, radius=0.5, boundary="periodic")

    def scaled(scene, factor):
        return mpsim.State(factor * scene.position, scene.velocity, box=tuple(factor * side for side in scene.box))

    assert measure.overlap(scaled(scene, wider), scene).pairs == 0
    assert measure.overlap(scaled(scene, 1 / wider), scene).pairs == 32, "the control: all neighbours"


def test_displacements_follow_image_flags_and_the_box():
    """A disc that has crossed a border in a box that was written elsewhere meanwhile, or that has changed: refused."""

    def state(place, image, box):
        return mpsim.State(np.array([place]), np.zeros((1, 2)), image=np.array([image]), box=box)

    start, box = state((1.0, 1.0), (0, 0), (0, 10, 0, 10)), {"width": 10, "height": 10, "radius": 0.5}
    scene = mpsim.Scene(position=start.position, velocity=start.velocity, boundary="periodic", **box)
    end, moved = state((-4.0, 12.0), (1, -1), (-5, 5, -5, 5)), state((6.0, 8.0), (1, 0), (5, 15, 0, 10))
    assert measure.mean_squared_displacement(start, end, scene) == 10.0**2 + 6.0**2
    assert measure.mean_squared_displacement(start, moved, scene) == 10.0**2 + 7.0**2
    here, wider = (state((1.0, 5.0), image, (0, side, 0, 10)) for image, side in (((10, 0), 10), ((10, 0), 11)))
    with pytest.raises(mpsim.InputError, match=r"needs states of one box; got boxes of 10 x 10 and 11 x 10\."):
        measure.mean_squared_displacement(here, wider)
    same = [state((1.0, 5.0), (0, 0), (0, side, 0, 10)) for side in (10, 11)]
    assert measure.mean_squared_displacement(*same) == 0, "a wall that moves"


def test_states_of_a_piston_stay_where_they_are():
    """The lower wall has moved, the other one has not: no shift, same bits."""
    place = np.array([[3.0, 4.0], [6.0, 6.0], [3.5, 2.0]])
    scene = mpsim.Scene(
        width=8, height=8, position=place, velocity=np.zeros((3, 2)), radius=0.5, gravity=(0, -1),
        boundary=("periodic", "walls"), piston=mpsim.Piston("bottom", 1.0, 1.5),
    )  # fmt: skip
    state = mpsim.State(place, np.zeros((3, 2)), box=(0, 8, 1.5, 8))
    assert measure.potential_energy(state, scene) == 12.0
    assert scene.starting_from(state).position.tolist() == place.tolist()
    written = mpsim.State(place + np.array([20, 30]), np.zeros((3, 2)), box=(20, 28, 31.5, 38))
    assert measure.potential_energy(written, scene) == 12.0
    assert scene.starting_from(written).position.tolist() == place.tolist()
    assert scene.starting_from(written).piston.start == 1.5


def offsets(figure):
    axes = figure.axes[0]
    corner = axes.get_xlim()[0], axes.get_ylim()[0]
    return np.asarray(axes.collections[0].get_offsets()) - corner, np.ptp(axes.get_xlim())


@pytest.mark.parametrize("scene", [SCENE, WALLED], ids=["periodic", "walls"])
def test_a_picture_shows_the_box_of_its_frame(scene, tmp_path):
    expected, width = offsets(mpsim.draw(frame_of(tmp_path / "a.xyz", scene)))
    assert width == pytest.approx(scene.width)
    assert ((expected >= 0) & (expected <= [scene.width, scene.height])).all(axis=1).sum() == scene.count
    for how in ({"corner": (100.0, -50.0)}, {"corner": (-5.0, -4.0), "borders": 2}):
        frame = frame_of(tmp_path / "a.xyz", scene, **how)
        alone, with_scene = mpsim.draw(frame), mpsim.draw(frame, scene)
        assert offsets(alone)[0] == pytest.approx(expected, abs=1e-9)
        assert alone.axes[0].get_xlim() == pytest.approx((how["corner"][0], how["corner"][0] + width))
        assert offsets(with_scene)[0] == pytest.approx(expected, abs=1e-9)
        assert offsets(mpsim.draw(frame.state, scene))[0] == pytest.approx(expected, abs=1e-9)
        assert with_scene.axes[0].get_xlim() == (0, scene.width), "coordinates of the scene"


def test_a_recording_shows_the_box_of_each_frame(tmp_path):
    path, whole = tmp_path / "a.xyz", b""
    for how in ({}, {"corner": (100.0, 50.0)}, {"corner": (-3.0, -4.0), "borders": 1}):
        frame_of(path, SCENE, **how)
        whole += path.read_bytes()
    for first in (0, 1):
        path.write_bytes(b"".join(whole.splitlines(keepends=True)[first * (SCENE.count + 2) :]))
        with viewed(mpsim.Trajectory(path), playing=False) as view, Visitor(view.address) as visitor:
            visitor.say("visible", value=True)
            for index in range(3 - first):
                visitor.say("seek", index=index)
                visitor.hear_until(lambda v, index=index: v.picture is not None and v.frame == index)
                assert np.abs(visitor.picture.position - SCENE.position).max() < SIDE / 60_000
            assert (visitor.last["scene"]["width"], visitor.last["scene"]["height"]) == (SIDE, SIDE)


def test_a_recording_of_a_moving_wall_has_its_numbers(tmp_path):
    """Without its scene, the box of later frames is another than that of the first: the gauges said nothing."""
    scene = scene_of([[3, 4], [6, 6]], [[1, 0], [0, 1]], 8, 8, piston=mpsim.Piston("left", 1.0, 1.5))
    path = tmp_path / "a.xyz"
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.1, method="naive")) as sim:
        with mpsim.Trajectory.write(path, every=5) as out:
            sim.run(frames=5, observe=out)
        expected = measure.temperature(sim.state, scene)
    with viewed(mpsim.Trajectory(path), playing=False) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.say("seek", index=1)
        visitor.hear_until(lambda v: v.last.get("gauges", {}).get("frame") == 5)
        assert visitor.last["gauges"]["temperature"] == pytest.approx(expected)


@pytest.mark.slow
def test_freud_agrees_on_the_neighbours_of_a_frame_from_elsewhere(tmp_path):
    freud = pytest.importorskip("freud")  # which takes seconds
    frame = frame_of(tmp_path / "a.xyz", SCENE, **ELSEWHERE["far and unwrapped"])
    there, here = (
        freud.order.Hexatic(k=6).compute(measure.to_freud(state, SCENE), neighbors={"num_neighbors": 6}).particle_order
        for state in (frame.state, mpsim.State(SCENE.position, SCENE.velocity))
    )
    assert np.abs(there) == pytest.approx(np.abs(here), abs=1e-3)
