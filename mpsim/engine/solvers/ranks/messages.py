"""Messages between ranks. All ranks make the same calls in the same order. Only this module imports `mpi4py`."""

import contextlib
import hashlib
import importlib
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.engine.solvers.base import Ranks
from mpsim.errors import BusyError, InputError

Result = TypeVar("Result")

NOT_FINITE, LOST = 1, 2


class Agreement(NamedTuple):
    """What all ranks know of a step once its discs have moved.

    Attributes:
        trouble: the worst on any rank: 0, none; NOT_FINITE, a disc is not finite; LOST, it cannot go on.
        farthest: ranks that a disc goes on at most; 0: none goes to another.
        frames: after so many the command ends: the fewest that any rank wants.
        discs: of the rank that has the most.
    """

    trouble: int
    farthest: int
    frames: int
    discs: int


def library() -> Any:
    """The module mpi4py.MPI, which starts MPI when it is first imported.

    Raises:
        InputError: if it cannot be imported, or finds no MPI library.
    """
    try:
        return importlib.import_module("mpi4py.MPI")
    except (ImportError, RuntimeError) as error:
        raise InputError(
            f"method='mpi' needs the package mpi4py and an MPI library, which cannot be loaded ({error}). Install both "
            "by `pip install 'mpsim[mpi]' mpich`, or use method='parallel' on one machine."
        ) from None


def ranks_of(comm: Any) -> int:
    """Number of ranks of a communicator of mpi4py; None: of all that were started.

    Raises:
        InputError: if it is no communicator, or there is no MPI.
    """
    mpi = library()
    if comm is not None and (not isinstance(comm, mpi.Intracomm) or comm == mpi.COMM_NULL):
        raise InputError(
            f"comm must be a communicator of mpi4py, such as MPI.COMM_WORLD; got {comm!r}. Give that, for all ranks."
        )
    return (mpi.COMM_WORLD if comm is None else comm).size


@contextlib.contextmanager
def collective(comm: Any) -> Iterator[None]:
    """A block in which what one rank raises, all raise: before there is a solver that they share.

    Raises:
        InputError: as `ranks_of`.
    """
    with contextlib.closing(MpiRanks(comm)) as ranks, ranks.collective():
        yield


