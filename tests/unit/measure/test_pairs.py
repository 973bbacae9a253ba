"""Close pairs, each once and by its nearest images."""

import numpy as np
import pytest
from support.states import drop, state_of

from mpsim.measure import observables, pairs


@pytest.mark.parametrize("lengths", [(None, None), (9.0, None), (None, 7.0), (9.0, 7.0)])
def test_close_pairs_find_each_pair_once_by_its_nearest_images(lengths):
    position = np.random.default_rng(8).uniform(0, [9, 7], (120, 2))
    found = [np.concatenate(part) for part in zip(*pairs.close_pairs(position, 3.4, lengths), strict=True)]
    i, j = np.triu_indices(120, 1)
    distance = np.hypot(*pairs.to_nearest_image(position[i] - position[j], lengths).T)
    expected = {(a, b): d for a, b, d in zip(i.tolist(), j.tolist(), distance, strict=True) if d < 3.4}
    got = {(min(a, b), max(a, b)): d for a, b, d in zip(*(part.tolist() for part in found), strict=True)}
    assert len(found[0]) == len(got)
    assert got.keys() == expected.keys()
    assert max(abs(got[pair] - expected[pair]) for pair in got) < 1e-12


def test_chunks_of_the_pair_search_change_nothing(monkeypatch):
    scene = drop(500, 12.0, seed=9)
    whole = observables.overlap(state_of(scene), scene)
    monkeypatch.setattr(pairs, "CANDIDATES", 7)
    parts = observables.overlap(state_of(scene), scene)
    assert (parts.pairs, parts.largest, parts.worst) == (whole.pairs, whole.largest, whole.worst)
    assert parts.mean == pytest.approx(whole.mean, rel=1e-12)
