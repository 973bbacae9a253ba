"""Sweeps that run scenes: settings and lengths from the grid, measures in the rows."""

import functools

import pytest
from support.scenes import gas

from mpsim import InputError, Scene, Settings, Simulation, sweep
from mpsim.measure.registry import NAMES
from mpsim.studies.sweep_runs import UNITS

SCENE = gas(20, 0.2)


def expected(scene, settings, names, **length):
    with Simulation(scene, settings) as sim:
        report = sim.run(**length, measures=names)
    found = {name: report.measures[name].value for name in names}
    return found | {"frames": report.frames, "collisions": report.collisions}


def assert_has(row, values):
    assert {name: row.values[name] for name in values} == values


def test_settings_of_the_grid_are_those_of_the_runs():
    table = sweep(SCENE, {"dt": [0.1, 0.05], "contact": ["push"], "method": ["naive"]}, until=2.0, measures=["overlap"])
    for row in table.rows:
        settings = Settings(dt=row.point["dt"], contact="push", method="naive")
        assert_has(row, expected(SCENE, settings, ["overlap"], until=2.0))
    assert [row.values["frames"] for row in table.rows] == [20, 40]
    assert table.results == ("overlap", "overlap_error", "frames", "collisions")
    assert (table.units["dt"], table.units["overlap_error"]) == ("time", "length")


def test_the_length_may_vary_and_other_settings_are_given():
    settings = Settings(dt=0.1, method="grid", passes=2)
    table = sweep(SCENE, {"frames": [5, 10]}, settings=settings, measures="kinetic_energy")
    for row in table.rows:
        found = expected(SCENE, settings, ["kinetic_energy"], frames=row.point["frames"])
        del found["frames"]  # which the grid has
        assert_has(row, found)


def test_seeds_draw_the_scene_again_and_without_them_it_is_as_it_is():
    grid, how = {"dt": [0.1]}, {"until": 1.0, "settings": Settings(method="naive"), "measures": ["pressure"]}
    (plain,) = sweep(SCENE, grid, **how).rows
    assert_has(plain, expected(SCENE, Settings(dt=0.1, method="naive"), ["pressure"], until=1.0))
    first, second = sweep(SCENE, grid, 2, **how).rows
    for row in (first, second):
        scene = SCENE.redrawn(row.seed)
        assert_has(row, expected(scene, Settings(dt=0.1, method="naive"), ["pressure"], until=1.0))
    assert first.values["pressure"] != second.values["pressure"]


def recommending(packing):
    """A scene that recommends settings of its own."""
    settings = Settings(dt=0.05 if packing > 0.15 else 0.1, method="naive")
    return Scene.random(count=20, packing=packing, radius=0.5, duration=1.0, settings=settings)


def test_a_scene_that_a_function_makes_brings_its_settings():
    grid = {"packing": [0.1, 0.2]}
    assert [row.values["frames"] for row in sweep(recommending, grid, measures=["overlap"]).rows] == [10, 20]
    given = sweep(recommending, grid, measures=["overlap"], settings=Settings(dt=0.125, method="naive"))
    assert [row.values["frames"] for row in given.rows] == [8, 8]
    varied = sweep(recommending, {**grid, "dt": [0.025]}, measures=["overlap"])
    assert [row.values["frames"] for row in varied.rows] == [40, 40]


def test_a_name_brings_its_settings_and_its_duration():
    table = sweep("cradle", {"substeps": [1, 2]})
    from mpsim.scene import scenefile  # noqa: PLC0415 - as the package does

    file = scenefile.load("cradle")
    settings = file.settings or Settings()
    assert [row.failure for row in table.rows] == [None, None]
    assert {row.values["frames"] for row in table.rows} == {round(file.scene.duration / settings.dt)}
    assert table.function == "cradle"


def test_a_function_makes_the_scenes_of_the_values_that_it_takes():
    make = functools.partial(Scene.random, radius=0.5, temperature=1.0)
    table = sweep(make, {"count": [10, 20], "packing": [0.2], "dt": [0.1]}, 2, frames=5, measures=["temperature"])
    for row in table.rows:
        scene = Scene.random(radius=0.5, temperature=1.0, count=row.point["count"], packing=0.2, seed=row.seed)
        assert_has(row, expected(scene, Settings(dt=0.1, workers=1), ["temperature"], frames=5))


