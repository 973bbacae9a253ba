"""Loops in pieces, by threads."""

import threading

import pytest

from mpsim.core import pieces


@pytest.fixture
def cores(monkeypatch):
    """Three cores may be used, whatever the machine has, and any loop is worth a thread."""
    monkeypatch.setattr(pieces, "usable_cores", lambda: 3)
    monkeypatch.setattr(pieces, "WORTH_A_THREAD", 1)


@pytest.mark.parametrize("count", [2, 3, 10, 100])
def test_pieces_are_the_whole_range_in_order_each_by_one_of_the_cores(cores, count):
    done = pieces.in_pieces(lambda first, last: (first, last), count)
    assert len(done) == min(count, 3)
    assert [place for first, last in done for place in range(first, last)] == list(range(count))


def test_pieces_are_done_at_once(cores):
    met = threading.Barrier(3)
    assert len(pieces.in_pieces(lambda first, last: met.wait(60) if last else 0, 30)) == 3


def test_little_work_is_done_by_the_caller(monkeypatch):
    monkeypatch.setattr(pieces, "usable_cores", lambda: 3)
    assert pieces.in_pieces(lambda first, last: threading.current_thread(), 10) == [threading.current_thread()]
    assert len(pieces.in_pieces(lambda first, last: 0, 10, pieces.WORTH_A_THREAD)) == 3


def test_an_exception_of_a_piece_is_raised(cores):
    def fail(first, last):
        if first:
            raise ValueError(first)

    with pytest.raises(ValueError, match="3"):
        pieces.in_pieces(fail, 9)


@pytest.mark.parametrize("allowed", [0, 1, 2])
def test_each_piece_is_done_once_also_where_the_system_allows_few_threads(cores, monkeypatch, allowed):
    """Work that is not done twice: whoever counts in a piece counts its elements."""
    threads, done, start = [], [], threading.Thread.start

    def refuse(thread):
        if len(threads) == allowed:
            raise RuntimeError("can't start new thread")
        threads.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refuse)
    for _ in range(50):
        threads.clear()
        done.clear()
        assert pieces.in_pieces(lambda first, last: done.append(range(first, last)) or last, 9) == [3, 6, 9]
        assert sorted(place for piece in done for place in piece) == list(range(9))
