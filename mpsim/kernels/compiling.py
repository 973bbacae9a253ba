"""Compilation of kernels, and the cache of their machine code.

Numba's own cache looks only at the file in which a function stands: after an edit in a second file, a cached
caller continues to run the old callee. The kernels here call each other across files, so their machine code lies
in a folder whose name is a digest of *all* kernel sources and of the versions that compiled them. Any edit or
upgrade is therefore a different folder, and a stale cache cannot be loaded.
"""

# pyright: reportAttributeAccessIssue=false
# Numba fills its config module when it is imported.

import hashlib
import logging
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba import config, njit, types
from numba.extending import register_jitable

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.garbage import garbage_collection_paused
from mpsim.kernels import compile_notice
from mpsim.kernels.compile_turns import Turns
from mpsim.kernels.linking import KernelCompiler, PartCompiler

logger = logging.getLogger("mpsim")

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
        noted = compile_notice.asked_for(name, signature, _FOLDER is not None)
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
            compile_notice.not_cached()
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
