"""Trajectories of other programs: what is read from them, what is refused by name, and what stays absent."""

import gzip
import re
import zlib

import ase
import ase.io
import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas
from support.trajectories import content, written

import mpsim
from mpsim import measure

LATTICE = 'Lattice="8 0 0 0 6 0 0 0 1"'
ROWS = "X 1 1 0\nX 3 2 0\n"
FRAME = f'2\n{LATTICE} Properties=species:S:1:pos:R:3 pbc="T T F"\n{ROWS}'
DUMP = """ITEM: TIMESTEP
70
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp ff pp
-4 4
-3 5
-0.5 0.5
ITEM: ATOMS id type x y z vx vy vz radius mass
2 1 3.5 1 0 0.5 0.25 0 0.4 2
1 1 -1 2 0 -1 1 0 0.5 1
"""


def read(tmp_path, text, name="a.xyz", **given):
    """The only frame of a file with this text."""
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    (frame,) = mpsim.Trajectory(tmp_path / name, **given)
    return frame


def refused(tmp_path, text, words, name="a.xyz", **given):
    """The file is refused, by an error that names it, the frame and, in words, the rest."""
    with pytest.raises(mpsim.errors.TrajectoryError, match=words) as caught:
        read(tmp_path, text, name, **given)
    assert f"frame 0 of '{tmp_path / name}'" in str(caught.value)


# --- extended XYZ


PERIODIC = {
    **dict.fromkeys(['"T T F"', "'T T F'", "[T, T, F]", '"T, T, F"', "{t t f}", "[true,true,false]"], (True, True)),
    **dict.fromkeys(
        ['"TRUE FALSE FALSE"', "T F F", "[True, False, True]", '"1 0 0"', "T,F,F", "[1 0 1]"], (True, False)
    ),
    **dict.fromkeys(["T", "true", "1", '"True"', "[T]", '"T T"', "[1, 1]"], (True, True)),
    **dict.fromkeys(["F", "FALSE", "0", '"f f t"', "False", "[F F T]"], (False, False)),
}


@pytest.mark.parametrize("key", ["pbc", "PBC", "Pbc"])
@pytest.mark.parametrize("value", PERIODIC)
def test_periodic_axes_are_read_in_every_spelling(tmp_path, key, value):
    for spaced in ("=", " = "):
        text = f"2\n{LATTICE} {key}{spaced}{value} Properties=species:S:1:pos:R:3\n{ROWS}"
        assert read(tmp_path, text).periodic == PERIODIC[value]


@pytest.mark.parametrize("value", ['"T T maybe"', "yes", '"2 0 0"', '""', '"T T F F"', "None"])
def test_periodic_axes_in_other_words_are_refused(tmp_path, value):
    refused(
        tmp_path, f"2\n{LATTICE} pbc={value}\n{ROWS}", r"line 2, must say under pbc which axes are periodic, such as"
    )


