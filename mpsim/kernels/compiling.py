"""Compilation of kernels: their parts, their optional arguments, the cache of machine code, and turns of processes."""

import fcntl
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
from typing import Any, Literal, NamedTuple, Protocol

import llvmlite
import numba
from numba import _dynfunc, config, njit, types
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering
from numba.extending import register_jitable

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.machine import garbage_collection_paused

# --- The message while kernels are compiled, and the time that this takes
#
# Numba compiles a kernel silently, inside its first call with new types. A call of the compiler that the cache does
# not answer is timed here, and announced once it has taken `QUIET_FOR`. A separate thread announces it, because a
# listener (a log handler, for example) may wait for a lock that the compiling thread holds.

# pyright: reportAttributeAccessIssue=false
# Types of Numba have attributes that it declares nowhere.


logger = logging.getLogger("mpsim")

QUIET_FOR = 0.5
"""Seconds of compiling of which nothing is said: small kernels take less."""

PATIENCE = 1.0
"""Seconds to wait for an announcement that has begun: none that is well takes as long."""


class CompileCost(NamedTuple):
    """Seconds that compiling a kernel takes: of a bare scene, and more for each field of `Features` that it has."""

    what: str
    bare: float
    field: float = 0.0


LOOPS = "the loops for this scene"

COSTS = {
    "run_grid": CompileCost(LOOPS, 10.0, 1.3),
    "run_naive": CompileCost(LOOPS, 3.5, 0.7),
    "run_events": CompileCost(LOOPS, 3.0, 0.1),
}
"""By the kernel that Python calls: processor seconds with an empty cache, as measured on bare scenes and, for a field,
on named scenes (of the exact solver on one with friction), Intel Xeon, Python 3.11, numba 0.68."""


class Announcer(Protocol):
    """Tells people that something is being compiled."""

    def begin(self, text: str) -> None:
        """Say what is being compiled, and about how long it will take. Called by another thread."""
        ...

    def end(self) -> None:
        """Compilation has ended. Called only after `begin`."""
        ...


class LogLine:
    """One line in the log "mpsim": INFO, or WARNING if a person waits at a prompt or a terminal.

    So it is seen there without configuration, and a job without a terminal stays quiet.
    """

    def begin(self, text: str) -> None:
        """Log the text."""
        waited_for = hasattr(sys, "ps1") or (sys.stderr is not None and sys.stderr.isatty())
        logger.log(logging.WARNING if waited_for else logging.INFO, "mpsim: %s", text)

    def end(self) -> None:
        """Nothing more: reports tell how long it took."""


_announcer: Announcer | None = LogLine()

_lock = threading.Lock()
_spent = 0.0


def announce_by(announcer: Announcer | None) -> None:
    """Replace the announcer of this process; None: announce nothing."""
    global _announcer  # noqa: PLW0603 - one for the process, as is the compiler
    _announcer = announcer


@contextmanager
def announced_by(announcer: Announcer) -> Iterator[Announcer | None]:
    """`announce_by` for a block, which is given the announcer before."""
    before = _announcer
    announce_by(announcer)
    try:
        yield before
    finally:
        announce_by(before)


def compile_seconds() -> float:
    """Time that this process has spent on compiling kernels so far [s]."""
    return _spent


def announcement(kernel: str, signature: Any, kept: bool) -> str:
    """The text announced for the compilation of a kernel for such arguments; kept: whether its machine code is cached.

    >>> announcement("run_naive", (), True)
    'compiling the loops for this scene, once; about 4 s'
    """
    once = ", once" if kept else ""
    if kernel not in COSTS:
        return f"compiling a small kernel ({kernel}){once}"
    cost = COSTS[kernel]
    return f"compiling {cost.what}{once}; about {cost.bare + cost.field * _features_in(signature):.0f} s"


def _features_in(signature: Any) -> int:
    """How many fields of `Features` are present (not None) among the types of arguments."""
    records = (each for each in signature if isinstance(each, types.BaseNamedTuple))
    of_features = (each for each in records if each.instance_class.__name__.endswith("Features"))
    return sum(not isinstance(field, types.NoneType) for each in of_features for field in each.types)


class _Compilation(threading.local):
    """What this thread compiles: nesting depth of calls of the compiler, and the request of the outermost."""

    def __init__(self) -> None:
        self.depth = 0
        self.asked: tuple[str, Any, bool] = ("", (), False)
        self.started: float | None = None
        self.announcement: _Announcement | None = None


