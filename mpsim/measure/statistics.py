from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Measure:
    value: float
    error: float
    samples: int


def block_average(series):
    s = np.asarray(series, float)
    b = np.array([x.mean() for x in np.array_split(s, 32)]) if len(s) >= 32 else s
    return Measure(float(s.mean()), float(b.std(ddof=1) / np.sqrt(len(b))), len(s))