SAME = {
    "blank lines before and after": "\n \n" + FRAME + "\n" * 25,
    "a wide count": FRAME.replace("2\n", f"{2:21d}\n", 1),
    "single quotes": FRAME.replace('"', "'"),
    "brackets": FRAME.replace('"8 0 0 0 6 0 0 0 1"', "[[8, 0, 0], [0, 6, 0], [0, 0, 1]]"),
    "braces": FRAME.replace('"8 0 0 0 6 0 0 0 1"', "{8 0 0 0 6 0 0 0 1}"),
    "bare numbers": FRAME.replace('"8 0 0 0 6 0 0 0 1"', "8 0 0 0 6 0 0 0 1"),
    "three sides": FRAME.replace('"8 0 0 0 6 0 0 0 1"', '"8 6 1"'),
    "lower case": FRAME.replace("Lattice", "lattice").replace("Properties", "properties"),
    "upper case": FRAME.replace("Lattice", "LATTICE").replace("Properties", "PROPERTIES"),
    "exponents of Fortran": FRAME.replace('"8 0', '"0.8d1 0').replace("X 3 2", "X 0.3D+1 20.d-1"),
    "off the axes by rounding": FRAME.replace('"8 0 0', '"8 1e-17 0'),
    "lines that end as on Windows": FRAME.replace("\n", "\r\n"),
    "a byte order mark": "\ufeff" + FRAME,
    "keys within a text": FRAME.replace("pbc", r"""note="a \" Lattice='1 0 0' pbc=F" pbc"""),
    "a text alone": FRAME.replace("pbc", """"a Lattice='1 0 0' text" it's pbc"""),
    "a name of mpsim's in another case": FRAME.replace("X 1", "disc 1").replace("species", "Type"),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_what_other_programs_write_differently_is_the_same(tmp_path, name):
    frame = read(tmp_path, SAME[name])
    assert (frame.position.tolist(), frame.box, frame.periodic) == ([[1, 1], [3, 2]], (8.0, 6.0), (True, True))


def test_blank_lines_between_frames_are_passed_over(tmp_path):
    (tmp_path / "a.xyz").write_text(f"{FRAME}\n \n{FRAME.replace('X 1', 'X 2')}\n\n{FRAME}")
    assert [frame.position[0, 0] for frame in mpsim.Trajectory(tmp_path / "a.xyz")] == [1, 2, 1]


@pytest.mark.parametrize(
    ("lattice", "words"),
    [
        ("0 0 0 0 0 0 0 0 0", "must hold the box, the key Lattice of extended XYZ"),
        ("-8 0 0 0 6 0 0 0 1", "must have an upright rectangular box with sides above 0.*got '-8 0 0"),
        ("8 0 0 0 0 0 0 0 1", "must have an upright rectangular box with sides above 0"),
        ("8 0 0 1 6 0 0 0 1", "must have an upright rectangular box with sides above 0"),
        ("8 0 0 6", "must have an upright rectangular box with sides above 0"),
        ("nan 0 0 0 6 0 0 0 1", "must hold finite numbers under Lattice; got 'nan'"),
        ("1e999 0 0 0 6 0 0 0 1", "must hold finite numbers under Lattice; got '1e999'"),
    ],
)
def test_a_box_that_is_none_is_refused(tmp_path, lattice, words):
    refused(tmp_path, FRAME.replace("8 0 0 0 6 0 0 0 1", lattice), f"line 2, {words}")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("X 3 2", "X nan 2", r"line 4, must hold finite numbers in its column pos; got \[nan"),
        ("X 3 2", "X inf 2", r"line 4, must hold finite numbers in its column pos; got \[inf"),
        ("X 3 2", "X ***** 2", r"line 4, must hold numbers in its column pos; got '\*\*\*\*\*'"),
        ("X 3 2", "X 3", "line 4, must have 4 columns, as its Properties say; got a line with 3"),
        ("X 3 2", "X 3 2 7", "line 4, must have 4 columns, as its Properties say; got a line with 5"),
        ("X 1 1 0\n", "\n", "line 3, must have 4 columns, as its Properties say; got a line with 0"),
        ("pos:R:3", "pos:R:3:radius:R:1", "line 3, must have 5 columns"),
        ("pbc", "Time=late pbc", "line 2, must hold finite numbers under Time; got 'late'"),
        ("pbc", "Origin=1 pbc", "line 2, must have the corner of its box under Origin, 'x y z'; got '1'"),
    ],
)
def test_damage_is_refused_by_its_line(tmp_path, old, new, words):
    refused(tmp_path, FRAME.replace(old, new), words)


def test_sizes_and_masses_below_0_are_refused(tmp_path):
    text = (
        FRAME.replace("pos:R:3", "pos:R:3:radius:R:1")
        .replace("X 1 1 0", "X 1 1 0 .5")
        .replace("X 3 2 0", "X 3 2 0 -.5")
    )
    refused(tmp_path, text, "must hold no radius below 0; got -0.5")
    refused(tmp_path, text.replace("radius", "masses"), "must hold no mass below 0; got -0.5")


def test_a_last_line_without_its_end_is_read_with_a_warning(tmp_path):
    for frames in (1, 2):
        (tmp_path / "a.xyz").write_text((FRAME * frames)[:-1])
        with pytest.warns(
            mpsim.errors.TrajectoryWarning, match="ends without the end of a line. Its last frame is read"
        ):
            trajectory = mpsim.Trajectory(tmp_path / "a.xyz")
        assert len(trajectory) == frames
        assert trajectory[-1].position.tolist() == [[1, 1], [3, 2]]


