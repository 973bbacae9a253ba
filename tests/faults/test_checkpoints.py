"""A damaged checkpoint leads to the one before, one made to do harm is refused; while one is written none is lost."""

import errno
import hashlib
import json
import os
import re
import resource
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from support.checkpoints import WORDS, frame_in, rewrite, rewrite_members, saved, two
from support.processes import limited, refusing
from support.scenes import exact_zoo, lattice, simulate, zoo
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.plain


# --- damage


def outcome_of(path):
    """Frame of what a resume takes; -1 if it refuses. A warning must name both files."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            frame = frame_in(path)
        except mpsim.CheckpointError:
            return -1
    if frame == 2:
        assert [each.category for each in told] == [mpsim.errors.CheckpointWarning]
        assert f"'{path}'" in str(told[0].message)
        assert f"'{path}.previous'" in str(told[0].message)
    else:
        assert not told
    return frame


def test_a_file_cut_short_anywhere_leads_to_the_one_before(tmp_path):
    path = two(tmp_path / "run")
    whole = path.read_bytes()
    cuts = [*range(0, len(whole), 101), len(whole) - 1]
    for length in cuts:
        path.write_bytes(whole[:length])
        assert outcome_of(path) == 2, f"cut at {length} of {len(whole)}"
    path.with_name("run.previous").unlink()
    for length in cuts[::9]:
        path.write_bytes(whole[:length])
        assert outcome_of(path) == -1
    path.write_bytes(whole)
    assert outcome_of(path) == 3


def test_a_flipped_bit_anywhere_changes_nothing_or_leads_to_the_one_before(tmp_path):
    path = two(tmp_path / "run")
    whole, harmless = path.read_bytes(), 0
    places = range(0, len(whole), 31)
    with mpsim.Simulation.resume(path) as sim:
        expected = sim.digest()
    for place in places:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        path.write_bytes(damaged)
        found = outcome_of(path)
        assert found in (2, 3), f"byte {place}"
        if found == 3:  # a bit that means nothing, such as one of a date
            with mpsim.Simulation.resume(path) as sim:
                assert sim.digest() == expected, f"byte {place}"
            harmless += 1
    assert harmless < len(places) / 3


@pytest.mark.parametrize(
    ("by", "rule"), [(1, r"9, of a newer version\. Use a newer mpsim"), (-1, r"7, from a development version\. Start")]
)
def test_another_format_is_refused_by_number_and_not_passed_over(by, rule, tmp_path):
    path = two(tmp_path / "run")
    rewrite(path, lambda header, arrays: header.update(format=header["format"] + by))
    with pytest.raises(mpsim.CheckpointError, match=rf"must be of format 8, .*; it is of format {rule}"):
        mpsim.Simulation.resume(path)


def test_the_warning_stands_where_the_user_asked_and_an_error_names_both_files(tmp_path):
    path = two(tmp_path / "run")
    path.write_bytes(b"")
    with pytest.warns(mpsim.errors.CheckpointWarning, match="Continuing from the previous one") as told:
        mpsim.Simulation.resume(path).close()
    assert told[0].filename == __file__
    with pytest.raises(mpsim.CheckpointError, match=r"no such file.*none\.previous.*no such file"):
        mpsim.Simulation.resume(tmp_path / "none")


# --- what is no damage


class ImpatienceError(Exception):
    """An exception of a user's own."""


PASSED_ON = [
    MemoryError("no memory"), KeyboardInterrupt(), SystemExit(143), TimeoutError(errno.ETIMEDOUT, "the user's alarm"),
    OSError("the user's, without a number"), ImpatienceError("the user's own"), UserWarning("a warning as an error"),
]  # fmt: skip
DAMAGE = [
    OSError(errno.EIO, "Input/output error"), OSError(errno.EBADMSG, "Bad message"), EOFError("cut off"),
    zipfile.BadZipFile("Bad CRC-32"), ValueError("no number"), KeyError("no such array"),
    NotImplementedError("zip file version 9.9"),
]  # fmt: skip

