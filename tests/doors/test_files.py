"""Trajectories of other programs: what is read from them, what is refused by name, and what stays absent."""

import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas
from support.trajectories import written

import mpsim
from mpsim import measure

pytestmark = pytest.mark.plain

LATTICE = 'Lattice="8 0 0 0 6 0 0 0 1"'
ROWS = "X 1 1 0\nX 3 2 0\n"
FRAME = f'2\n{LATTICE} Properties=species:S:1:pos:R:3 pbc="T T F"\n{ROWS}'


def read(tmp_path, text, name="a.xyz", **given):
    """The only frame of a file with this text."""
    (tmp_path / name).write_text(text)
    (frame,) = mpsim.Trajectory(tmp_path / name, **given)
    return frame


def refused(tmp_path, text, words, name="a.xyz", **given):
    """The file is refused, by an error that names it, the frame and, in words, the rest."""
    with pytest.raises(mpsim.errors.TrajectoryError, match=words) as caught:
        read(tmp_path, text, name, **given)
    assert f"frame 0 of '{tmp_path / name}'" in str(caught.value)


# --- extended XYZ

PERIODIC = {
    **dict.fromkeys(
        ['"T T F"', "'T T F'", '"T, T, F"', "{t t f}", "[true,true,false]", "T", "1", '"T T"'], (True, True)
    ),
    **dict.fromkeys(['"TRUE FALSE FALSE"', "T F F", "[True, False, True]", '"1 0 0"', "T,F,F"], (True, False)),
    **dict.fromkeys(["F", "FALSE", "0", '"f f t"', "[F F T]"], (False, False)),
}


def test_periodic_axes_are_read_in_every_spelling(tmp_path):
    for value, axes in PERIODIC.items():
        for key in ("pbc=", "PBC = "):
            text = f"2\n{LATTICE} {key}{value} Properties=species:S:1:pos:R:3\n{ROWS}"
            assert read(tmp_path, text).periodic == axes, (key, value)
    for value in ('"T T maybe"', '"2 0 0"', '""', '"T T F F"'):
        refused(
            tmp_path,
            f"2\n{LATTICE} pbc={value}\n{ROWS}",
            "line 2 of it, must say under pbc which axes are periodic, such",
        )


SAME = {
    "blank lines before and after": "\n \n" + FRAME + "\n" * 25,
    "a wide count": FRAME.replace("2\n", f"{2:21d}\n", 1),
    "single quotes": FRAME.replace('"', "'"),
    "brackets": FRAME.replace('"8 0 0 0 6 0 0 0 1"', "[[8, 0, 0], [0, 6, 0], [0, 0, 1]]"),
    "braces": FRAME.replace('"8 0 0 0 6 0 0 0 1"', "{8 0 0 0 6 0 0 0 1}"),
    "bare numbers": FRAME.replace('"8 0 0 0 6 0 0 0 1"', "8 0 0 0 6 0 0 0 1"),
    "lower case": FRAME.replace("Lattice", "lattice").replace("Properties", "properties"),
    "upper case": FRAME.replace("Lattice", "LATTICE").replace("Properties", "PROPERTIES"),
    "off the axes by rounding": FRAME.replace('"8 0 0', '"8 1e-17 0'),
    "lines that end as on Windows": FRAME.replace("\n", "\r\n"),
    "keys within a text": FRAME.replace("pbc", r"""note="a \" Lattice='1 0 0' pbc=F" pbc"""),
    "a text alone": FRAME.replace("pbc", """"a Lattice='1 0 0' text" it's pbc"""),
    "a label that is no element": FRAME.replace("X 1", "disc 1").replace("species", "Type"),
}


def test_what_other_programs_write_differently_is_the_same(tmp_path):
    for name, text in SAME.items():
        frame = read(tmp_path, text)
        found = frame.position.tolist(), frame.box, frame.periodic
        assert found == ([[1, 1], [3, 2]], (8.0, 6.0), (True, True)), name
        assert frame.frame == 0, "its index, where the file does not say"


