"""Work in a thread of its own: it ends, it can be given up, and the next piece takes its place."""

import threading

from mpsim.viewer.background import Background

PATIENCE = 20.0


def until_given_up(started, ended):
    def work(check):
        started.set()
        try:
            while True:
                check()
        finally:
            ended.set()

    return work


def test_work_is_given_up_where_it_checks():
    started, ended, background = threading.Event(), threading.Event(), Background("test")
    background.start(until_given_up(started, ended))
    assert started.wait(PATIENCE)
    assert not ended.is_set()
    background.stop()
    assert ended.is_set()
    background.stop()


def test_new_work_takes_the_place_of_the_old():
    first, ended, found, background = threading.Event(), threading.Event(), [], Background("test")
    background.start(until_given_up(first, ended))
    background.start(lambda check: found.append(1))
    background.wait(PATIENCE)
    assert ended.is_set()
    assert found == [1]
