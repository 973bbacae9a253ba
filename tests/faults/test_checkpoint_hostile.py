"""A checkpoint made to do harm executes nothing, allocates nothing, and is refused."""

import os
import pickle
import resource
import tracemalloc
import zipfile

import numpy as np
import pytest
from support.checkpoints import WORDS, rewrite, rewrite_members, saved
from support.processes import assert_clean, run_script
from support.scenes import exact_zoo, lattice, zoo

import mpsim
from mpsim.engine import checkpoint


class Bomb:
    def __reduce__(self):
        return os.mkdir, (Bomb.target,)


def test_a_pickle_in_disguise_executes_nothing(tmp_path):
    Bomb.target = str(tmp_path / "executed")
    path = tmp_path / "run"
    content = pickle.dumps(Bomb())
    np.save(tmp_path / "array.npy", np.array([Bomb()], dtype=object), allow_pickle=True)
    member = (tmp_path / "array.npy").read_bytes()
    saved(path)
    whole = path.read_bytes()

    def disguise(members):
        members["solver.position.npy"] = member

    for write in (lambda: path.write_bytes(content), lambda: rewrite_members(path, disguise)):
        path.write_bytes(whole)
        write()
        with pytest.raises(mpsim.CheckpointError, match="cannot be read"):
            mpsim.Simulation.resume(path)
    assert not (tmp_path / "executed").exists()
    pickle.loads(content)
    assert (tmp_path / "executed").exists(), "a control that does execute"


