"""The bits of rough discs: on any number of workers, in pieces, after a resume, after a death."""

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.same_bits import FRAMES, SameBits
from support.scenes import state_after

import mpsim

ROUGH = {"friction": 0.4, "wall_friction": 0.3, "tangential_restitution": 0.5, "restitution": 0.9}

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


class TestFriction(SameBits):
    features = {**ROUGH, "spin": 1.0}  # noqa: RUF012
    packing = 0.6

    @pytest.mark.long
    @pytest.mark.parametrize("precision", ["float32", "float64"])
    @pytest.mark.parametrize("contact", ["push", "impact"])
    def test_precisions_and_contacts_have_the_same_bits_on_workers(self, precision, contact):
        settings = {"dt": 0.02, "contact": contact, "precision": precision}
        grid = state_after(self.scene(), FRAMES, method="grid", **settings)
        assert grid.spin.dtype == precision
        assert_same_bits(
            state_after(self.scene(), FRAMES, method="parallel", workers=3, **settings), grid, str(settings)
        )

    def test_contacts_change_spins_which_are_in_the_digest(self, expected):
        """The control: another spin is another digest."""
        assert np.unique(expected.spin).size > 1000
        other = mpsim.State(expected.position, expected.velocity, spin=np.nextafter(expected.spin, 9), box=expected.box)
        again = mpsim.State(expected.position, expected.velocity, spin=expected.spin.copy(), box=expected.box)
        assert other.digest() != again.digest() == expected.digest()
