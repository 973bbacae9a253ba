"""Damaged scene files and forged checkpoints, thousands of them: a scene or a simulation, or an error that says why.

Whatever else comes out is a failure, and so is memory far beyond what the file is worth. Each damage follows from a
number, so a failure names the one to try again.
"""

import contextlib
import random
import time
import tracemalloc
import warnings
from typing import Any

import numpy as np
import pytest
from support.checkpoints import rewrite, saved
from support.processes import run_script
from support.scenes import exact_zoo, gas, zoo

import mpsim
from mpsim.scene import scenefile
from mpsim.scene.scenefile import PACKAGED

FEW, MANY = 20, 20_000  # executions of each test by default, and with --long

MEMORY = 100_000_000
"""Bytes that reading one file may take: the files here are of some 10 kB, their scenes of at most 2000 discs."""

SCENES = ("cradle", "galton", "mixture", "piston", "growth", "channel")
"""Named scenes that together use all that a scene file knows."""

SAYS_WHERE = """
schema = 1
width = 9.0
height = 6.0
boundary = "walls"
restitution = 0.5
absorbing = ["left"]

[settings]
dt = 0.01
substeps = 2

[[discs]]
position = [[1.0, 1.0], [3.0, 3.0]]
velocity = [[1.0, 0.0], [0.0, 1.0]]
radius = [0.5, 0.25]
mass = 2.0
"""


def read_scene(content, folder):
    """Load what should be a scene file; returns whether it was one."""
    path = folder / "scene.toml"
    path.write_bytes(content)
    try:
        scenefile.load(path)
    except mpsim.errors.SceneFileError:
        return False
    return True


def read_checkpoint(path):
    """Resume from what should be a checkpoint, and go on from there; returns whether it was one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            sim = mpsim.Simulation.resume(path)
        except mpsim.CheckpointError:
            return False
        with sim, contextlib.suppress(mpsim.MpsimError, Enough):  # of a state that may be, but cannot go on
            if is_short(sim.settings):
                sim.run(frames=2, progress=until_enough())
    return True


class Enough(Exception):  # noqa: N818 - no error
    """A state takes its time, as a fast disc may; that it can be interrupted shows that it is no loop without end."""


def until_enough(seconds=1.0):
    """A progress function that ends a run after so many seconds."""
    end = time.monotonic() + seconds

    def progress(done, frames):
        if time.monotonic() > end:
            raise Enough

    return progress


def is_short(settings):
    """Whether two frames take no time to speak of: a forger may ask for as much work as anybody."""
    steps = settings.substeps * settings.passes
    return settings.dt <= 1 if settings.method == "event" else steps <= 20 and settings.on_fast != "substep"


def count_good(times, first, trial):
    """Run trials numbered from `first` on; returns how many were accepted. A failure names its number."""
    good = 0
    tracemalloc.start()
    try:
        for number in range(first, first + times):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            try:
                good += trial(random.Random(number))
            except Exception as error:
                error.add_note(f"damage number {number}")
                raise
            peak = tracemalloc.get_traced_memory()[1] - before
            assert peak < MEMORY, f"damage number {number} took {peak:,} bytes"
    finally:
        tracemalloc.stop()
    return good


def executions(request):
    return MANY if request.config.getoption("--long") else FEW


@pytest.mark.timeout(900)  # of --long, on a busy machine
def test_damaged_scene_files(request, tmp_path):
    texts = [SAYS_WHERE, *((PACKAGED / f"{name}.toml").read_text() for name in SCENES)]
    texts = [text.replace("count = 800", "count = 80") for text in texts]

    def trial(rng):
        text = rng.choice(texts)
        if rng.random() < 0.3:
            return read_scene(damaged_bytes(text.encode(), rng), tmp_path)
        return read_scene(damaged_text(text, rng).encode("utf-8", "replace"), tmp_path)

    times = min(executions(request), 4000)
    assert 0 < count_good(times, 1, trial) < times, "neither is every damage harmless nor every file refused"


def checkpoints(folder):
    """Of the stepped solver and of the exact one, each plain and with features."""
    made = [
        saved(folder / "stepped", zoo("absorbing emitters acceleration", count=5)),
        saved(folder / "plain", gas(5, 0.2), on_fast="substep"),
        saved(folder / "exact", gas(5, 0.2), method="event", contact="impact"),
        saved(folder / "exact-zoo", exact_zoo(), method="event", dt=0.3, frames=6),
    ]
    return [path.read_bytes() for path in made]


def forge(header, arrays, rng):
    """Other values in the header, in an array, or in both."""
    if rng.random() < 0.6:
        found = damaged_values(header, rng)
        if isinstance(found, dict):
            header.clear()
            header.update(found)
    if rng.random() < 0.6 and arrays:
        name = rng.choice(sorted(arrays))
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            arrays[name] = damaged_array(arrays[name], rng)


def forge_checkpoints(folder, times):
    """How many of so many forged checkpoints still run."""
    contents, path = checkpoints(folder), folder / "run"

    def trial(rng):
        path.write_bytes(rng.choice(contents))
        rewrite(path, lambda header, arrays: forge(header, arrays, rng))
        return read_checkpoint(path)

    return count_good(times, 1, trial)


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_forged_checkpoints(request, tmp_path):
    """The digest is right, as whoever forges one can compute it; what is refused must be refused for what it says.

    Kernels are plain Python: there an index that leads out of an array is an error.
    """
    times = executions(request)
    call = f"test_fuzzing.forge_checkpoints(Path({str(tmp_path)!r}), {times})"
    text = f"from pathlib import Path; from faults import test_fuzzing; print({call})"
    outcome = run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=60 + times / 10)
    assert outcome.code == 0, outcome.err
    assert 0 < int(outcome.out) < times


# --- damage to files, of bytes, of words, and of values under a good digest

NUMBERS = [0, -0.0, -1, 1, 2, 3.5, 1e-320, 1e-9, 1e9, 1e30, 1e300, float("nan"), float("inf"), 2**31, 2**63, 10**400]
WORDS = ["", "walls", "periodic", "left", "../../../etc/passwd", "/dev/zero", "a\0b", "event", "x" * 5000, "ü\u202e"]


def anything(rng: random.Random, depth: int = 3) -> Any:
    """A value of any kind."""
    kind = rng.randrange(8 if depth else 5)
    if kind < 3:
        return rng.choice(NUMBERS)
    if kind == 3:
        return rng.choice(WORDS)
    if kind == 4:
        return rng.choice([None, True, False])
    if kind < 7:
        return [anything(rng, depth - 1) for _ in range(rng.randrange(4))]
    return {rng.choice([*WORDS, "kind", "radius"]): anything(rng, depth - 1) for _ in range(rng.randrange(3))}


def damaged_bytes(content: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, cut, doubled, moved or replaced, in a few places."""
    found = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 5, 50])):
        if not found:
            break
        at, length = rng.randrange(len(found)), rng.choice([1, 2, 8, 64, 1000])
        match rng.randrange(6):
            case 0:
                found[at] ^= 1 << rng.randrange(8)
            case 1:
                del found[at : at + length]
            case 2:
                del found[at:]
            case 3:
                found[at:at] = found[at : at + length]
            case 4:
                found[at : at + length] = rng.randbytes(length)
            case _:
                other = rng.randrange(len(found))
                found[at : at + length] = found[other : other + length]
    return bytes(found)


