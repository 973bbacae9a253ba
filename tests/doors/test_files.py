"""Trajectories of other programs: what is read from them, what is refused by name, and what stays absent."""

import gzip
import zlib

import gsd.hoomd
import numpy as np
import pytest
from support.scenes import gas
from support.trajectories import DT, SCENES, content, written

import mpsim
from mpsim import measure
from mpsim.errors import TrajectoryError, TrajectoryWarning

pytestmark = pytest.mark.plain

LATTICE = 'Lattice="8 0 0 0 6 0 0 0 1"'
ROWS = "X 1 1 0\nX 3 2 0\n"
FRAME = f'2\n{LATTICE} Properties=species:S:1:pos:R:3 pbc="T T F"\n{ROWS}'
BOX = "-4 4\n-3 5\n-0.5 0.5\n"
DUMP = f"""ITEM: TIMESTEP
70
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp ff pp
{BOX}ITEM: ATOMS id type x y z vx vy vz radius mass
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
    with pytest.raises(TrajectoryError, match=words) as caught:
        read(tmp_path, text, name, **given)
    assert f"frame 0 of '{tmp_path / name}'" in str(caught.value)


# --- extended XYZ

PERIODIC = {'"T T F"': (True, True), "'t t f'": (True, True), '"T F F"': (True, False), '"F F T"': (False, False)}


def test_periodic_axes_are_read_as_ase_and_ovito_write_them(tmp_path):
    for value, axes in PERIODIC.items():
        for key in ("pbc=", "PBC = "):
            text = f"2\n{LATTICE} {key}{value} Properties=species:S:1:pos:R:3\n{ROWS}"
            assert read(tmp_path, text).periodic == axes, (key, value)
    for value in ('"T T maybe"', '"2 0 0"', '""', '"T T F F"'):
        refused(tmp_path, f"2\n{LATTICE} pbc={value}\n{ROWS}", "line 2, must say which axes are periodic, such as pbc")


SAME = {
    "blank lines before and after": "\n \n" + FRAME + "\n" * 25,
    "a wide count": FRAME.replace("2\n", f"{2:21d}\n", 1),
    "single quotes": FRAME.replace('"', "'"),
    "lower case": FRAME.replace("Lattice", "lattice").replace("Properties", "properties"),
    "upper case": FRAME.replace("Lattice", "LATTICE").replace("Properties", "PROPERTIES"),
    "exponents of Fortran": FRAME.replace('"8 0', '"0.8d1 0').replace("X 3 2", "X 0.3D+1 20.d-1"),
    "a byte order mark": "\ufeff" + FRAME,
    "off the axes by rounding": FRAME.replace('"8 0 0', '"8 1e-17 0'),
    "lines that end as on Windows": FRAME.replace("\n", "\r\n"),
    "keys within a text": FRAME.replace("pbc", r"""note="a \" Lattice='1 0 0' pbc=F" pbc"""),
    "a text alone": FRAME.replace("pbc", """"a Lattice='1 0 0' text" it's pbc"""),
    "a name of two columns that are not read": FRAME.replace("3 pbc", "3:q:S:1:q:S:1 pbc").replace(" 0\n", " 0 a b\n"),
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
        ("2\n", "hello\n", r"line 1, must give the number of discs where a frame begins; got b'hello\\n'"),
        (LATTICE, "plain", "must hold the box, as the key Lattice of extended XYZ; it does not. Have the"),
        ("8 0 0 0 6 0 0 0 1", "0 0 0 0 0 0 0 0 0", "must hold the box, as the key Lattice of extended XYZ"),
        ("8 0 0 0", "-8 0 0 0", "line 2, must have an upright rectangular box with sides above 0.*got '-8 0 0"),
        ("8 0 0 0", "8 0 0 1", "line 2, must have an upright rectangular box with sides above 0"),
        ("8 0 0 0 6 0 0 0 1", "8 6 1", "line 2, must hold 9 finite numbers under Lattice; got '8 6 1'"),
        ("8 0 0 0", "1e999 0 0 0", "line 2, must hold 9 finite numbers under Lattice; got '1e999"),
        ("X 3 2", "X nan 2", r"line 4, must hold finite numbers in its column pos; got \[nan"),
        ("X 3 2", "X ***** 2", r"line 4, must hold numbers in its column pos; got '\*\*\*\*\*'"),
        ("X 3 2", "X 3", "line 4, must have 4 columns, as its Properties say; got a line with 3"),
        ("X 1 1 0\n", "\n", "line 3, must have 4 columns, as its Properties say; got a line with 0"),
        (FRAME, f"1\n{LATTICE}\nX 1 1\n", r"line 3, must have 4 columns, as each line of plain XYZ has \(name, x, y"),
        ("pos:R:3", "pos:R:3:pos:R:3", "line 2, must name each column once; got 'species pos pos'"),
        ("species:S:1:pos:R:3", "species:S:1", "must have the column pos:R:3, the places"),
        ("species:S:1:pos:R:3", "pos:R:2:velo:R:1", "must have a column velo of 2 numbers or more; got 1"),
        ("pbc", "Origin=1 pbc", "line 2, must hold 2 finite numbers under Origin; got '1'"),
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
    with pytest.raises(TrajectoryError, match=text):
        bare.velocity  # noqa: B018
    with pytest.raises(TrajectoryError, match=r"radius must be in .*, or give Trajectory\(path, radius"):
        bare.radius  # noqa: B018
    images = read(tmp_path, f"1\n{LATTICE} Properties=pos:R:3:map_shift:I:3 pbc='T T F'\n1 1 0 2 -1 0\n")
    assert (images.image.tolist(), images.unwrapped.tolist()) == ([[2, -1]], [[17, -5]])