@pytest.mark.parametrize("text", [FRAME, DUMP], ids=["xyz", "dump"])
@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_off_anywhere_has_its_whole_frames(tmp_path, text, compressed):
    """Cut within the last number, it is the file of a program that writes no newline at its end, which is said."""
    frames, path = 3, tmp_path / f"a.{'xyz' if text is FRAME else 'dump'}{'.gz' * compressed}"
    for cut in range(1, len(text)):
        whole = (text * frames)[:-cut].encode()
        path.write_bytes(gzip.compress(whole) if compressed else whole)
        with pytest.warns(
            mpsim.errors.TrajectoryWarning, match="ends (in the middle of a frame|without the end of a line)"
        ):
            trajectory = mpsim.Trajectory(path)
        last = text[: len(text) - cut].splitlines()[-1:]
        complete = len(last) > 0 and len(text[: len(text) - cut].splitlines()) == len(text.splitlines())
        complete = complete and len(last[0].split()) == len(text.splitlines()[-1].split())
        assert len(trajectory) == frames - 1 + complete
        assert [len(frame.position) for frame in trajectory] == [2] * len(trajectory)


def test_a_frame_that_mpsim_wrote_is_incomplete_without_its_last_newline(tmp_path):
    """Negative control of the tests above: its last number may be cut short, and is not read."""
    written(tmp_path / "a.xyz", gas(5, 0.1), 4, 1)
    (tmp_path / "b.xyz").write_bytes((tmp_path / "a.xyz").read_bytes()[:-1])
    with pytest.warns(mpsim.errors.TrajectoryWarning, match="ends in the middle of a frame"):
        assert len(mpsim.Trajectory(tmp_path / "b.xyz")) == 4


def test_velocities_are_momenta_over_masses_where_they_are_written_so(tmp_path):
    atoms = ase.Atoms("H2", positions=[[1, 1, 0], [3, 2, 0]], cell=[8, 6, 1], pbc=[1, 1, 0], masses=[2.0, 4.0])
    atoms.set_velocities([[1.0, 0.5, 0], [-0.5, 0.25, 0]])
    ase.io.write(tmp_path / "a.xyz", atoms)
    (frame,) = mpsim.Trajectory(tmp_path / "a.xyz")
    assert frame.velocity.tolist() == atoms.get_velocities()[:, :2].tolist() == [[1, 0.5], [-0.5, 0.25]]
    assert frame.mass.tolist() == [2, 4]
    del atoms.arrays["masses"]  # which ASE then takes from the chemical element
    ase.io.write(tmp_path / "b.xyz", atoms)
    with pytest.raises(mpsim.errors.TrajectoryError, match="velocity must be in a trajectory to be read from it"):
        mpsim.Trajectory(tmp_path / "b.xyz")[0].velocity  # noqa: B018


def test_time_steps_of_lammps_are_the_numbers_of_frames(tmp_path):
    head = f'Timestep=3000 Time=0.75 pbc="T T F" {LATTICE} Properties=species:S:1:pos:R:3:vel:R:3:forces:R:3:mass:R:1'
    frame = read(tmp_path, f"1\n{head}\nA 1 -2 0 0.5 0.25 0 9 9 9 2\n")
    assert (frame.frame, frame.time, frame.velocity.tolist(), frame.mass.tolist()) == (3000, 0.75, [[0.5, 0.25]], [2])
    plain = read(tmp_path, "1\n Atoms. Timestep: 500 Time: 0.125\n1 1 2 0\n", box=(8, 6))
    assert (plain.frame, plain.time) == (500, 0.125)
    assert read(tmp_path, FRAME).frame == 0, "its index, where the file does not say"


# --- dimensions


@pytest.mark.parametrize("thickness", [0, 1, 6])
def test_a_frame_with_several_z_is_refused_and_a_plane_is_not(tmp_path, thickness):
    solid = FRAME.replace("X 3 2 0", "X 1 1 1.5").replace("0 0 1", f"0 0 {thickness}")
    refused(tmp_path, solid, r"must be two-dimensional, with the same z for all discs.*z = 1.5 of disc 1, not 0\.")
    assert read(tmp_path, solid.replace("X 1 1 0", "X 2 1 1.5")).position.tolist() == [[2, 1], [1, 1]]
    rounding = solid.replace("X 1 1 0", "X 2 1 1.50000001")
    assert read(tmp_path, rounding).position.tolist() == [[2, 1], [1, 1]]


