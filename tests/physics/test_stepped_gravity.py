"""The stepped solver under gravity: weight on the floor, bounces, heaps, and the gas laws of a tall box."""

import numpy as np
import pytest
from support.internals import wall_impulses
from support.scenes import gas, simulate

from mpsim import Scene, State
from mpsim.measure import fit_order, independent_average, kinetic_energy, potential_energy, reference

G = 1.0


def energy_above_floor(state, scene):
    """Kinetic and potential energy, heights counted from the lowest place of a centre."""
    return kinetic_energy(state, scene) + potential_energy(state, scene) - G * scene.radius * scene.count


def weight(contact, law="elastic", until=200.0):
    """Impulse of floor less ceiling; what momentum lacks along y, and along x; the weight, all times the time."""
    scene = gas(64, 0.3, seed=4, gravity=(0, -G))
    with simulate(scene, method="naive", dt=0.02, contact=contact, law=law) as sim:
        left, right, bottom, top = wall_impulses(sim, round(until / 0.02))
        gained = sim.state.velocity.sum(axis=0) - scene.velocity.sum(axis=0)
    expected = scene.count * G * until
    return bottom - top, bottom - top - expected - gained[1], left - right - gained[0], expected


@pytest.mark.parametrize("contact", ["impact", "push"])
def test_a10_floor_less_ceiling_is_the_weight(contact, figures):
    """Exact at any step: contacts of both kinds keep momentum. Only the fixed point of the tally, 2^-32, is lost."""
    carried, amiss, sideways, expected = weight(contact)
    assert abs(amiss) / expected < 1e-8, f"{amiss} of {expected} is missing"
    assert abs(sideways) / expected < 1e-8, f"{sideways} is missing in x"
    assert carried == pytest.approx(expected, rel=0.005)
    _, control, _, _ = weight(contact, law="reflect")
    assert abs(control) / expected > 1e-3, "contacts that do not keep momentum must show"
    found, lost = f"{carried / expected:.5f}; {abs(amiss) / expected:.0e}", abs(control) / expected
    figures.note("A10", contact, "(floor - ceiling)/weight; missing", "1; 0", found, f"reflect: {lost:.1e} missing")


