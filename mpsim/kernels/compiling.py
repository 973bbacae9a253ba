"""Compilation of kernels: their parts, their optional arguments, and the cache of machine code."""

import fcntl
import functools
import hashlib
import logging
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import llvmlite
import numba
from numba import _dynfunc, config, njit, typeof, types
from numba._dispatcher import compute_fingerprint
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering
from numba.extending import register_jitable

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.machine import garbage_collection_paused

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false
# Types of Numba, the state of a compilation and Numba's config have attributes that it declares nowhere.

logger = logging.getLogger("mpsim")

# --- The message while kernels are compiled, and the time that this takes
#
# Numba compiles a kernel silently, inside its first call with new types. A call of the compiler that the cache does
# not answer is timed here; the kernels that take long are announced.

LOOPS = {"run_grid": 10, "run_naive": 4, "run_events": 3}
"""The kernels that Python calls for the frames of a scene: seconds of compiling for a bare one (Xeon, Numba 0.68)."""


Tell = Callable[[str | None], None]
"""Takes what is being compiled, and None at the end of it. Called by any thread; must return at once."""

_listeners: list[Tell] = []

_lock = threading.Lock()
_spent = 0.0


@contextmanager
def announcing(tell: Tell) -> Iterator[None]:
    """Tell a listener, and not the log, what this process compiles in a block."""
    _listeners.append(tell)
    try:
        yield
    finally:
        _listeners.remove(tell)


def _announce(text: str | None) -> None:
    """Tell all listeners. If there is none: a line in the log "mpsim", INFO, or WARNING if a person waits.

    So it is seen at a prompt or a terminal without configuration, and a job without a terminal stays quiet.
    """
    for tell in _listeners.copy():
        tell(text)
    if text is not None and not _listeners:
        waited_for = hasattr(sys, "ps1") or (sys.stderr is not None and sys.stderr.isatty())
        logger.log(logging.WARNING if waited_for else logging.INFO, "mpsim: %s", text)


def compile_seconds() -> float:
    """Time that this process has spent on compiling kernels so far [s]."""
    return _spent


def running_seconds() -> float:
    """Processor time of this thread so far, except for compiling kernels [s]."""
    return time.thread_time() - _mine.spent


class _Compilation(threading.local):
    """What this thread compiles: the kernel that Python has called, and since when it is not loaded."""

    kernel: str = ""
    started: float | None = None
    announced: bool = False
    spent: float = 0.0  # processor time of all its compilations [s]


_mine = _Compilation()


@contextmanager
def _compiling(kernel: str) -> Iterator[None]:
    """Time and announce a call of the compiler, if `_not_cached` is called inside; such calls are nested."""
    global _spent  # noqa: PLW0603 - see compile_seconds
    if _mine.kernel:
        yield
        return
    _mine.kernel, began = kernel, time.thread_time()
    try:
        yield
    finally:
        started, announced = _mine.started, _mine.announced
        _mine.kernel, _mine.started, _mine.announced = "", None, False
        if started is not None:
            with _lock:
                _spent += time.perf_counter() - started
            _mine.spent += time.thread_time() - began
        if announced:
            _announce(None)


def _not_cached() -> None:
    """Note that a requested kernel is in no cache: from here on this thread compiles."""
    if _mine.started is None and _mine.kernel:
        _mine.started = time.perf_counter()
        if _mine.kernel in LOOPS:
            once, _mine.announced = ", once" * (_FOLDER is not None), True
            _announce(f"compiling the loops for this scene{once}; about {LOOPS[_mine.kernel]} s or more")


# --- Merges functions into one kernel; functions that only kernels call get no machine code of their own
#
# Numba optimises each function together with all that it calls, and makes machine code of the whole. With ten levels
# of calls, the innermost function is optimised ten times and nine results are discarded: this was half the time of a
# first compilation. Here a part stays as it was lowered; a kernel, which Python calls, is linked with all parts that
# it reaches, each once, and optimised once.
#
#     run_grid (a kernel)          step, merge_up_to, resolve_contact ... (parts)
#     typed, lowered               typed, lowered
#     linked with its parts   <--  kept
#     optimised, machine code