def test_discs_that_leave_their_plane_are_refused(tmp_path):
    rising = (
        FRAME.replace("pos:R:3", "pos:R:3:velo:R:3").replace("X 1 1 0", "X 1 1 0 1 0 0").replace("3 2 0", "3 2 0 0 1 1")
    )
    refused(tmp_path, rising, r"must be two-dimensional.* got a velocity with z = 1 of disc 1, not 0\.")
    assert read(tmp_path, rising.replace("0 1 1", "0 1 0")).velocity.tolist() == [[1, 0], [0, 1]]


def hoomd_file(path, positions, frames=1, **more):
    """A GSD file as HOOMD writes it."""
    made = gsd.hoomd.Frame()
    made.configuration.box = more.pop("box", [6, 6, 0, 0, 0, 0])
    made.configuration.dimensions = more.pop("dimensions", 2)
    made.particles.N, made.particles.position = len(positions), np.array(positions, np.float32)
    for name, value in more.items():
        setattr(made.particles, name, value)
    with gsd.hoomd.open(str(path), "w") as out:
        for step in range(frames):
            made.configuration.step = 10 * step
            made.particles.position = made.particles.position + np.float32([0.125 * step, 0, 0])
            out.append(made)
    return mpsim.Trajectory(path)


def test_a_gsd_frame_of_three_dimensions_is_refused_unless_it_is_a_plane(tmp_path):
    cube = {"box": [6, 6, 6, 0, 0, 0], "dimensions": 3}
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"frame 0 of '.*a.gsd' must be two-dimensional"):
        hoomd_file(tmp_path / "a.gsd", [(1, 0, 1.5), (1, 0, -1.5)], **cube)[0]
    assert hoomd_file(tmp_path / "b.gsd", [(1, 0, 1.5), (2, 0, 1.5)], **cube)[0].position.tolist() == [[4, 3], [5, 3]]


# --- GSD


GRID = [(x, y, 0) for x in (-2, -1, 0, 1, 2) for y in (-2, 0, 2)]


def test_sizes_of_hard_particles_are_those_of_their_shapes(tmp_path):
    shapes = [{"type": "Sphere", "diameter": 0.25}, {"type": "Sphere", "diameter": 0.75}]
    kinds = np.arange(15) % 2
    frame = hoomd_file(
        tmp_path / "a.gsd", GRID, types=["A", "B"], typeid=kinds, type_shapes=shapes, diameter=[3.0] * 15
    )[0]
    assert frame.radius.tolist() == [(0.125, 0.375)[kind] for kind in kinds], (
        "and not the diameters, which are not used"
    )
    same = hoomd_file(tmp_path / "b.gsd", GRID, diameter=[3.0] * 15)[0]
    assert same.radius.tolist() == [1.5] * 15, "negative control: a file without shapes"


@pytest.mark.parametrize(
    "shape",
    [{"type": "Polygon", "vertices": [[0, 0], [1, 0], [0, 1]]}, {"type": "Sphere"}, {"type": "Ellipsoid", "a": 1}],
)
def test_other_shapes_than_discs_are_refused(tmp_path, shape):
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"frame 0 of .* must hold discs, of shape Sphere with a diameter above"
    ):
        hoomd_file(tmp_path / "a.gsd", GRID, types=["A"], type_shapes=[shape])[0]


def test_a_shape_that_no_disc_has_does_not_matter(tmp_path):
    shapes = [{"type": "Sphere", "diameter": 0.5}, {"type": "Polygon"}]
    assert hoomd_file(tmp_path / "a.gsd", GRID, types=["A", "B"], type_shapes=shapes)[0].radius.tolist() == [0.25] * 15


