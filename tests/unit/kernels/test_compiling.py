"""A kernel is compiled once for arguments that differ in nothing but a constant."""

from numba.core.caching import NullCache

from mpsim.kernels.compiling import JIT_DISABLED, compiled


@compiled
def plus_one(x):
    return x + 1


@compiled
def of_constants(x):
    return plus_one(1) + plus_one(2) + plus_one(x)


@compiled
def of_another_type(x):
    return plus_one(x) + plus_one(0.5)


if not JIT_DISABLED:
    for kernel in (of_constants, of_another_type):
        kernel._cache = NullCache()  # what is loaded compiles nothing that it calls


def test_constants_of_callers_make_no_kernel_of_their_own():
    assert of_constants(3) == 9
    assert JIT_DISABLED or [str(*signature) for signature in plus_one.signatures] == ["int64"]
    assert of_another_type(1) == 3.5
    assert JIT_DISABLED or {str(*signature) for signature in plus_one.signatures} == {"int64", "float64"}
