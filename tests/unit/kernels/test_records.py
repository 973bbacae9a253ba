"""The records of the shared block: that names are free, workers apart, and a worker takes them for what they are."""

import pickle

import numpy as np
import pytest

from mpsim.features.edges import EDGES
from mpsim.kernels import layout, records

RECORDS = {
    "parameters": records.parameters_in("float32"),
    "control": records.CONTROL,
    "member": records.MEMBER,
    "tally": records.TALLY,
    "counts": records.COUNTS,
}


@pytest.mark.parametrize("name", RECORDS)
def test_no_field_has_the_name_of_an_attribute_that_numpy_would_give_instead(name):
    assert hasattr(np.void, "real"), "the control: such a field could not be read by name"
    assert not [field for field in RECORDS[name].names if hasattr(np.void, field)]


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_sent_to_a_worker_is_of_the_same_type(name):
    """Otherwise each worker would compile the kernels anew."""
    sent = pickle.loads(pickle.dumps(RECORDS[name]))
    assert (sent, sent.type, sent.isalignedstruct) == (RECORDS[name], records.Record, True)


def test_what_one_process_writes_shares_no_pair_of_cache_lines_with_what_another_does():
    assert [RECORDS[name].itemsize % records.LINE_PAIR for name in ("control", "member")] == [0, 0]
    words = [layout.COMMAND, layout.ARRIVED, layout.ABORT, layout.MAIL, layout.BAD, layout.ANNOUNCED, layout.SIGNALS]
    assert np.diff(words).tolist() == [8] * 6, "a cache line for each word that processes wait on"


def test_edges_have_the_order_of_a_scene():
    assert [EDGES[edge] for edge in (layout.LEFT, layout.RIGHT, layout.BOTTOM, layout.TOP)] == [
        "left", "right", "bottom", "top",
    ]  # fmt: skip