def test_blank_lines_between_frames_and_the_smallest_columns_are_read(tmp_path):
    (tmp_path / "a.xyz").write_text(f"{FRAME}\n \n{FRAME.replace('X 1', 'X 2')}\n\n{FRAME}")
    assert [frame.position[0, 0] for frame in mpsim.Trajectory(tmp_path / "a.xyz")] == [1, 2, 1]
    for end in ("\n", "\n\n", "\n \n"):
        frame = read(tmp_path, '1\nLattice="5 0 0 0 5 0 0 0 1"\nX 1 2 3' + end)
        assert (frame.position.tolist(), frame.ids.tolist()) == ([[1, 2]], [0])
    two = read(tmp_path, f"1\n{LATTICE} Properties=pos:R:2:velo:R:2\n1 2 3 4\n")
    assert (two.position.tolist(), two.velocity.tolist()) == ([[1, 2]], [[3, 4]])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("2\n", "hello\n", r"line 1 of it, must give the number of discs where a frame begins; got b'hello\\n'"),
        (LATTICE, "plain", "line 2 of it, must hold the box, the key Lattice of extended XYZ; it is 'plain"),
        ("8 0 0 0 6 0 0 0 1", "0 0 0 0 0 0 0 0 0", "line 2 of it, must hold the box, the key Lattice of extended XYZ"),
        ("8 0 0 0", "-8 0 0 0", "line 2 of it, must have an upright rectangular box with sides above 0.*got '-8 0 0"),
        ("8 0 0 0", "8 0 0 1", "line 2 of it, must have an upright rectangular box with sides above 0"),
        ("8 0 0 0 6 0 0 0 1", "8 0 0 6", "line 2 of it, must have an upright rectangular box with sides above 0"),
        ("8 0 0 0", "1e999 0 0 0", "line 2 of it, must hold finite numbers under Lattice; got '1e999'"),
        ("X 3 2", "X nan 2", r"line 4 of it, must hold finite numbers in its column pos; got \[nan"),
        (
            "X 3 2",
            "X ***** 2",
            r"line 3 of it, and those below must have 4 columns.*got could not convert string '\*\*\*\*\*'",
        ),
        ("X 3 2", "X 3", "must have 4 columns, as its Properties say, with numbers"),
        ("X 1 1 0\n", "\n", "must have 4 columns, as its Properties say.*got a blank line"),
        ("species:S:1:pos:R:3", "species:S:1", "must have the column pos:R:3, the places"),
        ("species:S:1:pos:R:3", "pos:R:2:velo:R:1", "must have a column velo of 2 numbers or more; got 1"),
        ("pbc", "Origin=1 pbc", "line 2 of it, must have the corner of its box under Origin, 'x y z'; got '1'"),
    ],
)
def test_damage_is_refused_by_its_line(tmp_path, old, new, words):
    refused(tmp_path, FRAME.replace(old, new, 1), words)


def test_what_is_named_twice_or_is_below_0_is_refused(tmp_path):
    sized = FRAME.replace("pos:R:3", "pos:R:3:id:I:1:radius:R:1")
    sized = sized.replace("1 1 0", "1 1 0 9 .1").replace("3 2 0", "3 2 0 4 .2")
    frame = read(tmp_path, sized)
    assert (frame.ids.tolist(), frame.position.tolist()) == ([4, 9], [[3, 2], [1, 1]]), "in the order of their numbers"
    assert frame.radius.tolist() == [0.2, 0.1]
    refused(tmp_path, sized.replace("0 9 ", "0 4 "), "must hold each id once; got 4 twice")
    refused(tmp_path, sized.replace(".2", "-.5").replace("radius", "masses"), "must hold no mass below 0; got -0.5")