WHERE = {
    "opening": (os, "open"),
    "the table of contents": (zipfile, "_EndRecData"),
    "the header": (json, "loads"),
    "the checksum of an array": (zipfile, "crc32"),
    "an array": (np, "frombuffer"),
    "the digest": (hashlib, "blake2b"),
}
"""What reading a file calls, in turn."""


@pytest.mark.parametrize("where", WHERE)
def test_only_damage_leads_to_the_older_one(where, tmp_path, monkeypatch):
    """Errors that are the user's own are passed on; what the system refuses is said, since it may be undamaged."""
    path = two(tmp_path / "run")

    def read(function):
        with monkeypatch.context() as patch:
            patch.setattr(*WHERE[where], function)
            return frame_in(path)

    for error in PASSED_ON:
        with pytest.raises(type(error)) as found:
            read(refusing(error))
        assert found.value is error
    for number in (errno.EACCES, errno.EMFILE, errno.ESTALE):
        with pytest.raises(mpsim.CheckpointError) as refused:
            read(refusing(error := OSError(number, os.strerror(number))))
        rule = f"'{path}' must be a file that can be read; got: {os.strerror(number)}. It may be undamaged"
        assert rule in str(refused.value)
        assert refused.value.__cause__ is error
    place, name = WHERE[where]
    for error in DAMAGE if where not in ("opening", "the table of contents") else DAMAGE[:1]:
        whole, left = getattr(place, name), [error]

        def fail_once(*arguments, whole=whole, left=left, **options):
            if left:
                raise left.pop()
            return whole(*arguments, **options)

        with pytest.warns(mpsim.errors.CheckpointWarning, match="the previous one"):
            assert read(fail_once) == 2, error
    assert frame_in(path) == 3


def test_a_file_for_a_folder_is_no_damage_and_one_that_is_gone_leads_to_the_one_before(tmp_path):
    path = two(tmp_path / "run")
    with pytest.raises(mpsim.CheckpointError, match="Not a directory"):
        mpsim.Simulation.resume(tmp_path / "run.previous" / "run")
    path.unlink()
    with pytest.warns(mpsim.errors.CheckpointWarning, match="no such file"):
        assert frame_in(path) == 2


# --- made to do harm


def assert_refused(path, what, rule):
    said = f"taken: {what}"
    try:
        mpsim.Simulation.resume(path).close()
    except mpsim.CheckpointError as error:
        said = str(error)
    assert re.search(rule, said), f"{what}: {said}"


