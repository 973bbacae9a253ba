"""Optional arguments of kernels: None stands for a feature that a scene does not have.

Numba compiles a function anew for a None argument and drops what is tested against it, if the test is of one argument
alone: not of an attribute, nor of several at once. So each accessor returns the value itself, a constant, or None, and
a second condition stands in a separate `if` inside the test against None (ruff's SIM102 would join the two).
"""

from mpsim.kernels.compiling import inlined


@inlined
def value_or(values, i, shared):
    """A disc's own radius or mass, or the common value if all discs have the same."""
    if values is None:
        return shared
    return values[i]


@inlined
def slice_of(values, low, high):
    """A slice of an array, or None."""
    if values is None:
        return None
    return values[low:high]


@inlined
def present(value):
    """True for an array, else None, so that code tested against it can be dropped."""
    if value is None:
        return None
    return True


@inlined
def any_present(value, other):
    """True if at least one of two is present, else None."""
    if value is None:
        return present(other)
    return True


@inlined
def swap_entries(values, i, j):
    """Exchange the values of two discs, if discs have such values, shape (N,)."""
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
    """Copy a disc's own value to another array, if discs have such values, shape (N,)."""
    if source is not None:
        target[j] = source[i]


@inlined
def copy_row(source, i, target, j):
    """The same, shape (N, components)."""
    if source is not None:
        for k in range(source.shape[1]):
            target[j, k] = source[i, k]
