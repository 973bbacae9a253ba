"""Merges functions into one kernel; functions that only kernels call get no machine code of their own.

Numba optimises each function together with all that it calls, and makes machine code of the whole. With ten levels of
calls, the innermost function is optimised ten times and nine results are discarded: this was half the time of a first
compilation. Here a part stays as it was lowered; a kernel, which Python calls, is linked with all parts that it
reaches, each once, and optimised once.

    run_grid (a kernel)          step, merge_up_to, resolve_contact ... (parts)
    typed, lowered               typed, lowered
    linked with its parts   <--  kept
    optimised, machine code
"""

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false
# The state of a compilation has attributes that Numba declares nowhere.

from typing import Any, Literal

from numba import _dynfunc
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _Part(JITCodeLibrary):
    """The code of one function as it was lowered: neither linked with what it calls, nor optimised as a whole."""

    def finalize(self) -> None:
        """Numba asks for this before it links the code with that of a caller."""
        self._finalized = True


class _Kernel(JITCodeLibrary):
    """The code of a function that Python calls."""

    def finalize(self) -> None:
        """Link with all parts, not only with those that are called directly; optimise; make machine code."""
        self._linking_libraries = _callers_first(self)
        super().finalize()

    def _verify_declare_only_symbols(self) -> None:
        """Numba looks only for its own functions; a call of an unlinked one would end the process."""
        super()._verify_declare_only_symbols()
        missing = [each.name for each in self._final_module.functions if each.is_declaration and each.name[:3] == "_ZN"]
        assert not missing, f"not linked: {missing}"


def _callers_first(kernel: _Kernel) -> list[CodeLibrary]:
    """What a kernel is linked with, callers first: LLVM leaves out what nothing needs yet."""
    callees_first: dict[CodeLibrary, None] = {}

    def visit(library: CodeLibrary) -> None:
        if library not in callees_first:
            for callee in library._linking_libraries if isinstance(library, _Part) else ():
                visit(callee)
            callees_first[library] = None

    for callee in kernel._linking_libraries:
        visit(callee)
    return list(reversed(callees_first))


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerKernel(NativeLowering):
    """Lower a function, link it with its parts, and make machine code."""

    _name = "mpsim_lower_kernel"

    def run_pass(self, state: Any) -> Literal[True]:
        """As Numba's, for a library of our own."""
        state.library = _Kernel(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerPart(NativeLowering):
    """Lower a function for its callers alone."""

    _name = "mpsim_lower_part"

    def run_pass(self, state: Any) -> Literal[True]:
        """As Numba's, up to the generation of machine code."""
        part = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library = part
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        described = lowered.fndesc
        # Numba knows the function by this object, whose address 0 is never called.
        key = _dynfunc.make_function(described.lookup_module(), described.qualname, "", 0, lowered.env, (part,))
        state.targetctx.insert_user_function(key, described, [part])
        state["cr"] = lowered._replace(cfunc=key)
        return True


class _Compiler(CompilerBase):
    """Numba's passes for nopython mode, except the last."""

    lowering: type[NativeLowering]

    def define_pipelines(self) -> list[Any]:
        """The one pipeline."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(self.lowering if each is NativeLowering else each, why) for each, why in passes.passes]
        passes.finalize()
        return [passes]


class KernelCompiler(_Compiler):
    """For functions that Python calls."""

    lowering = _LowerKernel


class PartCompiler(_Compiler):
    """For functions that only kernels call."""

    lowering = _LowerPart
