"""Converts values to plain JSON values, for the command line and tables."""

import json
import math
from typing import Any


def json_text(value: Any) -> str:
    """Plain values as JSON text; numbers that are not finite become null.

    >>> json_text({"error": float("nan"), "span": (0.0, 1.0)}).split()
    ['{', '"error":', 'null,', '"span":', '[', '0.0,', '1.0', ']', '}']
    """
    return json.dumps(_finite(value), indent=1, ensure_ascii=False, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _finite(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