def npy(shape, dtype="<f8", content=b"", version=(1, 0)):
    """A .npy file whose header says what it likes."""
    text = repr({"descr": dtype, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY" + bytes(version) + len(text).to_bytes(2, "little") + text + content


HUGE = {
    "a shape of 8 PB": npy((10**15,)),
    "a shape beyond 64 bits": npy((2**40, 2**40)),
    "a negative shape": npy((-1, -8), content=bytes(64)),
    "a shape of nothing times much": npy((0, 2**62, 2**62)),
    "objects": npy((1,), "|O", bytes(8)),
    "texts": npy((1,), "<U9", bytes(36)),
    "dtype of no size": npy((2**50,), "|V0"),
    "another version": npy((1,), content=bytes(8), version=(3, 0)),
    "no array": b"nothing of the kind",
    "one byte too many": npy((1,), content=bytes(9)),
}


@pytest.mark.parametrize("what", HUGE)
def test_a_declared_size_is_compared_with_the_file_before_anything_is_allocated(what, tmp_path):
    for name in ("solver.velocity.npy", "scene.position.npy", f"{checkpoint.HEADER}.npy"):
        path = saved(tmp_path / f"run{name}")
        rewrite_members(path, lambda members, name=name: members.update({name: HUGE[what]}))
        with pytest.raises(mpsim.CheckpointError, match=r"cannot be read|not a state of a simulation|digest"):
            mpsim.Simulation.resume(path)


def test_a_bomb_of_compressed_or_overlapping_members_is_refused_before_it_is_read(tmp_path):
    path = saved(tmp_path / "run")
    rewrite_members(path, lambda members: members.update({"solver.velocity.npy": bytes(2**28)}), zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 2**20
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(mpsim.CheckpointError, match="compressed"):
        mpsim.Simulation.resume(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**17, "kilobytes: the bomb went off"
    content = bytes(2**20)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("first.npy", content)
        info = file.getinfo("first.npy")
        for number in range(40):  # forty names for the same million bytes
            twin = zipfile.ZipInfo(f"twin{number}.npy")
            for field in ("header_offset", "CRC", "compress_size", "file_size", "compress_type"):
                setattr(twin, field, getattr(info, field))
            file.filelist.append(twin)
    with pytest.raises(mpsim.CheckpointError, match="declares more bytes than it has"):
        mpsim.Simulation.resume(path)


def change_array(name, change):
    def changed(header, arrays):
        arrays[name] = np.asarray(change(arrays[name]))

    return changed


def put(name, place, value):
    def changed(header, arrays):
        arrays[name][place] = value

    return changed


HOSTILE = {
    "a position that is not a number": put("solver.position", (0, 0), np.nan),
    "a position far outside": put("solver.position", (0, 0), 1e9),
    "an infinite velocity": put("solver.velocity", (1, 1), np.inf),
    "radii of 0": change_array("solver.radii", np.zeros_like),
    "radii above the largest": change_array("solver.radii", lambda a: np.full_like(a, 3.0)),
    "masses that differ from those of the scene": change_array("solver.masses", lambda a: np.full_like(a, 2.0)),
    "one mass that differs": change_array("solver.masses", lambda a: np.append(np.ones(6), 2.0)),
    "a mass that is not a number": change_array("solver.masses", lambda a: np.full_like(a, np.nan)),
    "masses as whole numbers": change_array("solver.masses", lambda a: np.asarray(a, np.int64)),
    "no number of discs": lambda header, arrays: header.pop("discs"),
    "more discs than positions": lambda header, arrays: header.update(discs=10**7),
    "discs without end": lambda header, arrays: header.update(discs=10**30),
    "fewer discs than none": lambda header, arrays: header.update(discs=-1),
    "a broken number of discs": lambda header, arrays: header.update(discs=5.5),
    "a number of discs in words": lambda header, arrays: header.update(discs="five"),
    "two numbers of discs": lambda header, arrays: header.update(discs=[5, 5]),
    "frames below 0": put("solver.progress", 0, -1),
    "steps of another number of frames": put("solver.progress", 1, 77),
    "a disc that has half left": put("solver.exits", (0, 0), 0.5),
    "positions of the wrong dtype": change_array("solver.position", lambda a: a.astype(np.float32)),
    "positions as whole numbers": change_array("solver.position", lambda a: a.astype(np.int64)),
    "one velocity too few": change_array("solver.velocity", lambda a: a[:-1]),
    "fewer discs than the scene": change_array("solver.position", lambda a: a[:2]),
    "positions in one row": change_array("solver.position", np.ravel),
    "no progress": lambda header, arrays: arrays.pop("solver.progress"),
    "no positions": lambda header, arrays: arrays.pop("solver.position"),
    "no scene": lambda header, arrays: arrays.pop("scene.position"),
    "an array too many": lambda header, arrays: arrays.update({"solver.more": np.zeros(3)}),
    "an array that belongs to nothing": lambda header, arrays: arrays.update({"more": np.zeros(3)}),
    "no settings": lambda header, arrays: header.pop("settings"),
    "an unknown setting": lambda header, arrays: header["settings"].update(colour="red"),
    "an impossible setting": lambda header, arrays: header["settings"].update(dt=-1.0),
    "settings of the exact solver": lambda header, arrays: header["settings"].update(method="event"),
    "another precision": lambda header, arrays: header["settings"].update(precision="float32"),
    "a scene without width": lambda header, arrays: header["scene"].pop("width"),
    "a scene in a list": lambda header, arrays: header.update(scene=[1, 2]),
    "an obstacle of unknown kind": lambda header, arrays: header["scene"].update(obstacles=[["Exit", {}]]),
    "a box that holds no disc": lambda header, arrays: header["scene"].update(width=0.1),
    "a width that is not a number": lambda header, arrays: header["scene"].update(width=float("nan")),
    "another frame": lambda header, arrays: header["run"].update(frame=5),
    "a frame in words": lambda header, arrays: header["run"].update(frame="three"),
    "an emitter too many": lambda header, arrays: header["run"]["emission"]["due"].append(1),
    "an emitter due at half a frame": lambda header, arrays: header["run"]["emission"].update(due=[1.5, 2.0]),
    "more discs emitted than there are": lambda header, arrays: header["run"]["emission"].update(emitted=[9, 9]),
    "no emission": lambda header, arrays: header["run"].pop("emission"),
    "a header in a list": lambda header, arrays: header.update(format=[1]),
    "a digest that is none": lambda header, arrays: header.pop("digest", None),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_state_that_no_simulation_can_have_is_refused_though_its_digest_is_right(what, tmp_path):
    path = saved(tmp_path / "run")
    rewrite(path, HOSTILE[what], right_digest=what != "a digest that is none")
    with pytest.raises(mpsim.CheckpointError, match=r"(?s)cannot be read|not a state of a simulation"):
        mpsim.Simulation.resume(path)


HOSTILE_EXACT = {
    "a partner that is no disc": put("solver.event", (0, 0), 99),
    "a partner below": put("solver.event", (0, 0), -7),
    "a side that is none": put("solver.event", (0, 3), 4),
    "a column beyond the box": put("solver.event", (0, 4), 10**6),
    "a row below the box": put("solver.event", (0, 5), -1),
    "a cell that is not that of its place": change_array("solver.event", lambda a: np.roll(a, 1, axis=0)),
    "an order in which one is twice": put("solver.order", 0, 1),
    "an order beyond the discs": put("solver.order", 0, 10**6),
    "an event in the past": put("solver.disc", (0, 6), -5.0),
    "an event that has no time": put("solver.disc", (0, 5), np.nan),
    "a place that is none": put("solver.disc", (0, 0), np.nan),
    "a step of no length": put("solver.clock", 2, 0.0),
    "a step that is no power of two": put("solver.clock", slice(2, 4), 0.3),
    "a lap of another length": put("solver.clock", 3, 1e9),
    "a present after its frame": put("solver.clock", 1, 1e9),
    "a count below 0": put("solver.counter", 3, -1),
    "a unit that is no power of two": put("solver.units", 0, 0.3),
}


@pytest.mark.parametrize("what", HOSTILE_EXACT)
def test_no_index_of_an_exact_checkpoint_leads_out_of_its_arrays(what, tmp_path):
    path = saved(tmp_path / "run", lattice(5, 5), method="event", dt=0.3)
    rewrite(path, HOSTILE_EXACT[what])
    with pytest.raises(mpsim.CheckpointError, match="not a state of a simulation"):
        mpsim.Simulation.resume(path)


def of_one(left, name, field, value):
    """Change a field of the first disc that has left (1), or of the first that has not (0)."""

    def changed(header, arrays):
        disc = int(np.flatnonzero(arrays["solver.exits"][:, 0] == left)[0])
        arrays[name][disc, field] = value

    return changed


def gone_without_events(header, arrays):
    of_one(0, "solver.disc", slice(5, 7), np.inf)(header, arrays)
    of_one(0, "solver.exits", 0, 1.0)(header, arrays)


HOSTILE_FEATURES = {
    "a disc that has half left": of_one(1, "solver.exits", 0, 0.5),
    "a place of leaving that is not a number": of_one(1, "solver.exits", 1, np.nan),
    "a place of leaving far outside": of_one(1, "solver.exits", 1, 1e6),
    "a place of leaving of a disc that is there": of_one(0, "solver.exits", 1, 3.0),
    "a disc that has left and has an event": of_one(0, "solver.exits", 0, 1.0),
    "a disc that has left and flies": of_one(1, "solver.disc", 2, 1.0),
    "a disc that flies and has left": gone_without_events,
    "a disc that is back and left nowhere": of_one(1, "solver.exits", 0, 0.0),
    "an obstacle beyond the last": of_one(0, "solver.event", 3, 5 + 2),
    "a disc ahead of the present": of_one(0, "solver.disc", 4, 1e9),
    "a spin that is not a number": put("solver.spin", 3, np.nan),
    "no exits": lambda header, arrays: arrays.pop("solver.exits"),
    "no piston": lambda header, arrays: (
        header["scene"].update(piston=None) or put("solver.event", (slice(None), 3), 4)(header, arrays)
    ),
    "a piston that leaves no room": lambda header, arrays: header["scene"]["piston"][1].update(stop=0.5),
    "no obstacles": lambda header, arrays: (
        header["scene"].update(obstacles=[]) or put("solver.event", (slice(None), 3), 5)(header, arrays)
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", HOSTILE_FEATURES)
def test_no_feature_of_an_exact_checkpoint_is_in_an_impossible_state(what, tmp_path):
    path = saved(tmp_path / "run", exact_zoo(), method="event", dt=0.3, frames=6)
    rewrite(path, HOSTILE_FEATURES[what])
    with pytest.raises(mpsim.CheckpointError, match=r"(?s)cannot be read|not a state of a simulation"):
        mpsim.Simulation.resume(path)


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_number_of_discs_is_compared_with_the_arrays_before_room_is_made_for_them(method, tmp_path):
    path = saved(tmp_path / "run", lattice(5, 5), method=method)
    rewrite(path, lambda header, arrays: header.update(discs=10**8))
    tracemalloc.start()
    try:
        with pytest.raises(mpsim.CheckpointError, match="no array for 100000000 discs"):
            mpsim.Simulation.resume(path)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_a_checkpoint_that_is_only_rewritten_is_accepted(tmp_path):
    """The control of all hostile ones."""
    exact = {"method": "event", "dt": 0.3}
    for scene, settings in ((zoo(WORDS, count=5), {}), (lattice(5, 5), exact), (exact_zoo(), exact | {"frames": 6})):
        path = saved(tmp_path / "run", scene, **settings)
        rewrite(path, lambda header, arrays: None)
        with mpsim.Simulation.resume(path) as sim:
            assert sim.frame == settings.get("frames", 3)
            assert "frames" not in settings or 0 < (~sim.state.present).sum() < sim.count, "some have left"


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("method", ["grid", "event", "event with features"])
def test_a_random_value_anywhere_is_refused_or_runs(method, tmp_path, figures):
    """Whatever passes the gate must run without a crash: in a process of its own, as a crash would end this one."""
    scene = "exact_zoo()" if method.endswith("features") else "lattice(4, 4)"
    outcome = run_script(FUZZ.format(method=method.split()[0], scene=scene, folder=str(tmp_path)), bound=800)
    assert_clean(outcome)
    refused, ran, failed = map(int, outcome.out.split())
    assert refused > 300
    figures.note("R7", method, "a random value in a random array, with a correct digest",
                 "refused, or runs, or an error of mpsim",
                 f"{refused} refused, {ran} ran, {failed} ended by an error of mpsim, 0 crashes")  # fmt: skip


FUZZ = """
import shutil, warnings
from pathlib import Path
import numpy as np
import mpsim
from support.checkpoints import rewrite
from support.scenes import exact_zoo, lattice, simulate

folder, rng = Path({folder!r}), np.random.default_rng(1)
with simulate({scene}, method={method!r}, dt=0.3) as sim:
    sim.run(frames=6)
    sim.save(folder / "whole")

def spoil(header, arrays):
    name = rng.choice([name for name in arrays if arrays[name].size])
    array = arrays[name].reshape(-1)
    place = rng.integers(array.size)
    if array.dtype.kind == "f":
        near = [rng.normal(), array[place] * 1.01]
        array[place] = rng.choice([0.0, -1.0, 1e-300, 1e300, np.inf, -np.inf, np.nan, *near])
    else:
        array[place] = rng.choice([-(2**31), -2, -1, 0, 1, 7, 16, 2**31 - 1])

warnings.simplefilter("ignore")
counts = [0, 0, 0]
for attempt in range(1000):
    shutil.copy(folder / "whole", folder / "run")
    rewrite(folder / "run", spoil)
    try:
        sim = mpsim.Simulation.resume(folder / "run")
    except mpsim.CheckpointError:
        counts[0] += 1
        continue
    with sim:
        try:
            sim.run(frames=20)
            counts[1] += 1
        except mpsim.MpsimError:
            counts[2] += 1
print(*counts)
"""