def test_what_a_gsd_file_does_not_hold_stays_absent(tmp_path):
    frame = hoomd_file(tmp_path / "a.gsd", GRID)[0]
    for name in ("velocity", "radius", "mass", "image"):
        with pytest.raises(mpsim.errors.TrajectoryError, match=f"{name} must be in a trajectory to be read from it"):
            getattr(frame, name)
    full = hoomd_file(
        tmp_path / "b.gsd", GRID, velocity=GRID, diameter=[2.0] * 15, mass=[3.0] * 15, image=[(1, 0, 0)] * 15
    )
    assert (full[0].velocity.tolist(), full[0].mass.tolist()) == ([[x, y] for x, y, _ in GRID], [3.0] * 15)
    assert (full[0].radius.tolist(), full[0].image.tolist()) == ([1.0] * 15, [[1, 0]] * 15)


def test_velocities_of_the_first_frame_are_not_those_of_later_ones(tmp_path):
    """HOOMD writes velocities into the first frame alone unless it is told to write them into all."""
    trajectory = hoomd_file(tmp_path / "a.gsd", GRID, frames=3, velocity=GRID, mass=[2.0] * 15)
    assert trajectory[0].velocity[0].tolist() == [-2, -2]
    assert trajectory[2].mass.tolist() == [2.0] * 15, "which stay the same"
    with pytest.raises(mpsim.errors.TrajectoryError, match="velocity must be in a trajectory"):
        trajectory[2].velocity  # noqa: B018


def test_zeros_that_hoomd_leaves_out_are_zeros_where_other_frames_have_more(tmp_path):
    made = gsd.hoomd.Frame()
    made.configuration.box, made.configuration.dimensions = [6, 6, 0, 0, 0, 0], 2
    with gsd.hoomd.open(str(tmp_path / "a.gsd"), "w") as out:
        for image in (0, 0, 1):
            made.particles.N, made.particles.position, made.particles.image = 1, [(image, 0, 0)], [(image, 0, 0)]
            out.append(made)
    assert [frame.image.tolist() for frame in mpsim.Trajectory(tmp_path / "a.gsd")] == [[[0, 0]], [[0, 0]], [[1, 0]]]


def test_a_gsd_frame_without_discs_is_read(tmp_path):
    frame = hoomd_file(tmp_path / "a.gsd", np.zeros((0, 3)))[0]
    assert (frame.box, frame.position.shape, frame.known) == ((6.0, 6.0), (0, 2), {})


def test_a_gsd_frame_without_places_is_refused(tmp_path):
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"frame 0 of .* must hold the places of its 2 discs; it does not"
    ):
        hoomd_file(tmp_path / "a.gsd", [(0, 0, 0)] * 2)[0]
    centre = hoomd_file(tmp_path / "b.gsd", [(0, 0, 0)])[0]
    assert centre.position.tolist() == [[3, 3]], "one disc at the centre, which is not written"


def test_places_that_are_no_numbers_are_refused_in_gsd(tmp_path):
    with pytest.raises(
        mpsim.errors.TrajectoryError, match=r"frame 0 of .* must hold finite numbers; got position .*nan.* of disc 1"
    ):
        hoomd_file(tmp_path / "a.gsd", [(0, 0, 0), (1, np.nan, 0)])[0]


# --- without velocities


def test_measures_of_positions_need_no_velocities_and_others_say_so(tmp_path):
    scene = gas(100, 0.4, boundary="periodic")
    rows = "".join(f"X {x!r} {y!r} 0\n" for x, y in scene.position.tolist())
    state = read(tmp_path, f'100\nLattice="{scene.width} 0 0 0 {scene.height} 0 0 0 1"\n{rows}').state
    whole = mpsim.State(scene.position, scene.velocity, box=scene.box)
    for of in (state, whole):
        assert measure.pair_correlation(of, scene, bins=5, r_max=3.0).value.tolist() == pytest.approx(
            measure.pair_correlation(whole, scene, bins=5, r_max=3.0).value.tolist()
        )
    assert measure.overlap(state, scene) == measure.overlap(whole, scene)
    assert measure.hexatic_order(state, scene).local == measure.hexatic_order(whole, scene).local
    for function in (measure.kinetic_energy, measure.temperature, measure.momentum):
        with pytest.raises(mpsim.InputError, match=r"velocity must be in a state for this; got <State: 100 discs"):
            function(state, scene)
        function(whole, scene)
    assert "velocity" not in state.save(tmp_path / "a.npz").read_bytes().decode("latin1")
    assert mpsim.State.load(tmp_path / "a.npz").digest() == state.digest() != whole.digest()


