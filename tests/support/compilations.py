"""Scenes of which each needs machine code of its own, for every feature, alone and together, and their digests.

python -m support.compilations NAMES      digests as JSON, by kernels compiled as the environment says, and how
"""

import itertools
import json
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from numba import config
from numba.core.registry import cpu_target

import mpsim
from support.scenes import EXACT, ZOO, digest_after, exact_scene, zoo

FRAMES = 20

WORDS = {"no features": "", "gravity": "gravity", "acceleration": "acceleration", "heated": "heated lossy"} | ZOO
"""Features of the stepped scenes, by name: words for `zoo`."""


@dataclass(frozen=True)
class Case:
    """A scene, by the words of its features or by its name among the exact ones, and settings."""

    features: str
    settings: dict[str, Any] = field(default_factory=dict)

    def scene(self) -> mpsim.Scene:
        if self.settings["method"] == "event":
            return exact_scene(self.features)
        return zoo(self.features, 40, seed=6, side=10.0)

    def digest(self) -> str:
        """Digest of the state after the last frame."""
        with warnings.catch_warnings():
            for kind in (mpsim.errors.EmitterWarning, mpsim.FastWarning):  # they are dropped on each other
                warnings.simplefilter("ignore", kind)
            return digest_after(self.scene(), FRAMES, **self.settings)


def _cases() -> dict[str, Case]:
    kinds = list(itertools.product(("float32", "float64"), ("push", "impact")))
    found = {}
    for name, words in WORDS.items():
        kept = (
            kinds if name in ("no features", "everything") else [("float32" if len(found) % 2 else "float64", "impact")]
        )
        for precision, contact in kept:
            settings = {"method": "grid", "precision": precision, "contact": contact, "dt": 0.03}
            found[f"{name} {precision} {contact}"] = Case(words, settings)
    for name in ("no features", "everything"):
        found[f"naive {name}"] = Case(WORDS[name], {"method": "naive", "contact": "impact", "dt": 0.03})
    substeps = {"method": "grid", "contact": "impact", "dt": 0.3, "on_fast": "substep"}
    found["sub-steps"] = Case("lossy", substeps)
    for name in EXACT:
        found[f"event {name}"] = Case(name, {"method": "event", "dt": 0.05})
    return found


CASES = _cases()


def digests(names: Iterable[str]) -> dict[str, str]:
    return {name: CASES[name].digest() for name in names}


def report(names: Iterable[str]) -> dict[str, Any]:
    """For what processor and how hard the compiler worked, digests of the starts, and those after the last frame."""
    names = list(names)
    return {
        "processor": cpu_target.target_context.codegen().magic_tuple()[1],
        "optimization": int(config.OPT),
        "starts": {name: CASES[name].scene().digest() for name in names},
        "digests": digests(names),
    }


if __name__ == "__main__":
    print(json.dumps(report(sys.argv[1:])))
