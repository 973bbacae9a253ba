"""Obstacles reach across periodic borders, however long they are, at every door that puts discs beside them."""

from itertools import product

import numpy as np
import pytest

import mpsim

pytestmark = pytest.mark.plain

LONG = {
    "a line across the box": [mpsim.Polyline([(10, 0), (10, 20)])],
    "an oblique line": [mpsim.Polyline([(2, 1), (18, 19)], thickness=0.4)],
    "a line along both borders": [mpsim.Polyline([(0, 0), (0, 20), (20, 20)], thickness=0.3)],
    "a thick disc in the corner": [mpsim.FixedDisc((19.5, 0.5), 6.0)],
    "a line of more than half": [mpsim.Polyline([(3, 4), (3, 19.5)], thickness=1.0), mpsim.FixedDisc((0.0, 10.0), 2.0)],
}
BOUNDARIES = [("walls", "periodic"), ("periodic", "walls"), "periodic"]


def depths(scene):
    """How deep each disc is in an obstacle or one of its images: every disc with every image, shape (N,) [length]."""
    deepest = np.full(scene.count, -np.inf)
    shifts = [
        (0.0, -side, side) if wraps else (0.0,)
        for side, wraps in zip((scene.width, scene.height), scene.periodic, strict=True)
    ]
    for (ax, ay, bx, by, radius), shift in product(scene.capsules.tolist(), product(*shifts)):
        a, along = np.array([ax, ay]) + shift, np.array([bx - ax, by - ay])
        relative, squared = scene.position - a, float(along @ along)
        fraction = np.clip(relative @ along / squared, 0, 1) if squared else np.zeros(scene.count)
        distance = np.hypot(*(relative - fraction[:, None] * along).T)
        deepest = np.maximum(deepest, scene.radii + radius - distance)
    return deepest


@pytest.mark.parametrize(("name", "boundary"), list(zip(LONG, [*BOUNDARIES, *BOUNDARIES[1:]], strict=True)), ids=str)
@pytest.mark.parametrize("count", [60, 190])  # one after the other at random, and from a lattice
def test_random_discs_keep_clear_of_all_images(name, boundary, count):
    obstacles = LONG[name]
    count = count // 2 if "thick" in name else count
    scene = mpsim.Scene.random(
        count=count, width=20, height=20, radius=0.5, seed=1, boundary=boundary, obstacles=obstacles
    )
    assert depths(scene).max() <= 1e-12
    assert scene.overlaps_at_start() == ""


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=str)
def test_discs_of_a_region_keep_clear_of_images_and_of_each_other(boundary, tmp_path):
    """A region that reaches to a border: what is beyond it counts, and the other side of the region itself."""
    group = '[[discs]]\nplaces = "random"\ncount = 60\nradius = 0.5\nregion = {}\nseed = {}\n'
    wraps = [each == "periodic" for each in ([boundary] * 2 if isinstance(boundary, str) else boundary)]
    region = [0.5 * (not wrap) for wrap in wraps] + [20 - 0.5 * (not wrap) for wrap in wraps]
    words = f'"{boundary}"' if isinstance(boundary, str) else str(list(boundary)).replace("'", '"')
    text = (
        f"schema = 1\nwidth = 20.0\nheight = 20.0\nboundary = {words}\n"
        + group.format(region, 1)
        + group.format(region, 2)
    )
    path = tmp_path / "a.toml"
    path.write_text(
        text + "[[obstacles]]\nposition = [10.0, 0.0]\nradius = 2.0\n[[obstacles]]\nposition = [0, 10]\nradius = 2.0\n"
    )
    scene = mpsim.Scene.load(path)
    assert depths(scene).max() <= 1e-12
    assert scene.overlaps_at_start() == ""


@pytest.mark.parametrize("boundary", ["periodic", ("walls", "periodic")], ids=str)
def test_a_disc_that_is_added_in_an_image_is_refused(boundary):
    scene = mpsim.Scene(width=20, height=20, position=[[5, 5]], velocity=[[0, 0]], radius=0.5, boundary=boundary,
                        obstacles=[mpsim.Polyline([(10, 2), (10, 20)])])  # fmt: skip
    with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
        for place in ((10.2, 0.3), (10.2, 19.0), (9.8, 10.0)):
            with pytest.raises(mpsim.InputError, match="must be one radius from every obstacle"):
                sim.add(place, (0, 0))
        sim.add((10.2, 1.0), (0, 0))
    with pytest.raises(mpsim.InputError, match="one radius from every obstacle"):
        mpsim.Scene(width=20, height=20, position=[[5, 5]], velocity=[[0, 0]], radius=0.5, boundary=boundary,
                    obstacles=scene.obstacles, emitters=[mpsim.Emitter((10.2, 0.3), (0, 1), interval=1.0)])  # fmt: skip