def test_time_steps_of_lammps_are_the_numbers_of_frames(tmp_path):
    head = f'Timestep=3000 Time=0.75 pbc="T T F" {LATTICE} Properties=species:S:1:pos:R:3:vel:R:3:forces:R:3:mass:R:1'
    frame = read(tmp_path, f"1\n{head}\nA 1 -2 0 0.5 0.25 0 9 9 9 2\n")
    assert (frame.frame, frame.time, frame.velocity.tolist(), frame.mass.tolist()) == (3000, 0.75, [[0.5, 0.25]], [2])


# --- cut off


@pytest.mark.parametrize("text", [FRAME, DUMP], ids=["xyz", "dump"])
@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_off_anywhere_has_its_whole_frames(tmp_path, text, compressed):
    """Cut within the last number, it is the file of a program that writes no newline at its end, which is said."""
    frames, path = 2, tmp_path / f"a.{'xyz' if text is FRAME else 'dump'}{'.gz' * compressed}"
    for cut in range(1, len(text), 2 + 5 * compressed):
        whole = (text * frames)[:-cut].encode()
        path.write_bytes(gzip.compress(whole) if compressed else whole)
        left = text[: len(text) - cut].splitlines()
        complete = len(left) == len(text.splitlines()) and len(left[-1].split()) == len(text.splitlines()[-1].split())
        says = f"in the middle of a frame, as after a kill; .* Its {frames - 1} complete frames can be read"
        says = "ends without the end of a line. Its last frame is read" if complete else says
        with pytest.warns(TrajectoryWarning, match=says):
            trajectory = mpsim.Trajectory(path)
        assert len(trajectory) == frames - 1 + complete
        assert [len(frame.position) for frame in trajectory] == [2] * len(trajectory)