class _Part(JITCodeLibrary):
    """The code of one function as it was lowered: neither linked with what it calls, nor optimised as a whole."""

    def finalize(self) -> None:
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


# --- Compilation of kernels, and the cache of their machine code
#
# Numba's own cache looks only at the file in which a function stands: after an edit in a second file, a cached caller
# continues to run the old callee. The kernels here call each other across files, so their machine code lies in a
# folder whose name is a digest of *all* kernel sources and of the versions that compiled them. Any edit or upgrade is
# therefore a different folder, and a stale cache cannot be loaded.

JIT_DISABLED: bool = bool(config.DISABLE_JIT)
"""True under NUMBA_DISABLE_JIT=1: kernels then run as plain Python (slow, bounds-checked, one process)."""


def source_digest() -> str:
    """Digest of every kernel source and of the compiler's versions (16 hex digits)."""
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    folder = Path(__file__).parent
    archive = [each for each in folder.parents if each.is_file()]  # if mpsim is imported from one
    for path in archive or sorted(folder.rglob("*.py")):
        digest.update(os.path.relpath(path, folder).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _writable_cache_folder() -> Path | None:
    """This version's folder in NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache; None (with one log line) if read-only."""
    try:
        root = config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(root) / "mpsim" / source_digest()
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError) as error:
        logger.warning(
            "mpsim: no writable cache folder (%s); kernels are compiled anew in every process. "
            "Set NUMBA_CACHE_DIR to a writable folder to keep them.",
            error,
        )
        return None
    return folder


_FOLDER = None if JIT_DISABLED else _writable_cache_folder()


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}
"""nogil: a thread that watches the other processes must be able to run during a long kernel. No fastmath (it would
reorder sums, fuse multiply-adds and void every NaN test) and no parallel=True. Without reference counts, which a kernel
that allocates nothing does not need: counting them for each array taken out of a tuple can cost more than the physics
(measured: an event of the exact solver 1,150 ns with, 500 ns without; a contact of the stepped one 45 ns). Without the
wrapper that would make each a first-class function, which none is used as."""


LONGEST = 60.0
"""Seconds to wait for another process; then a kernel is compiled twice, which does no harm."""

STEP = 0.02
"""Seconds between two looks at the lock."""