class MpiRanks(Ranks):
    """The ranks of a communicator, by a duplicate of it, so that no message of the caller's is taken.

    Args:
        comm: of mpi4py; None: all ranks.

    Attributes:
        rank: number of this one.
        size: number of them.
        answer: the answer of this rank to a question that the first one asks while it acts.
        acting: whether this is the first rank, and the others wait for what it asks.

    Raises:
        InputError: as `ranks_of`.
    """

    def __init__(self, comm: Any = None):
        ranks_of(comm)
        self._mpi = library()
        self._comm: Any = (self._mpi.COMM_WORLD if comm is None else comm).Dup()
        self.rank: int = self._comm.rank
        self.size: int = self._comm.size
        self.is_root: bool = self.rank == 0
        self.acting: bool = False
        self.answer: Callable[[Any], Any] = lambda question: None
        self._creator = os.getpid()
        self._told, self._heard = np.zeros(4, np.int64), np.zeros(4, np.int64)

    def close(self) -> None:
        if self._creator != os.getpid():  # in a fork, where MPI may not be called
            return
        if self._comm != self._mpi.COMM_NULL and not self._mpi.Is_finalized():
            self._comm.Free()

    # --- in each step

    def agree(self, trouble: int, farthest: int, frames: int, discs: int = 0) -> Agreement:
        """What all ranks are to know, from what each of them knows."""
        self._told[:] = trouble, farthest, -frames, discs
        self._comm.Allreduce(self._told, self._heard, op=self._mpi.MAX)
        return Agreement(int(self._heard[0]), int(self._heard[1]), -int(self._heard[2]), int(self._heard[3]))

    def exchange(self, parts: Sequence[tuple[int, int, NDArray[Any]]]) -> list[NDArray[Any]]:
        """Give each of some ranks an array of records, and take what they give, which call this too.

        Args:
            parts: rank, the tag of what is exchanged with it, and what it is given; of each rank and tag one.
        """
        comm, byte, status = self._comm, self._mpi.BYTE, self._mpi.Status()
        requests = [comm.Isend([part.view(np.uint8), byte], dest=other, tag=tag) for other, tag, part in parts]
        arrived: list[NDArray[Any]] = []
        for other, tag, part in parts:
            comm.Probe(source=other, tag=tag, status=status)
            found = np.empty(status.Get_count(byte) // part.itemsize, part.dtype)
            comm.Recv([found.view(np.uint8), byte], source=other, tag=tag)
            arrived.append(found)
        self._mpi.Request.Waitall(requests)
        return arrived

    def distance(self, target: NDArray[np.int64]) -> int:
        """Ranks that records go on at most, the last and the first side by side; target: rank of each, shape (K,)."""
        apart = np.abs(target - self.rank)
        return int(np.minimum(apart, self.size - apart).max(initial=0))

    def deal(self, records: NDArray[Any], target: NDArray[np.int64], farthest: int) -> NDArray[Any]:
        """Send each record to its rank; returns those for this one.

        Args:
            records: shape (K,), none for this rank unless farthest > 1.
            target: rank of each, shape (K,).
            farthest: the largest `distance` of all ranks.
        """
        if farthest > 1:
            return np.concatenate(self._comm.alltoall([records[target == other] for other in range(self.size)]))
        beside = sorted({(self.rank - 1) % self.size, (self.rank + 1) % self.size} - {self.rank})
        parts = [(other, 0, records[target == other]) for other in beside]
        return np.concatenate([records[:0], *self.exchange(parts)])

    # --- seldom

    def all_of(self, value: Any) -> list[Any]:
        return self._comm.allgather(value)

    @staticmethod
    def raise_any(errors: Iterable[Exception | None]) -> None:
        """Raise the first error of those that ranks have met, with a note whose it is."""
        for rank, error in enumerate(errors):
            if error is not None:
                error.add_note(f"on rank {rank}")
                raise error

    @contextlib.contextmanager
    def collective(self) -> Iterator[None]:
        error = None
        try:
            yield
        except Exception as raised:
            error = raised
        self.raise_any(self.all_of(error))

    def any_rank(self, flag: bool) -> bool:
        return self.agree(int(flag), 0, 0).trouble > 0

    def assert_same_on_ranks(self, what: str, value: object) -> None:
        if self.acting:
            raise BusyError("what `once` calls may only read a simulation; it was to be changed. Do it on all ranks.")
        digests = self.all_of(_digest_of(value))
        if others := [rank for rank, each in enumerate(digests) if each != digests[0]]:
            raise InputError(
                f"{what} must be the same on all ranks; those of rank {others[0]} differ from those of rank 0. Make "
                "them alike, with the same seed or file, on each."
            )

    def sum_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Sums over the ranks of integers, which do not depend on the order."""
        total = np.empty_like(values)
        self._comm.Allreduce(values, total, op=self._mpi.SUM)
        return total

    def on_root(self, act: Callable[[], Result]) -> Result:
        if self.acting:
            return act()
        self.acting = self.is_root
        try:
            with interrupts_held_back():  # no rank may leave it before the others
                if self.is_root:
                    outcome = _outcome_of(act)
                    self._comm.bcast((True, outcome))
                    return _result_of(outcome)
                ended, message = self._comm.bcast(None)
                while not ended:
                    self._comm.gather(_outcome_of(lambda question=message: self.answer(question)))
                    ended, message = self._comm.bcast(None)
                return _result_of(message)
        finally:
            self.acting = False

    def ask(self, question: Any) -> list[Any]:
        """The answer of each rank, in their order; of the first rank, while it acts `on_root`."""
        self._comm.bcast((False, question))
        return [_result_of(each) for each in self._comm.gather(_outcome_of(lambda: self.answer(question)))]


def _digest_of(given: object) -> str:
    """Digest of a value: of equal arrays, numbers and texts the same, wherever they lie in memory."""
    digest = hashlib.blake2b()

    def take(value: Any) -> None:
        if isinstance(value, (tuple, list)):
            digest.update(f"{len(value)} values ".encode())
            for each in value:
                take(each)
        elif isinstance(value, dict):
            take(sorted(value.items()))
        elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
            digest.update(f"{value.dtype.str} {value.shape} ".encode() + value.tobytes())
        else:
            try:
                digest.update(pickle.dumps(value))
            except Exception:  # whatever it is, it is refused by who knows what it should be
                digest.update(type(value).__name__.encode())

    take(given)
    return digest.hexdigest()


def _outcome_of(act: Callable[[], Any]) -> bytes:
    """The result of an act or its error, to be sent to other ranks, which wait for it whatever happens."""
    try:
        result, error = act(), None
    except BaseException as raised:
        result, error = None, raised
    try:
        outcome = pickle.dumps((result, error))
        if error is not None:
            pickle.loads(outcome)  # an exception may be written and not read
        return outcome
    except Exception as unsendable:
        what = unsendable if error is None else f"{type(error).__name__}: {error}"
        return pickle.dumps((None, TypeError(f"what goes to other ranks must be sendable; got {what}")))


def _result_of(outcome: bytes) -> Any:
    """The result of an act; its error is raised."""
    result, error = pickle.loads(outcome)
    if error is not None:
        raise error
    return result