def test_a_compressed_file_is_read_in_any_order_and_grows(tmp_path):
    written(tmp_path / "run.xyz", gas(5, 0.1), 12, 2, method="naive")
    whole, packed = (tmp_path / "run.xyz").read_bytes(), tmp_path / "run.xyz.gz"
    packed.write_bytes(gzip.compress(whole))
    assert content(packed) == content(tmp_path / "run.xyz")
    trajectory = mpsim.Trajectory(packed)
    assert [trajectory[index].frame for index in (6, 0, 3, 1)] == [12, 0, 6, 2]
    packed.unlink()  # the file that was read is still open
    packed.write_bytes(gzip.compress(whole) + gzip.compress(FRAME.encode()))
    assert trajectory.refresh() == 8
    assert trajectory[7].position.tolist() == [[1, 1], [3, 2]]
    assert read(tmp_path, gzip.compress(DUMP.encode()), "a.LAMMPSTRJ.gz").ids.tolist() == [1, 2]


def test_a_compressed_file_that_is_damaged_is_refused(tmp_path):
    written(tmp_path / "run.xyz", gas(5, 0.1), 12, 2, method="naive")
    packed, path = gzip.compress((tmp_path / "run.xyz").read_bytes()), tmp_path / "b.xyz.gz"
    for damaged in (b"no gzip", packed[:500] + b"\xff" * 10 + packed[510:], packed[:-8] + b"\0" * 8):
        path.write_bytes(damaged)
        with pytest.raises(TrajectoryError, match=r"must be a file that can be read; .*b.xyz.gz' cannot \("):
            mpsim.Trajectory(path)
    path.write_bytes(packed[: len(packed) // 2])
    with pytest.warns(TrajectoryWarning, match="ends in the middle of a frame"):
        found = content(path)
    whole = content(tmp_path / "run.xyz")
    assert 0 < len(found) < len(whole)
    assert found == whole[: len(found)]
    packer = zlib.compressobj(wbits=31)
    path.write_bytes(packer.compress(FRAME.encode() * 2) + packer.flush(zlib.Z_FULL_FLUSH))  # as a file that is written
    assert len(mpsim.Trajectory(path)) == 2, "without a warning: nothing is lost"


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


GRID = [(x, y, 0) for x in (-2, -1, 0, 1, 2) for y in (-2, 0, 2)]


def test_gsd_of_another_program_is_read_as_far_as_it_goes(tmp_path):
    frames = hoomd_file(tmp_path / "a.gsd", GRID, frames=2, box=[8, 6, 0, 0, 0, 0])
    assert (frames[0].box, frames[0].origin, frames[0].periodic) == ((8, 6), (0, 0), (True, True))
    assert frames[0].position.tolist() == [[x + 4, y + 3] for x, y, _ in GRID], "from the corner"
    assert [frame.frame for frame in frames] == [0, 10]
    for name in ("velocity", "time"):
        with pytest.raises(TrajectoryError, match=f"{name} must be in a trajectory to be read from it"):
            getattr(frames[0], name)
    full = hoomd_file(
        tmp_path / "b.gsd", GRID, velocity=GRID, diameter=[2.0] * 15, mass=[3.0] * 15, image=[(1, 0, 0)] * 15
    )[0]
    assert (full.velocity.tolist(), full.mass.tolist()) == ([[x, y] for x, y, _ in GRID], [3.0] * 15)
    assert (full.radius.tolist(), full.image.tolist()) == ([1.0] * 15, [[1, 0]] * 15)


def test_sizes_of_hard_particles_are_those_of_their_shapes(tmp_path):
    shapes = [{"type": "Sphere", "diameter": 0.25}, {"type": "Sphere", "diameter": 0.75}]
    kinds = np.arange(15) % 2
    more = {"types": ["A", "B"], "diameter": [3.0] * 15}
    frame = hoomd_file(tmp_path / "a.gsd", GRID, typeid=kinds, type_shapes=shapes, **more)[0]
    assert frame.radius.tolist() == [(0.125, 0.375)[kind] for kind in kinds], "not the diameters, which are not used"
    assert hoomd_file(tmp_path / "b.gsd", GRID, diameter=[3.0] * 15)[0].radius.tolist() == [1.5] * 15, "the control"
    unused = [{"type": "Sphere", "diameter": 0.5}, {"type": "Polygon"}]
    assert hoomd_file(tmp_path / "c.gsd", GRID, type_shapes=unused, **more)[0].radius.tolist() == [0.25] * 15
    for shape in ({"type": "Polygon", "vertices": [[0, 0], [1, 0], [0, 1]]}, {"type": "Sphere"}):
        with pytest.raises(TrajectoryError, match=r"frame 0 of .* must hold discs, of shape Sphere with a"):
            hoomd_file(tmp_path / "d.gsd", GRID, types=["A"], type_shapes=[shape])[0]


def test_what_hoomd_leaves_out_of_later_frames_is_what_it_means(tmp_path):
    """It writes velocities into the first frame alone unless it is told to write them into all, and no zeros."""
    trajectory = hoomd_file(tmp_path / "a.gsd", GRID, frames=3, velocity=GRID, mass=[2.0] * 15)
    assert trajectory[0].velocity[0].tolist() == [-2, -2]
    assert trajectory[2].mass.tolist() == [2.0] * 15, "which stay the same"
    with pytest.raises(TrajectoryError, match="velocity must be in a trajectory"):
        trajectory[2].velocity  # noqa: B018
    made = gsd.hoomd.Frame()
    made.configuration.box, made.configuration.dimensions = [6, 6, 0, 0, 0, 0], 2
    with gsd.hoomd.open(str(tmp_path / "b.gsd"), "w") as out:
        for image in (0, 0, 1):
            made.particles.N, made.particles.position, made.particles.image = 1, [(image, 0, 0)], [(image, 0, 0)]
            out.append(made)
    assert [frame.image.tolist() for frame in mpsim.Trajectory(tmp_path / "b.gsd")] == [[[0, 0]], [[0, 0]], [[1, 0]]]


def test_gsd_without_discs_is_read_and_without_places_or_a_plane_refused(tmp_path):
    frame = hoomd_file(tmp_path / "a.gsd", np.zeros((0, 3)))[0]
    assert (frame.box, frame.position.shape, frame.known) == ((6.0, 6.0), (0, 2), {})
    cube = {"box": [6, 6, 6, 0, 0, 0], "dimensions": 3}
    assert hoomd_file(tmp_path / "c.gsd", [(1, 0, 1.5), (2, 0, 1.5)], **cube)[0].position.tolist() == [[4, 3], [5, 3]]
    for positions, more, words in (
        ([(0, 0, 0)] * 2, {}, "must hold the places of its 2 discs; it does not"),
        ([(0, 0, 0), (1, np.nan, 0)], {}, "must hold finite numbers; got position .*nan.* of disc 1"),
        ([(1, 0, 1.5), (1, 0, -1.5)], cube, "must be two-dimensional"),
        (GRID, {"box": [6, 6, 0, 0.5, 0, 0]}, "must have an upright rectangular box"),
    ):
        with pytest.raises(TrajectoryError, match=f"frame 0 of .* {words}"):
            hoomd_file(tmp_path / "d.gsd", positions, **more)[0]


def test_a_file_of_mpsim_without_masses_is_read_and_not_continued(tmp_path):
    path = tmp_path / "old.xyz"
    path.write_text(
        '1\nLattice="8.0 0.0 0.0 0.0 6.0 0.0 0.0 0.0 1.0" Properties=species:S:1:pos:R:3:radius:R:1:velo:R:3:id:I:1 '
        'Time=0.0 pbc="F F F" Frame=0 precision=float64\nX 1.5 2.0 0.0 0.5 3.0 4.0 0.0 0\n'
    )
    frame, before = mpsim.Trajectory(path)[-1], path.read_bytes()
    assert (frame.position.tolist(), frame.velocity.tolist(), frame.radius.tolist()) == ([[1.5, 2]], [[3, 4]], [0.5])
    assert (frame.box, frame.origin, frame.time, frame.ids.tolist()) == ((8, 6), (0, 0), 0, [0])
    with pytest.raises(TrajectoryError, match=r"mass must be in a trajectory to .* masses:R:1"):
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
        ({"box": (9, 9)}, r"box can be given only for frames that do not hold it; frame 0 of .* holds \(8.0, 6.0\). L"),
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
    assert measure.overlap(state, scene) == measure.overlap(whole, scene)
    for function in (measure.kinetic_energy, measure.temperature, measure.momentum):
        with pytest.raises(mpsim.InputError, match=r"velocity must be in a state for this; got <State: 40 discs"):
            function(state, scene)
        function(whole, scene)
    assert mpsim.State(**np.load(state.save(tmp_path / "a.npz"))).digest() == state.digest() != whole.digest()
    with pytest.raises(mpsim.InputError, match=r"colour must not be 'speed' of discs whose velocities are unknown\."):
        mpsim.draw(frame)
    mpsim.draw(frame, colour="radius")


# --- LAMMPS


def test_a_dump_of_lammps_is_read(tmp_path):
    frame = read(tmp_path, DUMP, "a.lammpstrj")
    assert (frame.frame, frame.box, frame.origin, frame.periodic) == (70, (8, 8), (-4, -3), (True, False))
    assert (frame.ids.tolist(), frame.position.tolist()) == ([1, 2], [[-1, 2], [3.5, 1]]), "in the order of their ids"
    assert (frame.velocity.tolist(), frame.mass.tolist()) == ([[-1, 1], [0.5, 0.25]], [1, 2])
    assert frame.radius.tolist() == [0.5, 0.4]
    one = DUMP.replace("ATOMS\n2", "ATOMS\n1").replace("2 1 3.5 1 0 0.5 0.25 0 0.4 2\n", "")
    (tmp_path / "a.dump").write_text(DUMP + one + DUMP.replace("2 1 3.5", "0 1 3.5"))
    frames = list(mpsim.Trajectory(tmp_path / "a.dump"))
    assert [frame.ids.tolist() for frame in frames] == [[1, 2], [1], [0, 1]], "number and order may change"
    assert [frame.position[0].tolist() for frame in frames] == [[-1, 2], [-1, 2], [3.5, 1]]


PLACES = {
    "x y": ("3.5 1", "-1 2"),
    "xs ys zs": ("0.9375 0.5 0.5", "0.375 0.625 0.5"),
    "xu yu zu": ("3.5 1 0", "-1 2 0"),
    "xsu ysu zsu": ("0.9375 0.5 0.5", "0.375 0.625 0.5"),
    "xs ys zs x y z": ("9 9 9 3.5 1 0", "9 9 9 -1 2 0"),
}


def test_all_coordinates_and_quantities_of_lammps_are_read(tmp_path):
    for names, (second, first) in PLACES.items():
        text = DUMP[: DUMP.index("ITEM: ATOMS")] + f"ITEM: ATOMS id {names}\n2 {second}\n1 {first}\n"
        frame = read(tmp_path, text, "a.dump")
        assert frame.position.tolist() == [[-1, 2], [3.5, 1]], names
        if "u" in names:
            assert frame.unwrapped.tolist() == frame.position.tolist(), "whatever border they are beyond"
    text = DUMP.replace("vx vy vz radius mass", "ix iy iz diameter omegaz q")
    text = text.replace("0.5 0.25 0 0.4 2", "-1 0 0 0.8 7 9").replace("-1 1 0 0.5 1", "2 0 0 1.0 -3 9")
    text = text.replace("ITEM: TIMES", "ITEM: UNITS\nlj\nITEM: TIME\n1.75\nITEM: TIMES")
    for frame in (read(tmp_path, text, "a.dump"), read(tmp_path, text.replace("\n", "\r\n"), "a.dump")):
        assert (frame.radius.tolist(), frame.spin.tolist(), frame.time) == ([0.5, 0.4], [-3, 7], 1.75)
    assert frame.unwrapped.tolist() == frame.state.unwrapped.tolist() == [[15, 2], [-4.5, 1]]
    assert read(tmp_path, DUMP.replace(" pp ff pp", ""), "a.dump").periodic == (True, True)
    upright = DUMP.replace("BOUNDS", "BOUNDS xy xz yz").replace("-4 4", "-4 4 0").replace("-3 5", "-3 5 0")
    assert read(tmp_path, upright.replace(".5 0.5\n", ".5 0.5 0\n"), "a.dump").box == (8, 8)


BEGINS = "line 1, must begin a frame of a LAMMPS dump with ITEM: TIMESTEP, NUMBER OF ATOMS, BOX B"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (BOX, "-4 4 1\n-3 5 0\n-0.5 0.5 0\n", "line 5, must begin an upright rectangular box.*got '-4 4 1"),
        (BOX, "8 0 0 -4\n0 8 0 -3\n0 0 1 0\n", "must begin an upright rectangular box"),
        ("-4 4", "-4 nan", "line 6, must hold 6 finite numbers under ITEM: BOX BOUNDS; got '-4 nan"),
        ("ITEM: TIMESTEP", "TIMESTEP", BEGINS + ".* got 'TIMESTEP"),
        ("x y z", "x y x", "line 9, must name each column once; got 'id type x y x vx"),
        ("x y z", "a b c", "line 9, must name columns x and y, or xs, xu or xsu; got 'id type a b c vx"),
        ("0.4 2\n", "0.4\n", "line 10, must have 10 columns, as its ITEM: ATOMS says; got a line with 9"),
        ("BOX BOUNDS", "BOX", BEGINS),
    ],
)
def test_a_dump_that_is_no_plane_in_a_box_is_refused(tmp_path, old, new, words):
    refused(tmp_path, DUMP.replace(old, new, 1), words, "a.dump")


