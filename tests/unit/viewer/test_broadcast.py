"""What is packed once for all pages."""

import json

import numpy as np

from mpsim.core.state import State
from mpsim.scene.scene import Scene
from mpsim.viewer import wire
from mpsim.viewer.broadcast import Broadcast

SCENE = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
STATE = State(SCENE.position, SCENE.velocity)


class Pages:
    def __init__(self):
        self.pictures, self.texts = [], []

    def show(self, picture):
        self.pictures.append(picture)

    def tell(self, kind, text):
        self.texts.append((kind, json.loads(text)))


def test_radii_are_packed_anew_only_for_other_discs():
    pages = Pages()
    broadcast = Broadcast(pages, SCENE)
    broadcast.show(STATE, SCENE.radii, 1, 0.1)
    broadcast.show(STATE, SCENE.radii, 2, 0.2)
    first, second = pages.pictures
    assert (first.serial, second.serial) == (1, 2)
    assert wire.unpack(second.packed).header.frame == 2
    assert second.radii is first.radii
    more = State(np.vstack([SCENE.position, [[1.0, 1.0]]]), np.vstack([SCENE.velocity, [[0.0, 0.0]]]))
    broadcast.show(more, np.append(SCENE.radii, 0.25), 3, 0.3)
    assert wire.unpack_radii(pages.pictures[-1].radii).tolist() == [0.5] * 5 + [0.25]


def test_radii_that_were_forgotten_are_packed_anew():
    pages = Pages()
    broadcast = Broadcast(pages, SCENE)
    broadcast.show(STATE, SCENE.radii, 1, 0.1)
    broadcast.forget_radii()
    broadcast.show(STATE, 2 * SCENE.radii, 2, 0.2)
    assert [wire.unpack_radii(each.radii).tolist() for each in pages.pictures] == [[0.5], [1.0]]


def test_what_is_the_same_as_before_is_sent_again_only_by_tell():
    pages = Pages()
    broadcast = Broadcast(pages, SCENE)
    for values in ({"a": 1}, {"a": 1}, {"a": 2}):
        broadcast.tell_if_new("hands", values)
    assert [text["a"] for _, text in pages.texts] == [1, 2]
    broadcast.tell("hands", {"a": 2})
    assert len(pages.texts) == 3