def test_a_picture_without_velocities_says_how_to_colour_it(tmp_path):
    frame = read(tmp_path, FRAME, radius=0.5)
    with pytest.raises(
        mpsim.InputError, match=r"colour must not be 'speed' of discs whose velocities are unknown\. Use"
    ):
        mpsim.draw(frame)
    mpsim.draw(frame, colour="radius")


# --- plain XYZ, and what is given


def test_what_a_file_does_not_hold_is_given(tmp_path):
    plain = f"2\nplain\n{ROWS}"
    frame = read(tmp_path, plain, box=(8, 6), radius=0.5)
    assert (frame.box, frame.origin, frame.periodic, frame.radius.tolist()) == (
        (8, 6),
        (0, 0),
        (True, True),
        [0.5, 0.5],
    )
    frame = read(tmp_path, plain, box=(-4, 4, -3, 5), boundary=["periodic", "walls"])
    assert (frame.box, frame.origin, frame.periodic) == ((8, 8), (-4, -3), (True, False))
    assert frame.state.box == (-4, 4, -3, 5)
    empty = read(tmp_path, f'2\nLattice="0 0 0 0 0 0 0 0 0"\n{ROWS}', box=(8, 6))
    assert empty.box == (8, 6), "a box of zeros stands for none"
    charged = read(tmp_path, "2\n\nX 1 1 0 .3\nX 3 2 0 .4\n", box=(8, 6))
    assert charged.position.tolist() == [[1, 1], [3, 2]], "further columns have no names"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"box": (9, 9)},
            r"box can be given only for frames that do not hold it; frame 0 of .* holds \(8.0, 6.0\). Leave",
        ),
        ({"boundary": "walls"}, r"boundary can be given only for frames that do not hold it; .* holds \(True, True\)"),
        ({"radius": 1.0}, "radius can be given only for frames that do not hold it; frame 0 of"),
        ({"box": (9,)}, r"box must be \(width, height\) or \(x_low, x_high, y_low, y_high\), with sides above 0; got"),
        ({"box": (0, 9)}, "with sides above 0; got"),
        ({"box": (3, 2, 0, 1)}, "with sides above 0; got"),
        ({"box": "9 9"}, "box must be numbers of shape"),
        ({"box": (9, np.nan)}, "box must be finite"),
        ({"boundary": "open"}, "boundary must be one of 'walls', 'periodic'; got 'open'"),
        ({"radius": 0}, "radius must be"),
        ({"raduis": 1}, "radius"),
    ],
)
def test_what_is_given_wrongly_is_refused(tmp_path, given, words):
    text = (
        FRAME.replace("pos:R:3", "pos:R:3:radius:R:1").replace("X 1 1 0", "X 1 1 0 .5").replace("X 3 2 0", "X 3 2 0 .5")
    )
    with pytest.raises((mpsim.InputError, TypeError), match=words):
        read(tmp_path, text, **given)


# --- LAMMPS


def test_a_dump_of_lammps_is_read(tmp_path):
    frame = read(tmp_path, DUMP, "a.lammpstrj")
    assert (frame.frame, frame.box, frame.origin, frame.periodic) == (70, (8, 8), (-4, -3), (True, False))
    assert (frame.ids.tolist(), frame.position.tolist()) == ([1, 2], [[-1, 2], [3.5, 1]]), "in the order of their ids"
    assert (frame.velocity.tolist(), frame.mass.tolist()) == ([[-1, 1], [0.5, 0.25]], [1, 2])
    assert frame.radius.tolist() == [0.5, 0.4]
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"time must be in a trajectory.*ITEM: TIME \(LAMMPS\)"):
        frame.time  # noqa: B018


PLACES = {
    "x y": ("3.5 1", "-1 2"),
    "x y z": ("3.5 1 7", "-1 2 7"),
    "xs ys zs": ("0.9375 0.5 0.5", "0.375 0.625 0.5"),
    "xu yu zu": ("3.5 1 0", "-1 2 0"),
    "xsu ysu zsu": ("0.9375 0.5 0.5", "0.375 0.625 0.5"),
    "xs ys zs x y z": ("9 9 9 3.5 1 0", "9 9 9 -1 2 0"),
}


