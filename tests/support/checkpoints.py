"""Runs that are saved and resumed; and checkpoint files as nobody should write them, with a digest that is right."""

import itertools
import json
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mpsim
from mpsim.core import archive
from mpsim.engine import checkpoint
from support.compare import assert_same_bits
from support.scenes import simulate, zoo

Change = Callable[[dict[str, Any], dict[str, np.ndarray]], None]


def rewrite(path: Path, change: Change, right_digest: bool = True) -> None:
    """Let `change` alter header and arrays of a checkpoint, in place, and write it back."""
    with path.open("rb") as file:
        found = archive.ArrayFile(file)
        arrays = {name: found.read(name).copy() for name in found.names}
    header, digest = json.loads(arrays.pop(checkpoint.HEADER).tobytes()), arrays.pop(checkpoint.DIGEST)
    change(header, arrays)
    text = json.dumps(header).encode()
    if right_digest:
        digest = np.frombuffer(checkpoint.digest_of(text, arrays), np.uint8)
    header = np.frombuffer(text, np.uint8)
    with path.open("wb") as file:  # by another writer than the one that is tested
        np.savez(file, **{checkpoint.HEADER: header, **arrays, checkpoint.DIGEST: digest})


def rewrite_members(path: Path, change: Callable[[dict[str, bytes]], None], compression: int = 0) -> None:
    """Let `change` alter the raw members of the zip file."""
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    change(members)
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)


def frame_in(path: Path) -> int:
    """Frame of the checkpoint that a resume would take."""
    return checkpoint.read(path).snapshot.frame


WORDS = "absorbing emitters acceleration"


def saved(path, scene=None, frames=3, **settings):
    """A checkpoint at a frame of a small scene; returns its path."""
    with warnings.catch_warnings(), simulate(scene or zoo(WORDS, count=5), **{"method": "grid", **settings}) as sim:
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        sim.run(frames=frames)
        return sim.save(path)


def two(path):
    """Two checkpoints: of frame 2, kept as the one before, and of frame 3."""
    saved(path, frames=2)
    return saved(path, frames=3)


def assert_goes_on_inside_a_frame(whole, begun, resume, at, path, names):
    """A frame far longer than a command is left by Ctrl-C, at a call of `progress`, and goes on where it is resumed.

    whole, begun: simulations of the same; resume: a function of the path. names: of measures, which are those of both.
    """
    calls = itertools.count()

    def interrupt(done, of):
        if next(calls) == at:
            raise KeyboardInterrupt

    with whole:
        expected, state = whole.run(frames=2, measures=names).measures, whole.state
    with begun as sim:
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=2, progress=interrupt)
        assert sim.frame == 0 < sim.time
        stopped = sim.time, sim.digest()
        sim.save(path)
    with resume(path) as sim:
        assert (sim.time, sim.digest()) == stopped
        found = sim.run(frames=2, measures=names).measures
        assert_same_bits(sim.state, state, "from inside a frame")
    for name in names:
        assert found[name].value == expected[name].value, "what the frame had counted is lost"


def in_parts(scene, path, parts, *resumed_on, **settings):
    """State after runs of so many frames, each but the first by a resumed simulation, on these numbers of workers."""
    with simulate(scene, **settings) as sim:
        sim.run(frames=parts[0])
        sim.save(path)
    for frames, workers in itertools.zip_longest(parts[1:], resumed_on):
        with mpsim.Simulation.resume(path, workers=workers) as sim:
            sim.run(frames=frames)
            sim.save(path)
            state = sim.state
    assert sim.frame == sum(parts)
    return state