def bouncing(dt, contact, bounces=350, count=64):
    """Discs that bounce side by side from different heights: energy over that at the start, and what push should keep.

    Under push, symplectic Euler keeps v^2/2 + g y - g v dt/2, the turn takes g |v| dt from it, and being put at the
    wall gives back half of that on average: |v| loses g dt/2 per bounce, the energy the part g^2 dt t / v_0^2.
    """
    rng = np.random.default_rng(1)
    height, speed = 5 + rng.random(count), rng.random(count) - 0.5
    landing = np.sqrt(speed**2 + 2 * G * height)
    position = np.stack([2.0 * np.arange(count) + 1, 0.5 + height], axis=1)
    velocity = np.stack([np.zeros(count), speed], axis=1)
    features = dict(width=2 * count, height=10, radius=0.5, gravity=(0, -G))
    scene = Scene(position=position, velocity=velocity, **features)
    with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
        frames = int(bounces * 2 * landing.mean() / G / dt)
        for _ in range(16):  # in parts: the times of two million frames fill 100 MB
            sim.run(frames=frames // 16)
        state, end = sim.state, sim.time
    kept = ((state.velocity**2).sum(axis=1) / 2 + G * (state.position[:, 1] - 0.5)) / (landing**2 / 2)
    return kept, np.maximum(1 - G**2 * dt * end / landing**2 / 2, 0), landing.mean()


def check_bounces(dt, figures):
    """Exact parabolas, exact bounces: nothing but rounding is lost. The clamp at the wall loses what theory says."""
    kept, _, _ = bouncing(dt, "impact")
    worst = np.abs(kept - 1).max()
    assert worst < 1e-11, f"an energy has changed by {worst} at dt={dt}"
    control, expected, _ = bouncing(dt, "push")
    assert abs(control.mean() - expected.mean()) < 0.002, f"push keeps {control.mean()}, expected {expected.mean()}"
    assert control.mean() < 1 - 0.5 * dt, "the clamp at the wall must fail"
    lost = f"push: {control.mean():.4f} kept (theory {expected.mean():.4f})"
    figures.note("A11", "impact", f"energy, 350 bounces, dt = {dt}: largest change", 0, f"{worst:.0e}", lost)


@pytest.mark.parametrize("dt", [0.01, 0.003])
def test_a11_bounces_keep_their_energy_to_rounding_with_impact_and_lose_it_with_push(dt, figures):
    check_bounces(dt, figures)


@pytest.mark.long
def test_a11_bounces_of_a_short_step(figures):
    check_bounces(0.001, figures)


def heap_drift(dt, contact, starts, until, passes=1):
    """Part of its energy that a heap of 100 elastic discs gains."""
    drifts = []
    for seed in range(starts):
        scene = Scene.random(count=100, width=10, height=40, radius=0.5, seed=seed, gravity=(0, -G))
        with simulate(scene, method="naive", dt=dt, contact=contact, passes=passes) as sim:
            before = energy_above_floor(sim.state, scene)
            sim.run(until=until)
            drifts.append(energy_above_floor(sim.state, scene) / before - 1)
    return independent_average(drifts)


def check_heap(starts, until, figures):
    """Energy gained: 0.002 dt^2 per unit of time is allowed, and impact gains some 1e-4 dt^2. Push loses 0.011 dt."""
    steps = (0.02, 0.01, 0.005)
    found = [heap_drift(dt, "impact", starts, until) for dt in steps]
    control = [heap_drift(dt, "push", starts, until) for dt in steps]
    for dt, drift, loss in zip(steps, found, control, strict=True):
        gate = 0.002 * dt**2 * until
        assert abs(drift.value) < gate, f"the heap gains {drift} at dt={dt}, allowed {gate}"
        assert loss.value < -gate, f"push must fail the gate {gate}; got {loss} at dt={dt}"
    order = fit_order(steps, [m.value for m in control], [m.error for m in control])
    assert 0.8 < order.value < 1.1, f"order of push {order}"
    for dt, drift, loss in zip(steps, found, control, strict=True):
        quantity, gate = f"heap of 100, t = {until:g}, dt = {dt}: energy gained", 0.002 * dt**2 * until
        figures.note("A11", "impact", quantity, f"below {gate:.2g}", drift, f"push: {loss}")


def test_a11_a_heap_keeps_its_energy_better_with_impact_than_with_push(figures):
    check_heap(8, 100.0, figures)


@pytest.mark.long
def test_a11_a_heap_over_a_long_time(figures):
    check_heap(32, 400.0, figures)


def dense_pile(seed, count=100):
    """Discs at packing 0.7 whose weight over the side of the box is 30 kT."""
    side = gas(count, 0.7).height
    return gas(count, 0.7, seed=seed, gravity=(0.0, -30 / side))


def drifts_of(scenes, until, **settings):
    """Change of the energy of each scene per unit of time, as a fraction of the kinetic energy."""
    drifts = []
    for scene in scenes:
        with simulate(scene, **settings) as sim:
            drifts.append(sim.run(until=until, measures=["energy_drift"]).measures["energy_drift"].value)
    return drifts


def check_pile(starts, until, gates, figures, passes=1):
    """Energy that a dense pile gains. Put on a wall without a bounce, and lifted for nothing, it gained 13 dt^2."""
    for dt, gate in gates.items():
        settings = dict(dt=dt, until=until, passes=passes)
        drift = independent_average(drifts_of(map(dense_pile, range(starts)), contact="impact", **settings))
        assert abs(drift.value) + 2 * drift.error < gate, f"a pile gains {drift} per time at dt={dt}, allowed {gate}"
        control = independent_average(drifts_of(map(dense_pile, range(2)), contact="push", **settings))
        assert abs(control.value) > 4 * gate, f"push must fail the gate {gate}; got {control} at dt={dt}"
        quantity = f"dense pile of 100, dt = {dt}, passes = {passes}: energy drift"
        figures.note("A11", "impact", quantity, f"below {gate:.0e}", drift, f"push: {control}")


def test_a11_a_dense_pile_keeps_its_energy(figures):
    check_pile(4, 10.0, {0.02: 1e-4, 0.01: 3e-5}, figures)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*collides about .* times in one step:mpsim.FastWarning")  # at dt = 0.05, rightly
@pytest.mark.parametrize("passes", [1, 2])
def test_a11_a_dense_pile_over_a_long_time(passes, figures):
    check_pile(16, 60.0, {0.05: 1e-3, 0.02: 5e-5, 0.01: 1e-5}, figures, passes)


def pulled_apart(seed):
    """Discs of which every other one is pulled up."""
    pull = np.zeros((100, 2))
    pull[:, 1] = np.where(np.arange(100) % 2, 1.0, -2.0)
    return Scene.random(count=100, packing=0.4, radius=0.5, seed=seed, acceleration=pull)


@pytest.mark.slow
def test_a11_discs_that_are_pulled_differently_keep_their_energy():
    drifts = drifts_of(map(pulled_apart, range(4)), 10.0, dt=0.05, contact="impact")
    assert np.abs(drifts).max() < 3e-4, f"energy drifts {drifts}"
    control = drifts_of(map(pulled_apart, range(4)), 10.0, dt=0.05, contact="push")
    assert np.abs(control).max() > 1e-3, f"push must fail; got {control}"


def potential_share(dt, contact, starts, time=400.0, count=20):
    """Mean potential energy of very small discs over E/(2 N), and the part of the energy gained meanwhile."""
    shares, drifts = [], []
    for seed in range(starts):
        low = Scene.random(count=count, width=8.0, height=3.0, radius=0.02, seed=seed)
        features = dict(width=8.0, height=60.0, radius=0.02, gravity=(0, -G))
        scene = Scene(position=low.position, velocity=low.velocity, **features)
        energy = energy_above_floor(State(scene.position, scene.velocity), scene)
        with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
            sim.run(until=100)
            heights = []
            for _ in range(100):
                sim.run(frames=round(time / 100 / dt))
                heights.append(G * (sim.state.position[:, 1] - 0.02).mean())
            drifts.append(energy_above_floor(sim.state, scene) / energy - 1)
        shares.append(np.mean(heights) / reference.potential_energy_per_disc(energy, count))
    return independent_average(shares), independent_average(drifts)


def check_shares(dt, starts, error, figures):
    share, drift = potential_share(dt, "impact", starts)
    # Packing of 0.003 in the lower half raises the discs by as much.
    assert share.error < error
    assert abs(drift.value) < 1e-5, f"the energy has changed by {drift}"
    assert abs(share.value - 1) < 3 * share.error + 0.003, f"potential energy {share} of E/(2N)"
    control, loss = potential_share(dt, "push", max(starts // 3, 2))
    assert control.value < 0.9, f"clamped at the floor, discs must sink; got {control}"
    quantity = f"small discs under gravity, dt = {dt}: m g y over E/(2N)"
    figures.note("F2", "impact", quantity, 1, share, f"push: {control}, energy {loss}")


def test_f2_half_of_a_share_of_energy_is_potential(figures):
    check_shares(0.01, 24, 0.01, figures)


@pytest.mark.long
def test_f2_half_of_a_share_of_energy_is_potential_to_three_digits(figures):
    check_shares(0.005, 200, 0.003, figures)
