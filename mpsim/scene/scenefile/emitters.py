"""Emitters in scene files: [[emitters]]."""

from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, model_validator

from mpsim.errors import InputError
from mpsim.features.emitters import LARGEST_EMITTERS, Emitter
from mpsim.features.feature import SceneLike
from mpsim.scene.scenefile.arrays import INLINE
from mpsim.scene.scenefile.part import Part, Tables
from mpsim.scene.scenefile.rules import Table, one_or_many, source_of
from mpsim.scene.scenefile.toml import Files, array_lines, pairs

_EMITTERS = tuple(
    (Emitter, {"position": (0.0, 0.0), "velocity": (0.0, 0.0), **timing})
    for timing in ({"interval": 1.0}, {"every": 1})
)


class EmitterTable(Table):
    """An Emitter, or several: then each value may be an array, one row per row of position."""

    position: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="centre of the new disc [x, y]; of many emitters [[x, y], ...], or a file"),
    ]
    velocity: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="of the new disc [vx, vy]; of many emitters [[vx, vy], ...], or a file"),
    ]
    interval: Annotated[
        Any, one_or_many(*_EMITTERS), Field(description="time between two discs; this or every is needed")
    ] = None
    every: Annotated[
        Any,
        one_or_many(*reversed(_EMITTERS)),
        Field(description="instead of interval: frames between two discs, so another scene for each dt"),
    ] = None
    limit: Annotated[Any, one_or_many(*_EMITTERS), Field(description="total number of discs; default: no limit")] = None
    radius: Annotated[Any, one_or_many(*_EMITTERS), Field(description="default: the radius of all discs")] = None
    mass: Annotated[Any, one_or_many(*_EMITTERS), Field(description="default: 1, if all discs have mass 1")] = None

    _made: list[Emitter] = PrivateAttr(default_factory=list)

    @model_validator(mode="after")
    def _has_its_times(self, info: ValidationInfo) -> "EmitterTable":
        source = source_of(info)
        source.emitters += np.size(self.position) // 2
        if source.emitters > LARGEST_EMITTERS:
            raise InputError(f"all emitters must be at most {LARGEST_EMITTERS:,}; got {source.emitters:,}. Use fewer.")
        self._made = self._emitters()
        return self

    def made(self) -> list[Emitter]:
        """The emitters."""
        return self._made

    def _emitters(self) -> list[Emitter]:
        each: dict[str, Any] = {name: value for name, value in dict(self).items() if value is not None}
        many = {name for name, value in each.items() if isinstance(value, np.ndarray)}
        if not many:
            return [Emitter(**each)]
        count = len(self.position) if "position" in many else 1
        for name in sorted(many):
            if len(each[name]) != count:
                raise InputError(f"{name} must have {count} rows, one per row of position; got {len(each[name])}.")
            values = each[name].tolist()
            whole = name in ("every", "limit") and all(value.is_integer() for value in values)
            each[name] = [int(value) for value in values] if whole else values
        rows = zip(*(each[name] if name in many else [each[name]] * count for name in each), strict=True)
        return [Emitter(**dict(zip(each, row, strict=True))) for row in rows]


class EmittersPart(Part):
    """Where discs enter."""

    argument = "emitters"
    tables: Tables = (("", "`[[emitters]]`", EmitterTable),)
    annotation = list[EmitterTable]
    description = "where discs enter"
    relies_on_discs = True
    advice = "emitters those with the same keys"

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """A table for each emitter; a single one for many consecutive ones with values for the same keys."""
        lines: list[str] = []
        for names, group in groupby(
            getattr(scene, self.argument),
            lambda each: [name for name, value in vars(each).items() if value is not None],
        ):
            alike = list(group)
            if len(alike) > INLINE:
                arrays = {name: [getattr(each, name) for each in alike] for name in names}
                lines += ["[[emitters]]", *array_lines(arrays, target, f"emitters-{len(files)}.", files), ""]
                continue
            for emitter in alike:
                lines += ["[[emitters]]", *pairs(vars(emitter)), ""]
        return lines