_mine = _Compilation()


class _Announcement:
    """An announcement that comes when compiling has taken QUIET_FOR."""

    def __init__(self, announcer: Announcer, text: str):
        self._announcer = announcer
        self._text = text
        self._begun = False
        self._timer = threading.Timer(QUIET_FOR, self._begin)
        self._timer.daemon = True
        self._timer.start()

    def _begin(self) -> None:
        self._begun = True
        self._announcer.begin(self._text)

    def end(self) -> None:
        """Compilation has ended."""
        self._timer.cancel()
        self._timer.join(PATIENCE)  # a process that forks next should not have this thread
        if self._begun:
            self._announcer.end()


@contextmanager
def asked_for(kernel: str, signature: Any, kept: bool) -> Iterator[None]:
    """Wraps each call of the compiler, for a kernel and the types of its arguments; such calls are nested."""
    global _spent  # noqa: PLW0603 - see compile_seconds
    if _mine.depth == 0:
        _mine.asked = kernel, signature, kept
    _mine.depth += 1
    try:
        yield
    finally:
        _mine.depth -= 1
        if _mine.depth == 0 and _mine.started is not None:
            with _lock:
                _spent += time.perf_counter() - _mine.started
            _mine.started = None
            if _mine.announcement is not None:
                _mine.announcement.end()
                _mine.announcement = None


def not_cached() -> None:
    """Called when a requested kernel is in no cache: from here on this thread compiles."""
    if _mine.started is None and _mine.depth:
        _mine.started = time.perf_counter()
        if _announcer is not None:
            with suppress(RuntimeError):  # the system allows no more threads
                _mine.announcement = _Announcement(_announcer, announcement(*_mine.asked))


# --- If several processes need the same kernel, one compiles it; the others wait and load the result
#
# Otherwise ranks and runs that start together would each compile it, on cores that the others need. The system's lock
# (`flock`) ends with its process. A fork may keep it longer, so no process waits longer than LONGEST.

LONGEST = 60.0
"""Seconds to wait for another process; then a kernel is compiled twice, which does no harm."""

STEP = 0.02
"""Seconds between two looks at the lock."""


class Turns:
    """Turns of compiling one function, for each signature of its own.

    Args:
        folder: of the cache; the lock files lie in it.
        name: of the function, unique.
    """

    def __init__(self, folder: Path, name: str):
        self._stem = folder / f"{hashlib.sha256(name.encode()).hexdigest()[:16]}"
        self._held: dict[str, int] = {}

    def load_or_take(self, signature: Any, load: Callable[[], Any]) -> Any:
        """What `load` finds in the cache, perhaps from another process; None: compile it, then `give_back`."""
        key = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
        path = self._stem.with_name(f"{self._stem.name}-{key}.lock")
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:  # a read-only cache
            return None
        if not _locked(descriptor):
            os.close(descriptor)
            return None
        found = load()
        if found is None:
            self._held[key] = descriptor
        else:
            os.close(descriptor)
        return found

    def give_back(self) -> None:
        """Release the lock: the function is compiled, or could not be."""
        while self._held:
            _, descriptor = self._held.popitem()
            with suppress(OSError):
                os.close(descriptor)


def _locked(descriptor: int) -> bool:
    """Wait for the lock, at most LONGEST; False: it could not be taken."""
    end = time.monotonic() + LONGEST
    while time.monotonic() < end:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(STEP)
        except OSError:  # a file system without locks
            return False
        else:
            return True
    return False


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

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false
# The state of a compilation has attributes that Numba declares nowhere.


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


# --- Compilation of kernels, and the cache of their machine code
#
# Numba's own cache looks only at the file in which a function stands: after an edit in a second file, a cached caller
# continues to run the old callee. The kernels here call each other across files, so their machine code lies in a
# folder whose name is a digest of *all* kernel sources and of the versions that compiled them. Any edit or upgrade is
# therefore a different folder, and a stale cache cannot be loaded.

# pyright: reportAttributeAccessIssue=false
# Numba fills its config module when it is imported.


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


def cache_root() -> Path:
    """Folder in which mpsim keeps its machine code: NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache."""
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR) / "mpsim"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mpsim"


