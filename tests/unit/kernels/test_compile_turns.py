"""Turns of compiling between processes, which locks of the same file stand for here."""

import threading
import time

import pytest

from mpsim.kernels import compile_turns
from mpsim.kernels.compile_turns import Turns


def test_what_another_has_compiled_meanwhile_is_loaded(tmp_path):
    first, second, cache, found = Turns(tmp_path, "kernel"), Turns(tmp_path, "kernel"), {}, []
    assert first.load_or_take("float64", lambda: None) is None
    waiting = threading.Thread(target=lambda: found.append(second.load_or_take("float64", lambda: cache.get("code"))))
    waiting.start()
    time.sleep(0.1)
    assert waiting.is_alive()
    cache["code"] = "machine code"
    first.give_back()
    waiting.join(10)
    assert found == ["machine code"]
    assert first.load_or_take("float64", lambda: None) is None, "who loads it keeps no turn"


@pytest.mark.parametrize(("name", "signature"), [("kernel", "float32"), ("another kernel", "float64")])
def test_another_kernel_and_another_signature_wait_for_nobody(tmp_path, name, signature):
    first, second = Turns(tmp_path, "kernel"), Turns(tmp_path, name)
    first.load_or_take("float64", lambda: None)
    begin = time.monotonic()
    assert second.load_or_take(signature, lambda: None) is None
    assert time.monotonic() - begin < 5
    first.give_back()
    second.give_back()


def test_nobody_waits_for_ever_for_one_that_keeps_its_turn(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_turns, "LONGEST", 0.1)
    first, second = Turns(tmp_path, "kernel"), Turns(tmp_path, "kernel")
    first.load_or_take("float64", lambda: None)
    assert second.load_or_take("float64", lambda: "not asked for") is None
    first.give_back()


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path):
    assert Turns(tmp_path / "is not there", "kernel").load_or_take("float64", lambda: "not asked for") is None