def test_the_corner_and_momenta_over_masses_are_read(tmp_path):
    head = f'{LATTICE} Origin="-4 -3 0" Time=0.5 Frame=7 Properties=species:S:1:pos:R:3:masses:R:1:momenta:R:3'
    frame = read(tmp_path, f"2\n{head}\nX 1 1 0 2 2 1 0\nX 3 2 0 4 -2 1 0\n")
    assert (frame.origin, frame.time, frame.frame) == ((-4, -3), 0.5, 7)
    assert (frame.velocity.tolist(), frame.mass.tolist()) == ([[1, 0.5], [-0.5, 0.25]], [2, 4])
    assert frame.state.box == (-4, 4, -3, 3)
    assert read(tmp_path, FRAME.replace("pbc", 'Origin="-4 -3" pbc')).origin == (-4, -3), "without a z"
    bare = read(tmp_path, f"1\n{head.replace(':masses:R:1', '')}\nX 1 1 0 2 1 0\n")
    text = (
        "velocity must be in a trajectory to be read from it; .* holds only position, time. Have the program that wro"
    )
    with pytest.raises(mpsim.errors.TrajectoryError, match=text):
        bare.velocity  # noqa: B018
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"radius must be in .*, or give Trajectory\(path, radius"):
        bare.radius  # noqa: B018
    images = read(tmp_path, f"1\n{LATTICE} Properties=pos:R:3:map_shift:I:3 pbc=T\n1 1 0 2 -1 0\n")
    assert (images.image.tolist(), images.unwrapped.tolist()) == ([[2, -1]], [[17, -5]])


# --- cut off


def test_a_file_cut_off_anywhere_has_its_whole_frames(tmp_path):
    for cut in range(1, len(FRAME), 2):
        (tmp_path / "a.xyz").write_text((FRAME * 2)[:-cut])
        with pytest.warns(mpsim.errors.TrajectoryWarning, match="ends in the middle of a frame"):
            trajectory = mpsim.Trajectory(tmp_path / "a.xyz")
        assert [len(frame.position) for frame in trajectory] == [2]


# --- dimensions


@pytest.mark.parametrize("thickness", [0, 1, 6])
def test_discs_that_are_in_no_plane_or_leave_it_are_refused(tmp_path, thickness):
    solid = FRAME.replace("X 3 2 0", "X 1 1 1.5").replace("0 0 1", f"0 0 {thickness}")
    refused(tmp_path, solid, r"must be two-dimensional, with the same z for all discs.*z = 1.5 of disc 1, not 0\.")
    for flat in ("1.5", "1.50000001"):
        assert read(tmp_path, solid.replace("X 1 1 0", f"X 2 1 {flat}")).position.tolist() == [[2, 1], [1, 1]]
    rising = FRAME.replace("pos:R:3", "pos:R:3:velo:R:3")
    rising = rising.replace("X 1 1 0", "X 1 1 0 1 0 0").replace("3 2 0", "3 2 0 0 1 1")
    refused(tmp_path, rising, r"must be two-dimensional.* got a velocity with z = 1 of disc 1, not 0\.")
    assert read(tmp_path, rising.replace("0 1 1", "0 1 0")).velocity.tolist() == [[1, 0], [0, 1]]


# --- GSD


def test_gsd_of_another_program_is_refused_with_what_to_do(tmp_path):
    made = gsd.hoomd.Frame()
    made.configuration.box, made.particles.N = [6, 6, 0, 0, 0, 0], 2
    made.particles.position = np.array([(1, 0, 0), (2, 0, 0)], np.float32)
    with gsd.hoomd.open(str(tmp_path / "a.gsd"), "w") as out:
        out.append(made)
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"frame 0 of .* must hold the box under log/mpsim/box"):
        mpsim.Trajectory(tmp_path / "a.gsd")[0]


def test_a_file_of_mpsim_without_masses_is_read_and_not_continued(tmp_path):
    path = tmp_path / "old.xyz"
    path.write_text(
        '1\nLattice="8.0 0.0 0.0 0.0 6.0 0.0 0.0 0.0 1.0" Properties=species:S:1:pos:R:3:radius:R:1:velo:R:3:id:I:1 '
        'Time=0.0 pbc="F F F" Frame=0 precision=float64\nX 1.5 2.0 0.0 0.5 3.0 4.0 0.0 0\n'
    )
    frame, before = mpsim.Trajectory(path)[-1], path.read_bytes()
    assert (frame.position.tolist(), frame.velocity.tolist(), frame.radius.tolist()) == ([[1.5, 2]], [[3, 4]], [0.5])
    assert (frame.box, frame.origin, frame.time, frame.ids.tolist()) == ((8, 6), (0, 0), 0, [0])
    with pytest.raises(mpsim.errors.TrajectoryError, match=r"mass must be in a trajectory to .* masses:R:1"):
        frame.mass  # noqa: B018
    scene = mpsim.Scene(width=8, height=6, position=[[1.5, 2]], velocity=[[3, 4]], radius=0.5)
    with pytest.raises(mpsim.errors.OutputError, match=r"must hold masses to be continued, .* by an earlier version"):
        written(path, scene, mode="a", method="naive")
    assert path.read_bytes() == before


