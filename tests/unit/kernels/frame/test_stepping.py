"""A scene pays for what it has: arrays of features exist only in scenes that use them, in the kernels too."""

import numpy as np
import pytest
from numba import types
from support.internals import machine_code
from support.scenes import gas, simulate

from mpsim.kernels import layout
from mpsim.kernels.compiling import JIT_DISABLED
from mpsim.kernels.features.hooks import BARE, Features, special_borders
from mpsim.kernels.frame.stepping import run_grid


def features_compiled():
    """For each compiled frame: the features that it takes, by name."""
    found = []
    for signature in run_grid.signatures:
        discs, features = signature[0], signature[4]
        fields = dict(zip(Features._fields, features.types, strict=True))
        fields["radius"] = discs.types[layout.Discs._fields.index("radius")]
        found.append({name for name, kind in fields.items() if not isinstance(kind, types.NoneType)})
    return found


@pytest.mark.skipif(JIT_DISABLED, reason="nothing is compiled")
def test_the_frame_of_a_bare_scene_takes_no_array_of_any_feature():
    with simulate(gas(200, 0.3), method="grid") as sim:
        sim.run(frames=1)
        bare = set(sim.array_names)
    assert set() in features_compiled()
    assert not bare & {"gravity", "acceleration", "mass", "wrap_x", "wrap_y", "exits", "piston", "giants", "a.radius"}
    assert not any(name.startswith("capsules") for name in bare)


@pytest.mark.skipif(JIT_DISABLED, reason="nothing is compiled")
def test_a_feature_brings_its_array_and_no_other():
    """Negative control: the look into the compiled frame does see an array that is there."""
    with simulate(gas(200, 0.3), method="grid") as sim:
        bare = set(sim.array_names)
    with simulate(gas(200, 0.3, gravity=(0.0, -1.0)), method="grid") as sim:
        assert set(sim.array_names) - bare == {"gravity"}
    assert {"gravity"} in features_compiled()


@pytest.mark.skipif(JIT_DISABLED, reason="nothing is compiled")
def test_that_all_borders_are_walls_at_rest_is_a_constant_to_the_compiler():
    """None in its type, so that general motion is not even compiled; with any of the features it is another type."""
    fields = ["wrap_x", "wrap_y", "moving_wall"]
    for present in [[], *([field] for field in fields), fields]:
        ask = machine_code(special_borders)
        found = ask(BARE._replace(**dict.fromkeys(present, np.zeros(2))))
        assert found is (True if present else None), present
        assert (ask.nopython_signatures[0].return_type == types.none) == (not present)
