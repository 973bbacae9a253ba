"""A damaged checkpoint leads to the one before, with a warning that names both, or to an error."""

import warnings

import pytest
from support.checkpoints import frame_in, rewrite, saved, two
from support.scenes import lattice

import mpsim
from mpsim.engine import checkpoint


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


def test_a_file_cut_short_anywhere_leads_to_the_one_before(tmp_path, figures):
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
    figures.note("R6", "grid", "a truncated file", "the previous one, and a warning", f"{len(cuts)} of {len(cuts)}")


def flipped(path, places, figures):
    """Flip one bit at each place, and read."""
    whole, harmless = path.read_bytes(), 0
    expected = checkpoint.digest_of(*checkpoint._unpacked(path))
    for place in places:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        path.write_bytes(damaged)
        found = outcome_of(path)
        if found == 3:  # a bit that means nothing, such as one of a date
            assert checkpoint.digest_of(*checkpoint._unpacked(path)) == expected
            harmless += 1
        else:
            assert found == 2, f"byte {place}"
    assert harmless < len(places) / 3
    return f"{len(places) - harmless} times the previous one, {harmless} times the same content"


def test_a_flipped_bit_anywhere_changes_nothing_or_leads_to_the_one_before(tmp_path, figures):
    path = two(tmp_path / "run")
    found = flipped(path, range(0, path.stat().st_size, 13), figures)
    figures.note("R6", "grid", "one bit flipped, in every 13th byte", "the same content, or the previous one", found)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_flipped_bit_in_every_byte_changes_nothing_or_leads_to_the_one_before(method, tmp_path, figures):
    path = tmp_path / "run"
    for frames in (2, 3):
        saved(path, lattice(3, 3), frames=frames, method=method)
    found = flipped(path, range(path.stat().st_size), figures)
    figures.note("R6", method, "one bit flipped, in every byte", "the same content, or the previous one", found)


def test_a_file_of_a_newer_format_is_refused_by_number_and_not_passed_over(tmp_path):
    path = two(tmp_path / "run")
    rewrite(path, lambda header, arrays: header.update(format=8))
    with pytest.raises(
        mpsim.CheckpointError, match=r"is of format 8; this version of mpsim reads up to 7. Use a newer"
    ):
        mpsim.Simulation.resume(path)


def test_the_warning_stands_where_the_user_asked(tmp_path):
    path = two(tmp_path / "run")
    path.write_bytes(b"")
    with pytest.warns(mpsim.errors.CheckpointWarning, match="Continuing from the previous one") as told:
        mpsim.Simulation.resume(path).close()
    assert told[0].filename == __file__


def test_no_file_at_all_is_an_error_that_names_both(tmp_path):
    with pytest.raises(mpsim.CheckpointError, match=r"no such file.*run\.previous.*no such file"):
        mpsim.Simulation.resume(tmp_path / "run")