# --- files of mpsim in other programs


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning")  # of NumPy 2.5, by ASE up to 3.29
@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning", "ignore::mpsim.FastWarning")
@pytest.mark.parametrize("name", SCENES)
def test_ase_and_freud_read_what_mpsim_writes_with_the_same_numbers(name, tmp_path):
    import ase.io  # noqa: PLC0415 - only where it is used
    import freud  # noqa: PLC0415

    settings = {"method": "grid" if name == "everything" else "naive", "dt": DT}
    for ending in ("xyz", "gsd"):
        written(tmp_path / f"a.{ending}", SCENES[name](), 80, 20, **settings)
    pages = list(mpsim.Trajectory(tmp_path / "a.xyz"))
    for atoms, page in zip(ase.io.read(tmp_path / "a.xyz", index=":"), pages, strict=True):
        assert np.array_equal(atoms.positions[:, :2], page.position)
        assert np.array_equal(atoms.get_masses(), page.mass)
        assert atoms.get_velocities()[:, :2] == pytest.approx(page.velocity, rel=1e-15)
        energy = 0.5 * (page.mass[:, None] * page.velocity**2).sum()
        assert atoms.get_kinetic_energy() == pytest.approx(energy, rel=1e-14)
        for theirs, ours in {"radius": page.radius, "id": page.ids}.items():
            assert np.array_equal(atoms.arrays[theirs], ours)
        assert np.array_equal(atoms.arrays.get("map_shift", np.zeros((len(atoms), 3)))[:, :2], page.image)
        assert atoms.cell.lengths() == pytest.approx([*page.box, 1.0])
        assert atoms.info["Origin"] == pytest.approx([*page.origin, 0.0])
        assert atoms.pbc.tolist() == [*page.periodic, False]
        assert (atoms.info["Time"], atoms.info["Frame"]) == (page.time, page.frame)
    with gsd.hoomd.open(str(tmp_path / "a.gsd")) as frames:
        for theirs, page in zip(frames, pages, strict=True):
            box = freud.box.Box.from_box(theirs.configuration.box)
            assert box.is2D
            assert (box.Lx, box.Ly) == pytest.approx(page.box)
            away = box.unwrap(theirs.particles.position, theirs.particles.image)[:, :2]
            assert away + np.add(page.origin, np.divide(page.box, 2)) == pytest.approx(page.unwrapped, abs=2e-5)
            assert len(freud.locality.AABBQuery.from_system(theirs).points) == len(page.ids)
