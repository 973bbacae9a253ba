"""What belongs to the first object that it meets."""

from mpsim.core.binding import Binding


class Simulation:
    def __str__(self):
        return "a simulation"


def test_the_first_one_is_the_one_even_after_it_has_gone():
    binding, first = Binding(), Simulation()
    assert not binding.exists
    assert binding.is_to(first)
    assert (binding.exists, str(binding)) == (True, "a simulation")
    assert not binding.is_to(Simulation())
    del first
    assert not binding.is_to(Simulation()), "the next one does not take its place"
    assert str(binding) == "which is gone by now"