@pytest.mark.parametrize("names", PLACES)
def test_places_are_read_in_all_coordinates_of_lammps(tmp_path, names):
    second, first = PLACES[names]
    text = DUMP[: DUMP.index("ITEM: ATOMS")] + f"ITEM: ATOMS id {names}\n2 {second}\n1 {first}\n"
    frame = read(tmp_path, text, "a.dump")
    assert frame.position.tolist() == [[-1, 2], [3.5, 1]]
    if "u" in names:
        assert frame.unwrapped.tolist() == frame.position.tolist(), "whatever border they are beyond"


def test_other_quantities_of_lammps_are_read(tmp_path):
    text = DUMP.replace("vx vy vz radius mass", "ix iy iz diameter omegaz q").replace(
        "0.5 0.25 0 0.4 2", "-1 0 0 0.8 7 9"
    )
    text = text.replace("-1 1 0 0.5 1", "2 0 0 1.0 -3 9").replace(
        "ITEM: TIMESTEP", "ITEM: UNITS\nlj\nITEM: TIME\n1.75\nITEM: TIMESTEP"
    )
    frame = read(tmp_path, text, "a.dump")
    assert (frame.radius.tolist(), frame.spin.tolist(), frame.time) == ([0.5, 0.4], [-3, 7], 1.75)
    assert frame.unwrapped.tolist() == [[15, 2], [-4.5, 1]]
    assert frame.state.unwrapped.tolist() == [[15, 2], [-4.5, 1]]


def test_flags_of_old_dumps_are_given(tmp_path):
    old = DUMP.replace(" pp ff pp", "")
    assert read(tmp_path, old, "a.dump").periodic == (True, True)
    assert read(tmp_path, old, "a.dump", boundary="walls").periodic == (False, False)
    upright = (
        DUMP.replace("BOUNDS", "BOUNDS xy xz yz")
        .replace("-4 4", "-4 4 0")
        .replace("-3 5", "-3 5 0")
        .replace(".5 0.5\n", ".5 0.5 0\n")
    )
    assert read(tmp_path, upright, "a.dump").box == (8, 8)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("-4 4", "-4 4 1", "line 5, must begin an upright rectangular box, with a lower and a higher bound"),
        (
            "-4 4\n-3 5\n-0.5 0.5",
            "-4 4 1\n-3 5 0\n-0.5 0.5 0",
            "must begin an upright rectangular box.*got 'BOX BOUNDS pp",
        ),
        ("-4 4", "4 -4", "must begin an upright rectangular box"),
        ("BOUNDS", "BOUNDS abc origin", "must begin an upright rectangular box"),
        ("-4 4", "-4 nan", "line 6, must hold finite numbers under ITEM: BOX BOUNDS; got 'nan'"),
        ("ITEM: TIMESTEP", "TIMESTEP", "line 1, must begin with ITEM: TIMESTEP, as a dump of LAMMPS; got b'TIMESTEP"),
        ("ATOMS\n2", "ATOMS\n-2", "line 4, must give the number of atoms; got b'-2"),
        ("x y z", "a b c", "line 9, must name columns x and y, or xs, xu or xsu; got 'id type a b c vx"),
        ("3.5 1 0", "3.5 1 1", "must be two-dimensional"),
        ("3.5 1 0", "3.5 nan 0", "line 10, must hold finite numbers in its column y"),
        ("0.4 2\n", "0.4\n", "line 10, must have 10 columns, as its ITEM: ATOMS says; got a line with 9"),
        ("2 1 3.5", "1 1 3.5", "must hold each id once; got 1 twice"),
        (
            "2 1 3.5",
            "2.5 1 3.5",
            "line 10, must hold numbers in its column id, whole ones of at most 64 bits; got '2.5'",
        ),
        ("0.4 2", "-0.4 2", "must hold no radius below 0; got -0.4"),
        ("BOX BOUNDS", "BOX", "line 1, must begin a frame with ITEM: NUMBER OF ATOMS, BOX BOUNDS and ATOMS"),
    ],
)
def test_a_dump_that_is_no_plane_in_a_box_is_refused(tmp_path, old, new, words):
    refused(tmp_path, DUMP.replace(old, new, 1), words, "a.dump")


