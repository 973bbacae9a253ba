"""The file of time correlations: all the data of a run so far, so that a resumed run gives the same bits."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import atomic, untrusted
from mpsim.core.archive import DAMAGE, ArrayFile
from mpsim.errors import InputError, OutputError, reason_of
from mpsim.measure.motion import MOST_WAVE_NUMBERS, WAVES, Motion, correlator
from mpsim.measure.multiple_tau import MOST_PARTS

Floats = NDArray[np.float64]

FORMAT = 2
"""Version of the file."""

_NUMBERS = ("format", "every", "points", "frame", "levels", "samples", "span", "count", "constant")
_REALS = ("start", "dt", "interval", "memory")

MOST_LEVELS = 40
"""Levels at most: the longest lag is then beyond any run."""


class Contents(NamedTuple):
    """Contents of a file: the accumulated data, and the arguments by name."""

    motion: Motion
    numbers: dict[str, int]
    reals: dict[str, float]
    wave_numbers: Floats


def new_place(path: str | os.PathLike[str]) -> Path:
    """The path of a file that does not exist yet.

    Raises:
        InputError: for another ending, or if the file exists.
    """
    target = place(path)
    if target.exists():
        raise InputError(
            f"path of Correlations must be that of a new file; {str(target)!r} is there already. Continue it by "
            "mpsim.Correlations.load(path), or give another name."
        )
    return target


def place(path: Any) -> Path:
    """The path, which must end in .npz."""
    if not isinstance(path, str | os.PathLike) or Path(os.fsdecode(path)).suffix != ".npz":
        raise InputError(f"the path of Correlations must end in .npz; got {path!r}. Use 'run.npz'.")
    return Path(os.fsdecode(path))


def write(
    path: str | os.PathLike[str],
    motion: Motion,
    numbers: Mapping[str, int],
    reals: Mapping[str, float],
    wave_numbers: Floats,
) -> Path:
    """Write a file as a whole. Returns its path.

    Raises:
        InputError: for another ending.
        OutputError: if it cannot be written.
    """
    target, blocks = place(path), motion.correlator.blocks
    used, levels = -(-blocks.samples // blocks.span), int(np.log2(motion.correlator.width[-1])) + 1
    own = {"format": FORMAT, "levels": levels, "samples": blocks.samples, "span": blocks.span}
    all_numbers = {**numbers, **own, "constant": int(motion.constant)}
    all_reals = {**reals, "interval": motion.interval, "memory": motion.memory}
    arrays = {
        "numbers": np.array([all_numbers[name] for name in _NUMBERS], np.int64),
        "reals": np.array([all_reals[name] for name in _REALS]),
        "wave_numbers": wave_numbers,
        "discs": motion.discs,
        "latest": motion.latest,
        "sums": blocks.sums[:used],
        "counts": blocks.counts[:used],
        "received": np.array(motion.correlator.received, np.int64),
        "recent": np.array(motion.correlator.recent),
    }
    try:
        with atomic.atomic_write(target) as file:
            np.savez(file, **arrays)
    except OSError as error:
        raise OutputError(
            f"a file of Correlations must be in a folder that can be written to; got {str(target)!r} "
            f"({error.strerror}). Choose another place."
        ) from error
    return target


def read(path: str | os.PathLike[str]) -> Contents:
    """Read what `write` wrote, bit for bit. Nothing in the file is executed.

    Raises:
        InputError: if it is not such a file.
    """
    source = place(path)
    try:
        with untrusted.opened(source) as file, ArrayFile(file) as arrays:
            return _contents({name: arrays.read(name) for name in arrays.names})
    except (OSError, *DAMAGE) as error:
        raise InputError(
            f"a file of Correlations must be one that mpsim has written; {str(source)!r}: {reason_of(error):.200}."
        ) from None


def _contents(arrays: Mapping[str, NDArray[Any]]) -> Contents:
    """The contents of the arrays of a file, checked."""
    numbers = _named(arrays["numbers"], np.int64, _NUMBERS)
    reals = _named(arrays["reals"], np.float64, _REALS)
    _demand(numbers["format"] == FORMAT, f"it is of version {numbers['format']}, and {FORMAT} is read")
    points, levels, span, samples = (numbers[name] for name in ("points", "levels", "span", "samples"))
    _demand(4 <= points <= 256 and points % 2 == 0 and 1 <= levels <= MOST_LEVELS, "its points or levels are wrong")
    _demand(span >= 1 and 1 <= samples <= span * MOST_PARTS, "its number of samples is wrong")
    _demand(numbers["every"] >= 1 and numbers["frame"] >= 0 and reals["start"] >= 0, "its times are wrong")
    _demand(0 <= reals["memory"] < np.inf, "its memory is wrong")
    _demand(0 < reals["dt"] < np.inf and 0 < reals["interval"] < np.inf, "its intervals are wrong")
    waves, discs, received = arrays["wave_numbers"], arrays["discs"], arrays["received"]
    _demand(waves.dtype == np.float64 and waves.ndim == 1 and len(waves) <= MOST_WAVE_NUMBERS, "its waves are wrong")
    _demand(((waves > 0) & (waves < np.inf)).all(), "its waves are wrong")
    _demand(discs.dtype == np.int64 and discs.ndim == 1 and len(np.unique(discs)) == len(discs) > 0, "it has no discs")
    _demand(discs.min() >= 0 and discs.max() < numbers["count"], "its discs are not there")
    _demand(received.dtype == np.int64 and received.ndim == 1 and len(received) <= levels, "its levels are wrong")
    _demand(len(received) > 0 and received.min() >= 0 and received.max() <= samples, "its levels are wrong")
    shape = (2, len(discs), 2)
    latest = _shaped(arrays, "latest", np.float64, shape)
    recent = _shaped(arrays, "recent", np.float64, (len(received), points, *shape))
    found, used = correlator(waves, points, levels), -(-samples // span)
    sums = _shaped(arrays, "sums", np.float64, (used, len(found.lags), WAVES + len(waves)))
    counts = _shaped(arrays, "counts", np.int64, (used, len(found.lags)))
    _demand(counts.min() >= 0 and counts.max() <= span, "its counts are wrong")
    found.blocks.samples, found.blocks.span = samples, span
    found.blocks.sums[:used], found.blocks.counts[:used] = sums, counts
    found.received, found.recent = received.tolist(), [each.copy() for each in recent]
    fixed = reals["interval"], bool(numbers["constant"]), reals["memory"], numbers["count"]
    motion = Motion(found, discs.copy(), latest.copy(), *fixed)
    return Contents(motion, numbers, reals, waves.copy())


def _named(array: NDArray[Any], dtype: Any, names: tuple[str, ...]) -> dict[str, Any]:
    _demand(array.dtype == dtype and array.shape == (len(names),) and not np.isnan(array).any(), "its head is wrong")
    return dict(zip(names, array.tolist(), strict=True))


def _shaped(arrays: Mapping[str, NDArray[Any]], name: str, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    array = arrays[name]
    _demand(array.dtype == dtype and array.shape == shape and bool(np.isfinite(array).all()), f"its {name} are wrong")
    return array


def _demand(holds: bool | np.bool_, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)
