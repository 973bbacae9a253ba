"""Functions that only kernels call are parts of those: linked whatever calls them, and optimised nowhere else."""

import pytest
from numba.core.codegen import JITCodeLibrary

from mpsim.kernels import compiling, linking
from mpsim.kernels.compiling import JIT_DISABLED, compiled, inlined, linked

needs_compiler = pytest.mark.skipif(JIT_DISABLED, reason="nothing is compiled")


@linked
def smaller(x, y):
    return min(x, y)


@inlined
def half_of_smaller(x, y):
    return smaller(x, y) / 2.0


@pytest.fixture
def kernel(monkeypatch):
    """A kernel that has yet to be compiled; what it calls in vain is needed by what it calls later."""
    monkeypatch.setattr(compiling, "_FOLDER", None)

    @compiled
    def kernel(x):
        never = 0
        if never:
            x = smaller(x, 1.0)
        return half_of_smaller(x, 5.0)

    return kernel


def test_parts_are_plain_functions_in_python():
    assert smaller(3, 4) == 3
    assert half_of_smaller(8.0, 6.0) == 3.0


def test_a_kernel_is_linked_with_all_that_it_reaches(kernel):
    assert kernel(4.0) == 2.0
    assert kernel(7.0) == 2.5


@needs_compiler
def test_a_callee_before_its_caller_is_not_linked(kernel, monkeypatch):
    """The control: what the order is for."""
    callers_first = linking._callers_first
    monkeypatch.setattr(linking, "_callers_first", lambda kernel: callers_first(kernel)[::-1])
    with pytest.raises(AssertionError, match="not linked"):
        kernel(4.0)


@needs_compiler
def test_only_the_kernel_becomes_machine_code(kernel, monkeypatch):
    optimised = []
    optimise = JITCodeLibrary._optimize_final_module
    monkeypatch.setattr(
        JITCodeLibrary, "_optimize_final_module", lambda self: (optimised.append(self.name), optimise(self))
    )
    assert kernel(4.0) == 2.0
    assert any(name.endswith("kernel") for name in optimised)
    assert not {"smaller", "half_of_smaller"} & set(optimised)