def _writable_cache_folder() -> Path | None:
    """This version's cache folder, or None (with one log line) if nothing can be written."""
    try:
        folder = cache_root() / source_digest()
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


def _cached(dispatcher: Any) -> Any:
    """Keep the machine code of a function in mpsim's own cache folder."""
    if JIT_DISABLED:
        return dispatcher
    turns = (
        None
        if _FOLDER is None
        else Turns(_FOLDER, f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}")
    )
    _watch_compiling(dispatcher, turns)
    _type_without_literals(dispatcher)
    if _FOLDER is not None:
        # Numba reads this setting only while a function's cache is set up, so other users' functions keep theirs.
        users_folder, config.CACHE_DIR = config.CACHE_DIR, str(_FOLDER)
        try:
            dispatcher.enable_caching()
        finally:
            config.CACHE_DIR = users_folder
    _watch_loading(dispatcher._cache, turns)
    return dispatcher


def _watch_compiling(dispatcher: Any, turns: Turns | None) -> None:
    """Make Ctrl-C wait for the end of a compilation or load, whose callbacks from LLVM cannot pass an exception on.

    Also announce and time it, if it is a compilation.
    """
    compile_signature, name = dispatcher.compile, dispatcher.py_func.__name__

    def compile_undisturbed(signature: Any) -> Any:
        noted = asked_for(name, signature, _FOLDER is not None)
        with interrupts_held_back(), noted, garbage_collection_paused():
            try:
                return compile_signature(signature)
            except FileNotFoundError:
                try:
                    os.getcwd()
                except FileNotFoundError as error:
                    why = "compiling needs the current folder, which has been removed; start in one that exists"
                    raise FileNotFoundError(error.errno, why) from error
                raise
            finally:
                if turns is not None:
                    turns.give_back()

    dispatcher.compile = compile_undisturbed


def _type_without_literals(dispatcher: Any) -> None:
    """Compile a kernel once for all constants that its callers pass, not once for each, as Numba would."""
    call_template = dispatcher.get_call_template

    def call_template_without_literals(args: Any, kws: Any) -> Any:
        unliteral = {name: types.unliteral(each) for name, each in kws.items()}
        return call_template(tuple(types.unliteral(each) for each in args), unliteral)

    dispatcher.get_call_template = call_template_without_literals


def _watch_loading(cache: Any, turns: Turns | None) -> None:
    """If a cache file is damaged (by a killed process) or cannot be written (a full disk), do without it.

    Also notice what is not in the cache and will be compiled, by this process or another.
    """
    load, save = cache.load_overload, cache.save_overload

    def load_undamaged(signature: Any, target_context: Any) -> Any:
        try:
            return load(signature, target_context)
        except Exception as error:  # whatever a damaged pickle may raise
            logger.warning("mpsim: a file of the kernel cache is damaged (%r); that kernel is compiled anew.", error)
            with suppress(OSError):
                cache.flush()
            return None

    def save_if_possible(signature: Any, result: Any) -> None:
        try:
            save(signature, result)
        except OSError as error:
            logger.warning(
                "mpsim: a file of the kernel cache cannot be written (%s); that kernel is compiled anew in every "
                "process. Make room, or set NUMBA_CACHE_DIR to another folder.",
                error,
            )

    def load_or_recompile(signature: Any, target_context: Any) -> Any:
        found = load_undamaged(signature, target_context)
        if found is None:
            not_cached()
            if turns is not None:
                found = turns.load_or_take(signature, lambda: load_undamaged(signature, target_context))
        return found

    cache.load_overload, cache.save_overload = load_or_recompile, save_if_possible


def compiled(function: Callable[..., Any]) -> Any:
    """Numba-compile a `function` that Python calls, at its first call, keeping the machine code between runs."""
    return _cached(njit(pipeline_class=KernelCompiler, **_OPTIONS)(function))


def linked(function: Callable[..., Any]) -> Any:
    """Numba-compile a `function` as a part of each kernel that calls it; called from Python, it stays plain Python."""
    return register_jitable(pipeline_class=PartCompiler, **_OPTIONS)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """`linked`, and always inlined: for the work that a kernel does for each disc or contact.

    A call passes every field of every array (some 60 words for a disc record), which costs more than the work of a
    contact; the compiler's own judgement of what to inline changes with every edit.
    """
    return register_jitable(forceinline=True, pipeline_class=PartCompiler, **_OPTIONS)(function)


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
