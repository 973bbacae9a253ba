"""Messages between ranks. All ranks make the same calls in the same order. Only this module imports `mpi4py`."""

import contextlib
import hashlib
import importlib
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from mpsim.errors import InputError

Result = TypeVar("Result")


NOT_FINITE, LOST = 1, 2


def _nothing(question: Any) -> None:
    """The answer where nobody asks."""


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


def communicator_of(comm: Any) -> "Communicator":
    """The ranks of a communicator of mpi4py.

    Raises:
        InputError: as `ranks_of`.
    """
    ranks_of(comm)
    return Communicator(comm)


@contextlib.contextmanager
def raised_together(comm: Any) -> Iterator[None]:
    """A block in which what one rank raises, all raise: before there is a solver that they share.

    Raises:
        InputError: as `ranks_of`.
    """
    ranks, error = communicator_of(comm), None
    try:
        try:
            yield
        except Exception as raised:
            error = raised
        ranks.raise_any(ranks.all_of(error))
    finally:
        ranks.close()


class Communicator:
    """The ranks that share a simulation, by a communicator of their own, so that no message of the caller's is taken.

    Args:
        comm: of mpi4py; None: all ranks.

    Attributes:
        rank: number of this one.
        size: number of them.
    """

    def __init__(self, comm: Any = None):
        self._mpi = library()
        self._comm: Any = (self._mpi.COMM_WORLD if comm is None else comm).Dup()
        self.rank: int = self._comm.rank
        self.size: int = self._comm.size
        self._creator = os.getpid()
        self._told, self._heard = np.zeros(4, np.int64), np.zeros(4, np.int64)

    def close(self) -> None:
        """Give the communicator back; in a fork it is left alone, as MPI may not be called there."""
        if self._creator != os.getpid():
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

    @staticmethod
    def raise_any(errors: Iterable[Exception | None]) -> None:
        """Raise the first error of those that ranks have met, with a note whose it is."""
        for rank, error in enumerate(errors):
            if error is not None:
                error.add_note(f"on rank {rank}")
                raise error

    def all_of(self, value: Any) -> list[Any]:
        """What each rank has handed over, in their order."""
        return self._comm.allgather(value)

    def on_all(self, act: Callable[[], Result]) -> Result:
        """What an act gives that each rank does alone; what one of them raises, all raise."""
        result, error = None, None
        try:
            result = act()
        except Exception as raised:
            error = raised
        self.raise_any(self.all_of(error))
        return cast(Result, result)

    def demand_alike(self, what: str, given: object) -> None:
        """Refuse what differs on some ranks.

        Raises:
            InputError: naming what, on all ranks.
        """
        told = self.all_of(_digest_of(given))
        if others := [rank for rank, each in enumerate(told) if each != told[0]]:
            raise InputError(
                f"{what} must be the same on all ranks; those of rank {others[0]} differ from those of rank 0. Make "
                "them alike, with the same seed or file, on each."
            )

    def sum_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Sums over the ranks of integers, which do not depend on the order."""
        total = np.empty_like(values)
        self._comm.Allreduce(values, total, op=self._mpi.SUM)
        return total

    def once(self, act: Callable[[], Result], answer: Callable[[Any], Any] = _nothing) -> Result:
        """What an act gives that the first rank alone does; what it raises, all raise.

        answer: what a rank answers while the first one acts, to what that one asks by `ask`.
        """
        if self.rank == 0:
            outcome = _outcome_of(act)
            self._comm.bcast((True, outcome))
            return _given_by(outcome)
        ended, told = self._comm.bcast(None)
        while not ended:
            self._comm.gather(_outcome_of(lambda question=told: answer(question)))
            ended, told = self._comm.bcast(None)
        return _given_by(told)

    def ask(self, question: Any, answer: Callable[[Any], Any]) -> list[Any]:
        """What each rank answers, in their order; of the first rank, while it acts `once`."""
        self._comm.bcast((False, question))
        return [_given_by(each) for each in self._comm.gather(_outcome_of(lambda: answer(question)))]


def _digest_of(given: object) -> str:
    """Digest of what is given: of equal arrays, numbers and texts the same, wherever they lie in memory."""
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
            digest.update(_pickled(value))

    take(given)
    return digest.hexdigest()


def _pickled(value: object) -> bytes:
    try:
        return pickle.dumps(value)
    except Exception:  # whatever it is, it is refused by who knows what it should be
        return type(value).__name__.encode()


def _outcome_of(act: Callable[[], Any]) -> bytes:
    """What an act gives and what it raises, to be sent to other ranks, which wait for it whatever happens."""
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


def _given_by(outcome: bytes) -> Any:
    """What an act has given; what it has raised is raised."""
    result, error = pickle.loads(outcome)
    if error is not None:
        raise error
    return result
