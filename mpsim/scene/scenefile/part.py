"""A feature in scene files: its tables, how its values are made from them, and how it is written."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mpsim.features.feature import Feature, SceneLike
from mpsim.scene.scenefile.rules import Table, as_in
from mpsim.scene.scenefile.toml import Files, pairs

Problem = tuple[str, str]
"""Key path, and the problem there."""


Tables = tuple[tuple[str, str, type[Table]], ...]
"""Of each kind of a table its name in the annotation, its title in the docs, its class."""


class Part:
    """The tables of one feature.

    Attributes:
        argument: of Scene; the key of the tables.
        several: whether there may be many tables, [[argument]].
        tables: for each kind its name in the annotation ("" if there is only one), its title in the docs, its class.
        annotation, default, description: of the key.
        relies_on_discs: whether missing values come from the discs of the scene.
        advice: what keeps a file with very many of them short, to follow "Let ".
    """

    argument: str
    several: bool = True
    tables: Tables
    annotation: Any
    default: Any = []  # noqa: RUF012 - pydantic copies it
    description: str
    relies_on_discs: bool = False
    advice: str = ""

    def made(self, tables: list[Any], problems: list[Problem]) -> tuple[list[Any], list[int]]:
        """The values of all tables, and the table number of each; problems are appended."""
        values = [each.made() for each in tables]
        owners = [index for index, some in enumerate(values) for _ in some]
        return [value for some in values for value in some], owners

    def capsules(self, values: list[Any]) -> NDArray[np.float64]:
        """Capsules that discs must not overlap, shape (K, 5)."""
        return np.empty((0, 5))

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """Its tables as lines of a file; files of its arrays are appended."""
        raise NotImplementedError


class SinglePart(Part):
    """The table of a feature that a scene has once: its keys are the fields of the feature's class."""

    several = False
    default = None

    def __init__(self, feature: Feature):
        (kind,) = feature.kinds
        examples = [(kind, example) for example in feature.examples]
        words = {name for name, value in feature.examples[0].items() if isinstance(value, str)}

        class SingleTable(Table):
            @model_validator(mode="after")
            def _fits_together(self) -> "SingleTable":
                self.made()
                return self

            def made(self) -> Any:
                """The value."""
                return kind(**dict(self))

        fields: dict[str, Any] = {
            name: (
                Annotated[Any, as_in(*examples, numbers=name not in words), Field(description=meaning)],
                ... if name in feature.examples[0] else None,
            )
            for name, meaning in feature.keys.items()
        }
        table = pydantic.create_model(f"{kind.__name__}Table", __base__=SingleTable, **fields)
        table.__doc__ = f"A {kind.__name__}."
        self._feature = feature
        self.argument: str = feature.argument
        self.tables: Tables = (("", f"`[{feature.argument}]`", table),)
        self.annotation: Any = table | None
        self.description: str = feature.meaning

    def lines(self, scene: SceneLike, target: Path, files: Files) -> list[str]:
        """One table."""
        value = self._feature.of(scene)
        return [] if value is None else [f"[{self.argument}]", *pairs(vars(value)), ""]