def damaged_text(text: str, rng: random.Random) -> str:
    """Lines of a scene file dropped, doubled, mixed, and values replaced by others."""
    lines = text.splitlines()
    for _ in range(rng.choice([1, 1, 2, 4])):
        at = rng.randrange(len(lines))
        match rng.randrange(5):
            case 0:
                del lines[at]
                lines = lines or [""]
            case 1:
                lines.insert(rng.randrange(len(lines)), lines[at])
            case 2:
                rng.shuffle(lines)
            case _ if "=" in lines[at]:
                lines[at] = f"{lines[at].split('=')[0]}= {toml_of(anything(rng))}"
            case _:
                lines[at] = damaged_bytes(lines[at].encode(), rng).decode("utf-8", "replace")
    return "\n".join(lines)


def toml_of(value: Any) -> str:
    """A value as TOML writes it; None as a word that means nothing there."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_of(str(name))} = {toml_of(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_of, value)) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("\0", "\\u0000") + '"'
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return repr(value)


def damaged_values(plain: Any, rng: random.Random) -> Any:
    """A tree of plain values with one of them replaced, removed or added."""
    if isinstance(plain, dict) and plain and rng.random() < 0.9:
        name, found = rng.choice(sorted(plain)), dict(plain)
        match rng.randrange(8):
            case 0:
                del found[name]
            case 1:
                found[rng.choice(WORDS)] = anything(rng)
            case _:
                found[name] = damaged_values(found[name], rng)
        return found
    if isinstance(plain, list) and plain and rng.random() < 0.8:
        at = rng.randrange(len(plain))
        return [damaged_values(part, rng) if k == at else part for k, part in enumerate(plain)]
    return anything(rng)


def damaged_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    """An array with elements, shape or dtype changed."""
    found = array.copy()
    match rng.randrange(6):
        case 0:
            return found.astype(rng.choice(["<f4", "<f8", "<i4", "<i8", "|u1", "<c16"]), casting="unsafe")
        case 1:
            return found[: rng.randrange(len(found) + 1)] if found.ndim else found.reshape(1)
        case 2:
            return np.concatenate([found, found]) if found.ndim else found
        case _ if found.size:
            flat = found.reshape(-1)
            for _ in range(rng.choice([1, 3])):
                value = rng.choice([number for number in NUMBERS if abs(number) < 2**31] + [float("nan"), float("inf")])
                with np.errstate(all="ignore"):
                    at = rng.randrange(flat.size)
                    flat[at : at + 1] = np.array([value]).astype(found.dtype)
    return found