def test_bombs_of_compressed_or_overlapping_members_are_refused_before_they_are_read(tmp_path):
    path = saved(tmp_path / "run")
    rewrite_members(path, lambda members: members.update({"solver.velocity.npy": bytes(2**26)}), zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 2**18
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(mpsim.CheckpointError, match="compressed"):
        mpsim.Simulation.resume(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**15, "kilobytes: the bomb went off"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("first.npy", bytes(2**20))
        info = file.getinfo("first.npy")
        for number in range(40):  # forty names for the same million bytes
            twin = zipfile.ZipInfo(f"twin{number}.npy")
            for field in ("header_offset", "CRC", "compress_size", "file_size", "compress_type"):
                setattr(twin, field, getattr(info, field))
            file.filelist.append(twin)
    with pytest.raises(mpsim.CheckpointError, match="declares more bytes than it has"):
        mpsim.Simulation.resume(path)


def of_array(name, change):
    def changed(header, arrays):
        arrays[name] = np.asarray(change(arrays[name]))

    return changed


def put(name, place, value):
    def changed(header, arrays):
        arrays[name][place] = value

    return changed


def of_header(key, value, *keys):
    def changed(header, arrays):
        for each in keys:
            header = header[each]
        header[key] = value

    return changed


IMPOSSIBLE = {
    "a position that is not a number": put("solver.position", (0, 0), np.nan),
    "an infinite velocity": put("solver.velocity", (1, 1), np.inf),
    "radii above the largest": of_array("solver.radii", lambda a: np.full_like(a, 3.0)),
    "one mass that differs": of_array("solver.masses", lambda a: np.append(np.ones(6), 2.0)),
    "masses as whole numbers": of_array("solver.masses", lambda a: np.asarray(a, np.int64)),
    "no number of discs": lambda header, arrays: header.pop("discs"),
    **{f"{value!r:.9} discs": of_header("discs", value) for value in (10**30, -1, 5.5, [5, 5])},
    "frames below 0": put("solver.progress", 0, -1),
    "steps of another number of frames": put("solver.progress", 1, 77),
    "steps that its frames cannot have": put("solver.progress", 1, 6),
    "a disc that has half left": put("solver.exits", (0, 0), 0.5),
    "positions of the wrong dtype": of_array("solver.position", lambda a: a.astype(np.float32)),
    "one velocity too few": of_array("solver.velocity", lambda a: a[:-1]),
    "fewer discs than the scene": of_array("solver.position", lambda a: a[:2]),
    "positions in one row": of_array("solver.position", np.ravel),
    **{
        f"no {name}": lambda header, arrays, name=name: arrays.pop(name)
        for name in ("solver.progress", "solver.position", "scene.position")
    },
    "an array too many": lambda header, arrays: arrays.update({"solver.more": np.zeros(3)}),
    "no settings": lambda header, arrays: header.pop("settings"),
    "an unknown setting": of_header("colour", "red", "settings"),
    "an impossible setting": of_header("dt", -1.0, "settings"),
    "settings of the exact solver": of_header("method", "event", "settings"),
    "another precision": of_header("precision", "float32", "settings"),
    "a scene without width": lambda header, arrays: header["scene"].pop("width"),
    "a scene in a list": of_header("scene", [1, 2]),
    "an obstacle of unknown kind": of_header("obstacles", [["Exit", {}]], "scene"),
    "a box that holds no disc": of_header("width", 0.1, "scene"),
    "another frame": of_header("frame", 5, "run"),
    "no emission": lambda header, arrays: header["run"].pop("emission"),
    "an emission in a list": of_header("emission", [], "run"),
    "an emission of something else": of_header("more", [0, 0, 0], "run", "emission"),
    "an emitter too many": lambda header, arrays: header["run"]["emission"]["due"].append(1),
    "an emitter due at half a frame": of_header("due", [1.5, 2.0, 3.0], "run", "emission"),
    "an emission since no time": of_header("since", [0.0, 0.0, float("inf")], "run", "emission"),
    "more discs emitted than there are": of_header("emitted", [9, 9, 9], "run", "emission"),
    "a header in a list": of_header("format", [1]),
}

IMPOSSIBLE_LATTICE = {
    "another seed": of_header("seed", 3, "scene", "lattice"),
    "too many discs": of_header("count", 10**15, "scene", "lattice"),
    "places of discs": lambda header, arrays: arrays.update({"scene.position": np.ones((50, 2))}),
    "radii that differ": lambda header, arrays: arrays.update({"scene.radius": np.linspace(0.4, 0.5, 50)}),
}

IMPOSSIBLE_EXACT = {
    "a partner that is no disc": put("solver.event", (0, 0), 99),
    "a partner below": put("solver.event", (0, 0), -7),
    "a side that is none": put("solver.event", (0, 3), 4),
    "a column beyond the box": put("solver.event", (0, 4), 10**6),
    "a row below the box": put("solver.event", (0, 5), -1),
    "a cell that is not that of its place": of_array("solver.event", lambda a: np.roll(a, 1, axis=0)),
    "an order in which one is twice": put("solver.order", 0, 1),
    "an event in the past": put("solver.disc", (0, 6), -5.0),
    "a place that is none": put("solver.disc", (0, 0), np.nan),
    "a step of no length": put("solver.clock", 2, 0.0),
    "a step that is no power of two": put("solver.clock", slice(2, 4), 0.3),
    "a lap of another length": put("solver.clock", 3, 1e9),
    "a present after its frame": put("solver.clock", 1, 1e9),
    "a unit of sums that is none": put("solver.units", 0, -0.0),
}


def of_one(left, name, field, value):
    """Change a field of the first disc that has left (1), or of the first that has not (0)."""

    def changed(header, arrays):
        disc = int(np.flatnonzero(arrays["solver.exits"][:, 0] == left)[0])
        arrays[name][disc, field] = value

    return changed


def both(*changes):
    return lambda header, arrays: [change(header, arrays) for change in changes]


IMPOSSIBLE_FEATURES = {
    "a place of leaving that is not a number": of_one(1, "solver.exits", 1, np.nan),
    "an obstacle beyond the last": of_one(0, "solver.event", 3, 5 + 2),
    "a disc ahead of the present": of_one(0, "solver.disc", 4, 1e9),
    "a spin that is not a number": put("solver.spin", 3, np.nan),
    "no exits": lambda header, arrays: arrays.pop("solver.exits"),
    "no piston": both(of_header("piston", None, "scene"), put("solver.event", (slice(None), 3), 4)),
    "a piston that leaves no room": lambda header, arrays: header["scene"]["piston"][1].update(stop=0.5),
    "no obstacles": both(of_header("obstacles", [], "scene"), put("solver.event", (slice(None), 3), 5)),
}

SPARSE = {"count": 50, "packing": 0.3, "radius": 0.5, "seed": 2}
STARTS = {
    "stepped": (IMPOSSIBLE, saved, 3),
    "lattice": (IMPOSSIBLE_LATTICE, lambda path: saved(path, mpsim.Scene.lattice(**SPARSE), method="naive"), 3),
    "exact": (IMPOSSIBLE_EXACT, lambda path: saved(path, lattice(5, 5), method="event", dt=0.3), 3),
    "exact with features": (
        IMPOSSIBLE_FEATURES,
        lambda path: saved(path, exact_zoo(), method="event", dt=0.3, frames=6),
        6,
    ),
}


@pytest.mark.parametrize("start", STARTS)
def test_a_state_that_no_simulation_can_have_is_refused_though_its_digest_is_right(start, tmp_path):
    changes, save, frame = STARTS[start]
    path = save(tmp_path / "run")
    whole = path.read_bytes()
    for what, change in changes.items():
        path.write_bytes(whole)
        rewrite(path, change)
        assert_refused(path, what, "cannot be read|not a state of a simulation")
    path.write_bytes(whole)
    rewrite(path, lambda header, arrays: None)
    with mpsim.Simulation.resume(path) as sim:
        assert sim.frame == frame, "the control: one that is only rewritten is taken"
        assert "features" not in start or 0 < (~sim.state.present).sum() < sim.count, "some have left"


@pytest.mark.parametrize("method", long_but(["grid", "event"], "event"))
def test_a_number_of_discs_is_compared_with_the_arrays_before_room_is_made_for_them(method, tmp_path):
    path = saved(tmp_path / "run", lattice(5, 5), method=method)
    rewrite(path, of_header("discs", 10**8))
    tracemalloc.start()
    try:
        with pytest.raises(mpsim.CheckpointError, match="no array for 100000000 discs"):
            mpsim.Simulation.resume(path)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("changed", "origin"), [({}, [3, 0.0]), ({}, None), ({"dt": 0.02}, [2, 0.0]), ({"dt": 0.02}, 0)]
)
def test_frames_are_counted_from_the_last_change_of_dt(changed, origin, tmp_path):
    """So the header need not say from which; if it does, it must be this one."""
    with simulate(lattice(4, 4), method="grid") as sim:
        if changed:
            sim.change(**changed)
        sim.run(frames=2)
        path = sim.save(tmp_path / "run")
    assert frame_in(path) == 2, "the control"
    rewrite(path, of_header("origin", origin, "run"))
    assert_refused(path, f"an origin {origin}", "not a state of a simulation")


def test_frames_that_were_divided_are_no_damage(tmp_path):
    """With on_fast="substep" each frame may have had several steps, and each as many."""
    path = saved(tmp_path / "run", zoo(WORDS, count=5), on_fast="substep")
    for steps in (3, 6, 12):
        rewrite(path, put("solver.progress", 1, steps))
        with mpsim.Simulation.resume(path) as sim:
            assert sim.frame == 3
        rewrite(path, put("solver.progress", 1, steps + 1))
        with pytest.raises(mpsim.CheckpointError, match=f"3 frames cannot have {steps + 1} steps"):
            mpsim.Simulation.resume(path)


# --- written: a whole one is found, and nothing else is lost


def names(folder):
    return sorted(each.name for each in folder.iterdir())


# --- no room


def test_whatever_the_system_refuses_is_an_error_and_what_was_there_is_untouched(tmp_path):
    """A file that cannot grow, at any size; and in the end it is saved."""
    path = two(tmp_path / "run")
    before = path.read_bytes()
    with simulate(zoo(WORDS, count=5), method="grid") as sim:
        for size in range(0, 5000, 500):
            with (
                limited(resource.RLIMIT_FSIZE, size),
                pytest.raises(mpsim.errors.OutputError, match="before is untouched") as full,
            ):
                sim.save(path)
            assert "File too large" in str(full.value)
            assert path.read_bytes() == before, size
        assert names(tmp_path) == ["run", "run.previous"]
        sim.run(frames=1)
        sim.save(path)
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (1, 3)


def test_a_file_system_without_links_gets_a_copy(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", refusing(errno.EPERM))
    path = two(tmp_path / "run")
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (3, 2)


def test_no_checkpoint_is_written_that_could_not_be_read_again(tmp_path, monkeypatch):
    path = saved(tmp_path / "run", zoo("obstacles", count=5))
    before = path.read_bytes()
    monkeypatch.setattr("mpsim.engine.checkpoint.MOST_HEADER", 200)  # else it takes 67 MB of obstacles
    with pytest.raises(mpsim.errors.OutputError, match="must take at most 200 bytes of a checkpoint's header"):
        saved(path, zoo("obstacles", count=6))
    assert names(tmp_path) == ["run"]
    assert path.read_bytes() == before


PARTS = {
    "obstacles": lambda own: own(mpsim.FixedDisc)((3, 3), 0.5),
    "emitters": lambda own: own(mpsim.Emitter)((3, 3), (1, 0), every=5),
    "piston": lambda own: own(mpsim.Piston)("right", -1.0, 4),
    "thermostat": lambda own: own(mpsim.Thermostat)(1.0, 1.0, seed=1),
    "thermal_walls": lambda own: own(mpsim.ThermalWalls)(left=1.0, seed=1),
    "settings": lambda own: own(mpsim.Settings)(method="naive"),
}


@pytest.mark.parametrize("name", PARTS)
def test_nothing_of_a_derived_class_is_written_which_could_not_be_read_again(name, tmp_path):
    box = mpsim.Scene(width=6, height=6, position=[[1, 1]], velocity=[[0, 0]], radius=0.5,
                      **{name: PARTS[name](lambda kind: type("Own", (kind,), {}))})  # fmt: skip
    with mpsim.Simulation(box) as sim:
        for save in (lambda: sim.save(tmp_path / "run"), lambda: sim.journal.save(tmp_path / "run.toml")):
            with pytest.raises(mpsim.errors.OutputError, match=r"of classes of mpsim; got a Own. Use \w+ itself"):
                save()
    assert names(tmp_path) == []


# --- places


def test_a_checkpoint_replaces_nothing_but_a_checkpoint(tmp_path):
    """Known before the first frame; its `.previous` is protected too, and a folder or a pipe is no place at all."""
    thesis, mine = tmp_path / "thesis.tex", tmp_path / "mine.npz"
    np.savez(mine, header=np.zeros(3))
    (tmp_path / "run.previous").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with simulate(lattice(4, 4), method="grid") as sim:
        for text in ("a year of work", "PK\x03\x04" + 60 * "x"):
            thesis.write_text(text)
            for deed in (sim.save, lambda path: sim.run(frames=1, checkpoint=path)):
                match = r"may replace only a checkpoint; .*thesis\.tex.* another kind.* Choose another name"
                with pytest.raises(mpsim.errors.OutputError, match=match):
                    deed(thesis)
            assert thesis.read_text() == text
        for path, rule in (
            (mine, "another kind"),
            (tmp_path / "run", r"run\.previous"),
            (tmp_path / "pipe", "must be a file; .*pipe"),
            (tmp_path / "folder", "must be a file; .*folder"),
            ("/", "must be a file; '/' is not"),
            (tmp_path / "nowhere" / "run", "needs a folder that exists.* Make .*nowhere"),
            (thesis / "run", r"needs a folder that exists.* '.*thesis\.tex' is a file: give another one"),
        ):
            for deed in (sim.save, lambda path: sim.run(frames=1, checkpoint=path)):
                with pytest.raises(mpsim.errors.OutputError, match=rule):
                    deed(path)
        with pytest.raises(mpsim.errors.OutputError, match="'/proc/run'"):  # new files are refused even to root there
            sim.save("/proc/run")
        for nonsense in (None, 3, "", "a\0b"):
            with pytest.raises(mpsim.InputError, match="must be a file name"):
                sim.save(nonsense)
        assert sim.frame == 0, "a run must be refused before it begins"
    assert (tmp_path / "run.previous").read_text() == "mine"


def test_an_empty_or_cut_checkpoint_may_be_replaced_and_pushes_out_none_that_is_whole(tmp_path):
    """One that is damaged inside ends as it should, so it becomes the previous one, after the new one stands."""
    path = two(tmp_path / "run")
    whole = path.read_bytes()
    inside = bytearray(whole)
    inside[whole.index(b"solver.position.npy") + 200] ^= 1  # behind some 170 bytes of headers
    for content, frames in ((b"", 4), (whole[:200], 5), (inside, 6)):
        path.write_bytes(content)
        saved(path, frames=frames)
        assert frame_in(path) == frames
        if content is not inside:
            assert frame_in(tmp_path / "run.previous") == 2
    with pytest.raises(mpsim.CheckpointError):
        frame_in(tmp_path / "run.previous")


def test_a_relative_path_means_where_the_run_began_and_a_link_leads_to_its_file(tmp_path, monkeypatch):
    """Users put checkpoints on a larger disk by a link; a run of no frames writes its checkpoint, too."""
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)
    with simulate(lattice(4, 4), method="grid") as sim:
        sim.run(frames=0, checkpoint="begun")
        sim.run(frames=9, checkpoint="run", checkpoint_every=3, progress=lambda done, of: os.chdir(tmp_path / "other"))
    assert names(tmp_path) == ["begun", "other", "run", "run.previous"]
    monkeypatch.chdir(tmp_path)
    assert (frame_in("begun"), frame_in("run")) == (0, 9)
    (tmp_path / "link").symlink_to(tmp_path / "other" / "run")
    for frames in (2, 3):
        saved(tmp_path / "link", frames=frames)
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "other") == ["run", "run.previous"]
    assert frame_in(tmp_path / "link") == 3


def bytes_read():
    """What this process has read from files so far."""
    return int(dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())["rchar"])


def test_overwriting_a_checkpoint_does_not_read_the_one_that_is_there(tmp_path):
    read = []
    for _ in range(3):
        before = bytes_read()
        saved(tmp_path / "run", lattice(50, 50), frames=0)
        read.append(bytes_read() - before)
    size = (tmp_path / "run").stat().st_size
    assert size > 100_000
    assert max(read[1:]) < read[0] + size / 10