def test_a_function_that_has_a_parameter_of_that_name_gets_it():
    def at(dt, until):
        return {"product": dt * until}

    assert sweep(at, {"dt": [2.0], "until": [3.0]}).rows[0].values == {"product": 6.0}


@pytest.mark.long
def test_measures_that_a_scene_cannot_have_are_left_out_unless_they_are_asked_for():
    falling = gas(20, 0.2, gravity=(0, -1), boundary="periodic")
    (row,) = sweep(falling, {"method": ["grid"]}, frames=5).rows
    assert "pressure" not in row.values
    assert "collision_rate" in row.values
    with pytest.raises(InputError, match=r"^measures may hold 'pressure' only without gravity"):
        sweep(falling, {"method": ["grid"]}, frames=5, measures=["pressure"])


def test_a_run_takes_one_process_unless_more_are_asked_for(monkeypatch):
    seen = []
    monkeypatch.setattr("mpsim.studies.sweep_runs.Simulation", lambda scene, settings: seen.append(settings.workers))
    sweep(SCENE, {"workers": [None, 2]}, frames=1)
    assert sorted(seen) == [1, 2]


def test_a_run_that_fails_is_a_row():
    rows = sweep(SCENE, {"law": ["elastic", "reflect"], "method": ["event"]}, until=1.0).rows
    assert rows[0].failure is None
    assert rows[1].failure.startswith("InputError: ")


@pytest.mark.parametrize(
    ("function", "grid", "options", "text"),
    [
        (SCENE, {"dtt": [0.1]}, {"until": 1}, r"grid\['dtt'\] must be one of dt, .*Did you mean 'dt'.*give a function"),
        (SCENE, {"dt": [0.1, -1]}, {"until": 1}, "dt must be a finite number > 0 .time.; got -1"),
        (SCENE, {"method": ["gird"]}, {"until": 1}, "method must be one of .* got 'gird'. Did you mean 'grid'"),
        (SCENE, {"method": ["grid", "mpi"]}, {"until": 1}, "method must be one that runs in a process.*got 'mpi'"),
        (SCENE, {"dt": [1]}, {"until": 1, "settings": Settings(method="mpi")}, "method must be one that runs in a pro"),
        (SCENE, {"frames": [1.5]}, {}, "frames must be a whole number from 0"),
        (SCENE, {"until": [-1]}, {}, "until must be a finite number >= 0"),
        (SCENE, {"dt": [0.1]}, {}, "a sweep of runs must have their length.*got neither"),
        (SCENE, {"dt": [0.1]}, {"until": 1, "frames": 2}, "a sweep of runs must have.*got until and frames"),
        (SCENE, {"dt": [0.1], "frames": [3]}, {"until": 1}, "a sweep of runs must have.*got until and frames"),
        (SCENE, {"dt": [0.1]}, {"until": 1, "measures": ["presure"]}, "measures must be.*Did you mean 'pressure'"),
        (SCENE, {"dt": [0.1]}, {"until": 1, "settings": 3}, "settings must be mpsim.Settings; got int"),
        ("gass", {"dt": [0.1]}, {"until": 1}, "scene must be a path.*Did you mean 'gas'"),
        ("no.toml", {"dt": [0.1]}, {"until": 1}, "scene must be a file that can be read; got 'no.toml'"),
        (lambda count: 3, {"count": [1]}, {"until": 1}, "a function whose scenes are to be run must return"),
        (Scene.random, {"count": [1]}, {"until": 1}, "grid must hold every argument that Scene.random .*lacks radius"),
    ],
)  # fmt: skip
def test_what_is_refused(function, grid, options, text):
    with pytest.raises(InputError, match=f"^{text}"):
        sweep(function, grid, **options)


def test_a_scene_that_was_not_drawn_has_no_seeds():
    given = Scene(width=4, height=4, position=[(1, 1)], velocity=[(1, 0)], radius=0.5)
    with pytest.raises(InputError, match=r"^another start needs a scene that was drawn at random"):
        sweep(given, {"dt": [0.1]}, 2, until=1.0)


def test_every_measure_has_a_unit():
    assert set(NAMES) <= UNITS.keys()
