"""Values and numbers with errors as text."""

import json
import math
from typing import Any

# --- Numbers as text with as many digits as their errors allow

RELATIVE_ROUNDING = 1e-12  # relative fluctuations below this are rounding


def with_error(value: float, error: float, mark: str = "") -> str:
    """A value with its standard error in brackets, in units of the last digit: 2.2399(16) is 2.2399 with 0.0016.

    The error has two digits, or all before its point if it is 1 or larger. Where it is rounding, it is printed as 0.

    Args:
        value, error: of any unit; an error of NaN is unknown, and printed as (?).
        mark: before the error: "<" where it is an upper bound, ">" where it is a lower one.

    >>> with_error(2.23991, 0.00163), with_error(12345.6, 142.0), with_error(-0.0192, 0.0006), with_error(15, 1.5)
    ('2.2399(16)', '12346(142)', '-0.01920(60)', '15.0(1.5)')
    >>> with_error(0.3, math.nan), with_error(2.24, 0.016, ">"), with_error(3.5843e-10, 6.8e-13)
    ('0.3(?)', '2.240(>16)', '3.5843(68)e-10')
    >>> with_error(100 + 3e-14, 2.8e-14), with_error(0.0, 0.0)
    ('100(0)', '0(0)')
    """
    if not (math.isfinite(value) and math.isfinite(error)):
        return f"{value:.6g}(?)" if math.isnan(error) else f"{value:.6g}({mark}{error:.2g})"
    if error <= RELATIVE_ROUNDING * abs(value):
        return f"{value:.12g}({mark}0)"
    if value == 0 and mark:
        return f"0({mark}{error:.2g})"
    power = math.floor(math.log10(max(abs(value), error)))
    power = power if not -4 <= power < 7 else 0
    value, error = value / 10.0**power, error / 10.0**power
    decimals = max(1 - int(f"{error:.1e}".split("e")[1]), 0)
    rounded = f"{error:.{decimals}f}"
    digits = rounded if float(rounded) >= 1 else rounded.replace("0.", "", 1).lstrip("0")
    text = f"{value:.{decimals}f}({mark}{digits})"
    return text if power == 0 else f"{text}e{power:+03d}"


# --- Converts values to plain JSON values, for the command line and tables


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