# --- plain XYZ, and what is given


def test_what_a_file_does_not_hold_is_given(tmp_path):
    plain = f"2\nplain\n{ROWS}"
    frame = read(tmp_path, plain, box=(8, 6), radius=0.5)
    assert (frame.box, frame.origin, frame.periodic) == ((8, 6), (0, 0), (True, True))
    assert frame.radius.tolist() == [0.5, 0.5]
    frame = read(tmp_path, plain, box=(-4, 4, -3, 5), boundary=["periodic", "walls"])
    assert (frame.box, frame.origin, frame.periodic) == ((8, 8), (-4, -3), (True, False))
    assert frame.state.box == (-4, 4, -3, 5)
    empty = read(tmp_path, f'2\nLattice="0 0 0 0 0 0 0 0 0"\n{ROWS}', box=(8, 6))
    assert empty.box == (8, 6), "a box of zeros stands for none"
    charged = read(tmp_path, "2\n\nX 1 1 0 .3\nX 3 2 0 .4\n", box=(8, 6))
    assert charged.position.tolist() == [[1, 1], [3, 2]], "further columns have no names"
    sized = FRAME.replace("pos:R:3", "pos:R:3:radius:R:1").replace("1 1 0", "1 1 0 .5").replace("3 2 0", "3 2 0 .5")
    for given, words in (
        ({"box": (9, 9)}, r"box can be given only for frames that do not hold it; frame 0 of .* holds \(\(8.0, 6.0\)"),
        ({"boundary": "walls"}, r"boundary can be given only for frames that do not hold it; .* holds \(True, True\)"),
        ({"radius": 1.0}, "radius can be given only for frames that do not hold it; frame 0 of"),
        ({"box": (9,)}, r"box must be \(width, height\) or \(x_low, x_high, y_low, y_high\), with sides above 0; got"),
        ({"box": (3, 2, 0, 1)}, "with sides above 0; got"),
        ({"box": "9 9"}, "box must be numbers of shape"),
        ({"boundary": "open"}, "boundary must be one of 'walls', 'periodic'; got 'open'"),
        ({"radius": 0}, "radius must be"),
    ):
        with pytest.raises(mpsim.InputError, match=words):
            read(tmp_path, sized, **given)


def test_measures_and_pictures_of_positions_need_no_velocities_and_others_say_so(tmp_path):
    scene = gas(40, 0.4, boundary="periodic")
    rows = "".join(f"X {x!r} {y!r} 0\n" for x, y in scene.position.tolist())
    frame = read(tmp_path, f'40\nLattice="{scene.width} 0 0 0 {scene.height} 0 0 0 1"\n{rows}', radius=0.5)
    state, whole = frame.state, mpsim.State(scene.position, scene.velocity, box=scene.box)
    one, other = (measure.pair_correlation(of, scene, bins=5, r_max=2.5).value.tolist() for of in (state, whole))
    assert one == other
    assert measure.overlap(state, scene) == measure.overlap(whole, scene)
    for function in (measure.kinetic_energy, measure.temperature, measure.momentum):
        with pytest.raises(mpsim.InputError, match=r"velocity must be in a state for this; got <State: 40 discs"):
            function(state, scene)
        function(whole, scene)
    assert mpsim.State.load(state.save(tmp_path / "a.npz")).digest() == state.digest() != whole.digest()
    with pytest.raises(mpsim.InputError, match=r"colour must not be 'speed' of discs whose velocities are unknown\."):
        mpsim.draw(frame)
    mpsim.draw(frame, colour="radius")
