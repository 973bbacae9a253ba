"""Optional arguments of kernels: None stands for a feature that a scene does not have.

Numba compiles a function anew for a None argument and drops what is tested against it, if the test is of one argument
alone: not of an attribute, nor of several at once. So each accessor is the value itself, a constant, or nothing at all,
and a second condition stands in an `if` of its own inside the test against None (ruff's SIM102 would join the two).
"""

from mpsim.kernels.compiling import inlined


@inlined
def value_or(values, i, shared):
    """A disc's own radius or mass, or what stands for it where all discs have the same."""
    if values is None:
        return shared
    return values[i]


@inlined
def slice_of(values, low, high):
    """A slice, where there is something to slice."""
    if values is None:
        return None
    return values[low:high]


@inlined
def present(value):
    """True where there is something, else None, so that what is tested against it can be dropped."""
    if value is None:
        return None
    return True


@inlined
def any_present(value, other):
    """`present` of one of two, or of both."""
    if value is None:
        return present(other)
    return True


@inlined
def swap_entries(values, i, j):
    """Two discs change places, where discs have such values, shape (N,)."""
    if values is not None:
        values[i], values[j] = values[j], values[i]


@inlined
def swap_rows(values, i, j):
    """The same, shape (N, components)."""
    if values is not None:
        for k in range(values.shape[1]):
            values[i, k], values[j, k] = values[j, k], values[i, k]


@inlined
def copy_entry(source, i, target, j):
    """A disc's own value goes to another array, where discs have such values, shape (N,)."""
    if source is not None:
        target[j] = source[i]


@inlined
def copy_row(source, i, target, j):
    """The same, shape (N, components)."""
    if source is not None:
        for k in range(source.shape[1]):
            target[j, k] = source[i, k]