def _take_turn(folder: Path, name: str) -> int:
    """A descriptor that locks the compilation of one function; -1 if the lock cannot be had.

    Ranks and runs that start together would otherwise each compile a kernel, on cores and in memory that the others
    need. The system's lock ends with its process; a fork may keep it longer, so no process waits longer than LONGEST.
    """
    end = time.monotonic() + LONGEST
    try:
        descriptor = os.open(folder / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError:  # a read-only cache
        return -1
    while time.monotonic() < end:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(STEP)
        except OSError:  # a file system without locks
            break
        else:
            return descriptor
    os.close(descriptor)
    return -1


def _type_without_literals(dispatcher: Any) -> None:
    """Compile a kernel once for all constants that its callers pass, not once for each, as Numba would."""
    call_template = dispatcher.get_call_template

    def call_template_without_literals(args: Any, kws: Any) -> Any:
        unliteral = {name: types.unliteral(each) for name, each in kws.items()}
        return call_template(tuple(types.unliteral(each) for each in args), unliteral)

    dispatcher.get_call_template = call_template_without_literals


def _watch(dispatcher: Any) -> None:
    """Make Ctrl-C wait for the end of a compilation or load, whose callbacks from LLVM cannot pass an exception on.

    Also announce and time compilations, let one process compile for all, and do without cache files that are damaged
    (by a killed process) or cannot be written (on a full disk).
    """
    function, cache = dispatcher.py_func, dispatcher._cache
    compile_signature, load, save = dispatcher.compile, cache.load_overload, cache.save_overload
    turns: list[int] = []

    def compile_undisturbed(signature: Any) -> Any:
        with interrupts_held_back(), _compiling(function.__name__), garbage_collection_paused():
            try:
                return compile_signature(signature)
            finally:
                while turns:
                    os.close(turns.pop())

    def load_undamaged(signature: Any, target_context: Any) -> Any:
        try:
            return load(signature, target_context)
        except Exception as error:  # whatever a damaged pickle may raise
            logger.warning("mpsim: a file of the kernel cache is damaged (%r); that kernel is compiled anew.", error)
            with suppress(OSError):
                cache.flush()
            return None

    def load_or_take_turn(signature: Any, target_context: Any) -> Any:
        found = load_undamaged(signature, target_context)
        if found is None:
            _not_cached()
            turn = -1 if _FOLDER is None else _take_turn(_FOLDER, f"{function.__module__}.{function.__qualname__}")
            if turn >= 0:
                turns.append(turn)
                found = load_undamaged(signature, target_context)  # which another process may have compiled meanwhile
        return found

    def save_if_possible(signature: Any, result: Any) -> None:
        try:
            save(signature, result)
        except OSError as error:
            logger.warning(
                "mpsim: a file of the kernel cache cannot be written (%s); that kernel is compiled anew in every "
                "process. Make room, or set NUMBA_CACHE_DIR to another folder.",
                error,
            )

    dispatcher.compile = compile_undisturbed
    cache.load_overload, cache.save_overload = load_or_take_turn, save_if_possible


def compiled(function: Callable[..., Any]) -> Any:
    """Numba-compile a `function` that Python calls, at its first call, keeping the machine code between runs."""
    dispatcher: Any = njit(pipeline_class=KernelCompiler, **_OPTIONS)(function)
    if JIT_DISABLED:
        return dispatcher
    _type_without_literals(dispatcher)
    if _FOLDER is not None:
        # Numba reads this setting only while a function's cache is set up, so other users' functions keep theirs.
        users_folder, config.CACHE_DIR = config.CACHE_DIR, str(_FOLDER)
        try:
            dispatcher.enable_caching()
        finally:
            config.CACHE_DIR = users_folder
    _watch(dispatcher)
    return dispatcher


def linked(function: Callable[..., Any]) -> Any:
    """Numba-compile a `function` as a part of each kernel that calls it; called from Python, it stays plain Python."""
    return register_jitable(pipeline_class=PartCompiler, **_OPTIONS)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """`linked`, and always inlined: for the work that a kernel does for each disc or contact.

    A call passes every field of every array (some 60 words for a disc record), which costs more than the work of a
    contact; the compiler's own judgement of what to inline changes with every edit.
    """
    return register_jitable(forceinline=True, pipeline_class=PartCompiler, **_OPTIONS)(function)


def entry_of(kernel: Any, *arguments: Any) -> Callable[..., Any]:
    """The machine code of a kernel for arguments of these types, which looks up none; others may end the process."""
    if JIT_DISABLED:
        return kernel
    key = kernel, compute_fingerprint(arguments)  # of their types, in microseconds, where `typeof` takes a millisecond
    if (known := _entries.get(key)) is None:
        known = _entries[key] = kernel.compile(tuple(map(typeof, arguments)))
    return known


_entries: dict[tuple[Any, bytes], Callable[..., Any]] = {}


def bound(kernel: Any, *arguments: Any) -> Callable[[], Any]:
    """`entry_of` a kernel with its arguments, which it keeps."""
    return functools.partial(entry_of(kernel, *arguments), *arguments)


def compiled_kernels() -> int:
    """Number of kernel signatures compiled or loaded in this process so far."""
    modules = [m for name, m in sys.modules.items() if name.startswith("mpsim.kernels.")]
    functions = {f for m in modules for f in vars(m).values() if hasattr(f, "signatures")}
    return sum(len(function.signatures) for function in functions)


# --- Optional arguments of kernels: None stands for a feature that a scene does not have
#
# Numba compiles a function anew for a None argument and drops what is tested against it, if the test is of one
# argument alone: not of an attribute, nor of several at once. So each accessor returns the value itself, a constant,
# or None, and a second condition stands in a separate `if` inside the test against None (ruff's SIM102 would join the
# two).


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
def any_present(value, other):
    """True if at least one of two is present, else None, so that code tested against it can be dropped."""
    if value is not None:
        return True
    if other is not None:
        return True
    return None


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