def test_dumps_are_not_written(tmp_path):
    for name in ("a.dump", "a.lammpstrj", "a.xyz.gz"):
        with pytest.raises(
            mpsim.InputError, match=re.escape("a trajectory's path must end in .xyz, .extxyz, .gsd; got")
        ):
            mpsim.Trajectory.write(tmp_path / name)


def test_the_number_and_the_order_of_discs_may_change(tmp_path):
    one = DUMP.replace("ATOMS\n2", "ATOMS\n1").replace("2 1 3.5 1 0 0.5 0.25 0 0.4 2\n", "")
    turned = DUMP.replace("2 1 3.5", "0 1 3.5")
    (tmp_path / "a.dump").write_text(DUMP + one + turned)
    assert [frame.ids.tolist() for frame in mpsim.Trajectory(tmp_path / "a.dump")] == [[1, 2], [1], [0, 1]]
    assert [frame.position[0].tolist() for frame in mpsim.Trajectory(tmp_path / "a.dump")] == [
        [-1, 2],
        [-1, 2],
        [3.5, 1],
    ]


def test_discs_of_extended_xyz_are_in_the_order_of_their_ids(tmp_path):
    text = (
        FRAME.replace("pos:R:3", "pos:R:3:id:I:1:radius:R:1")
        .replace("1 1 0", "1 1 0 9 .1")
        .replace("3 2 0", "3 2 0 4 .2")
    )
    frame = read(tmp_path, text)
    assert (frame.ids.tolist(), frame.position.tolist()) == ([4, 9], [[3, 2], [1, 1]])
    assert frame.radius.tolist() == [0.2, 0.1]
    refused(tmp_path, text.replace("0 9 ", "0 4 "), "must hold each id once; got 4 twice")


# --- compressed


def test_a_compressed_file_is_read_in_any_order_and_grows(tmp_path):
    written(tmp_path / "run.xyz", gas(30, 0.3), 12, 2)
    whole = (tmp_path / "run.xyz").read_bytes()
    (tmp_path / "run.xyz.gz").write_bytes(gzip.compress(whole))
    assert content(tmp_path / "run.xyz.gz") == content(tmp_path / "run.xyz")
    trajectory = mpsim.Trajectory(tmp_path / "run.xyz.gz")
    assert [trajectory[index].frame for index in (6, 0, 3, 1)] == [12, 0, 6, 2]
    (tmp_path / "run.xyz.gz").write_bytes(gzip.compress(whole) + gzip.compress(FRAME.encode()))
    assert trajectory.refresh() == 8
    assert trajectory[7].position.tolist() == [[1, 1], [3, 2]]
    dump = read(tmp_path, gzip.compress(DUMP.encode()), "a.LAMMPSTRJ.gz")
    assert dump.ids.tolist() == [1, 2]


def test_a_compressed_file_that_is_damaged_is_refused(tmp_path):
    written(tmp_path / "run.xyz", gas(30, 0.3), 12, 2)
    packed = gzip.compress((tmp_path / "run.xyz").read_bytes())
    path = tmp_path / "b.xyz.gz"
    for damaged in (b"no gzip", packed[:500] + b"\xff" * 10 + packed[510:], packed[:-8] + b"\0" * 8):
        path.write_bytes(damaged)
        with pytest.raises(
            mpsim.errors.TrajectoryError, match=r"ends in .gz must be compressed by gzip; frame \d of .*b.xyz.gz'"
        ):
            mpsim.Trajectory(path)
    path.write_bytes(packed[: len(packed) // 2])
    with pytest.warns(mpsim.errors.TrajectoryWarning, match="ends in the middle of a frame"):
        trajectory = mpsim.Trajectory(path)
    whole = mpsim.Trajectory(tmp_path / "run.xyz")
    assert 0 < len(trajectory) < len(whole)
    assert [frame.state.digest() for frame in trajectory] == [
        frame.state.digest() for frame in whole[: len(trajectory)]
    ]
    packer = zlib.compressobj(wbits=31)
    path.write_bytes(packer.compress(FRAME.encode() * 2) + packer.flush(zlib.Z_FULL_FLUSH))  # as a file that is written
    assert len(mpsim.Trajectory(path)) == 2, "without a warning: nothing is lost"
