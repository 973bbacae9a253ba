"""Distributions that samples are compared with, and how far they are from them."""

import math

import numpy as np


def distance(values, distribution):
    """Kolmogorov-Smirnov: the largest difference of two cumulative distributions, times the root of the number."""
    ordered = np.sort(values)
    steps, expected = np.arange(len(ordered) + 1) / len(ordered), np.array([*map(distribution, ordered)])
    return math.sqrt(len(ordered)) * max((steps[1:] - expected).max(), (expected - steps[:-1]).max())


def normal(value):
    return 0.5 * (1 + math.erf(value / math.sqrt(2)))
