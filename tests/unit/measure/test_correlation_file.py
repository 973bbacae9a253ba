"""Files of correlations: what was gathered comes back to the bit, and nothing else is taken for such a file."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim import Correlations


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("correlations") / "c.npz"
    found = Correlations(every=3, start=0.1, discs=[4, 1, 2], wave_numbers=[0.5, 2.0], points=8)
    with simulate(gas(20, 0.2, seed=1, boundary="periodic"), dt=0.05, method="grid") as sim:
        sim.run(frames=400, observe=found)
    return found.save(path), found


def test_what_was_gathered_comes_back_to_the_bit(written):
    path, found = written
    again = Correlations.load(path)
    assert (again.every, again.start, again.path) == (3, 0.1, path)
    assert again.wave_numbers.tolist() == [0.5, 2.0]
    for one, other in ((again.msd, found.msd), (again.velocity, found.velocity)):
        assert one.lag.tobytes() == other.lag.tobytes()
        assert [repr(each) for each in one.measures] == [repr(each) for each in other.measures]
    assert again.scattering(2.0).value.tobytes() == found.scattering(2.0).value.tobytes()
    assert repr(again) == repr(found)


def changed(path, tmp_path, **arrays):
    with np.load(path) as file:
        kept = {name: file[name] for name in file.files}
    kept = {name: value for name, value in (kept | arrays).items() if value is not None}
    np.savez(tmp_path / "changed.npz", **kept)
    return tmp_path / "changed.npz"


def test_a_file_that_was_only_written_again_is_taken(written, tmp_path):
    """Control of the control: it is the changes that are refused."""
    assert len(Correlations.load(changed(written[0], tmp_path)).msd) == len(written[1].msd)


WRONG = {
    "no head": ("numbers", lambda a: None, "numbers"),
    "another version": ("numbers", lambda a: a + (np.arange(len(a)) == 0), "it is of version 3, and 2 is read"),
    "odd points": ("numbers", lambda a: np.where(np.arange(len(a)) == 2, 9, a), "its points or levels are wrong"),
    "many levels": ("numbers", lambda a: np.where(np.arange(len(a)) == 4, 10**6, a), "its points or levels are wrong"),
    "no samples": ("numbers", lambda a: np.where(np.arange(len(a)) == 5, 0, a), "its number of samples is wrong"),
    "span 0": ("numbers", lambda a: np.where(np.arange(len(a)) == 6, 0, a), "its number of samples is wrong"),
    "few discs": ("numbers", lambda a: np.where(np.arange(len(a)) == 7, 2, a), "its discs are not there"),
    "every 0": ("numbers", lambda a: np.where(np.arange(len(a)) == 1, 0, a), "its times are wrong"),
    "dt 0": ("reals", lambda a: np.where(np.arange(len(a)) == 1, 0.0, a), "its intervals are wrong"),
    "no number": ("reals", lambda a: a * np.nan, "its head is wrong"),
    "waves": ("wave_numbers", lambda a: a[:, None], "its waves are wrong"),
    "waves of 0": ("wave_numbers", lambda a: a * 0, "its waves are wrong"),
    "no discs": ("discs", lambda a: a[:0], "it has no discs"),
    "a disc twice": ("discs", lambda a: a * 0, "it has no discs"),
    "levels": ("received", lambda a: a - 10**6, "its levels are wrong"),
    "recent": ("recent", lambda a: a[:, 1:], "its recent are wrong"),
    "infinite": ("recent", lambda a: a + np.inf, "its recent are wrong"),
    "latest": ("latest", lambda a: a.astype(np.float32), "its latest are wrong"),
    "sums": ("sums", lambda a: a[:-1], "its sums are wrong"),
    "counts": ("counts", lambda a: -a, "its counts are wrong"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_with_something_wrong_in_it_is_refused(case, written, tmp_path):
    name, change, words = WRONG[case]
    with np.load(written[0]) as file:
        value = change(file[name])
    with pytest.raises(mpsim.InputError) as caught:
        Correlations.load(changed(written[0], tmp_path, **{name: value}))
    assert "a file of Correlations must be one that mpsim has written" in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize("length", [0, 10, 1000, -1])
def test_a_file_that_is_cut_off_is_refused(length, written, tmp_path):
    cut = tmp_path / "cut.npz"
    cut.write_bytes(written[0].read_bytes()[:length])
    with pytest.raises(mpsim.InputError, match="must be one that mpsim has written"):
        Correlations.load(cut)


def test_no_file_a_folder_and_another_ending_are_refused(tmp_path):
    (tmp_path / "folder.npz").mkdir()
    for path, words in (("none.npz", "No such file"), ("folder.npz", "directory"), ("c.txt", "must end in .npz")):
        with pytest.raises(mpsim.InputError) as caught:
            Correlations.load(tmp_path / path)
        assert words in str(caught.value)
