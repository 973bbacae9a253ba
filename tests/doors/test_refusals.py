"""Refusals: what, the rule, the value received, what to do instead, in the words of the door that was used.

The rule is checked on every refusal that the sources can make; whole texts stand here once for each kind of door.
"""

import ast
import re
from pathlib import Path

import pytest
from support.refusals import GOOD, assert_refused

import mpsim

pytestmark = pytest.mark.plain


def scene(**more):
    return mpsim.Scene(**{**GOOD, **more})


def sim(**more):
    return mpsim.Simulation(scene(), mpsim.Settings(method="naive", **more))


MEASURES = (
    "measures must be one of 'pressure', 'pressure_virial', 'pressure_xx', 'pressure_yy', 'pressure_xy', "
    "'collision_rate', 'contact_rate', 'overlap', 'largest_overlap', 'kinetic_energy', 'temperature', "
    "'speed_kurtosis', 'energy_drift', 'momentum_drift'; got "
)

WHOLE = [
    (lambda: mpsim.Settings(dt=-1), "dt must be a finite number > 0 [time]; got -1."),
    (
        lambda: mpsim.Settings(method="gird"),
        "method must be one of 'naive', 'grid', 'parallel', 'event', 'mpi', 'auto'; got 'gird'. Did you mean 'grid'?",
    ),
    (
        lambda: mpsim.Settings(substep=2),
        "an argument of Settings must be one of 'dt', 'method', 'workers', 'law', 'contact', 'passes', "
        "'substeps', 'precision', 'on_fast', 'contact_time'; got 'substep'. Did you mean 'substeps'?",
    ),
    (
        lambda: scene(position=[[2, 2], [9, 9]]),
        "position[1] must lie in [0.5, 7.5] x [0.5, 5.5] (one radius from the walls); got (9.0, 9.0) "
        "(discs outside: 1). Move the disc or enlarge the box.",
    ),
    (
        lambda: mpsim.Scene.random(count=100, width=5, height=5, radius=0.5),
        "packing must be at most 0.8 for random places; got 3.14. Use fewer or smaller discs, or a larger "
        "box, which Scene.compressed makes smaller.",
    ),
    (
        lambda: mpsim.Scene.load("gass"),
        "scene must be a path that ends in .toml or one of brazil-nut, brownian, channel, cooling, cradle, dense, "
        "drum, flipper, galton, gas, growth, hopper, mixture, partition, pi, piston, rough-hopper, rough-sediment, "
        "sediment; got 'gass'. Did you mean 'gas'?",
    ),
    (
        lambda: setattr(scene(), "gravity", (0, -9)),
        "gravity of a Scene cannot be assigned; got (0, -9). Make another Scene; sim.change(...) changes a "
        "simulation that runs.",
    ),
    (lambda: sim().run(frames=3, until=2.0), "run needs either frames or until; got frames=3, until=2.0."),
    (lambda: sim().run(frames=0, measures=["presure"]), MEASURES + "'presure'. Did you mean 'pressure'?"),
    (lambda: sim().run(frames=0, measures=5), MEASURES + "5."),
    (lambda: sim().kick(7, (1, 0)), "ids must be numbers of discs, from 0 to 1; got 7. There are 2 discs."),
    (
        lambda: sim().change(),
        "change needs something to change, one of gravity, restitution, wall_restitution, friction, "
        "wall_friction, piston_speed, interval, every, temperature, wall_temperature, obstacles, dt, contact, passes, "
        "substeps, workers; got none of them. Give one.",
    ),
    (
        lambda: sim().change(method="grid"),
        "change must be given parameters that may change; 'method' is fixed from the start of a "
        "simulation. What can be changed: gravity, restitution, wall_restitution, friction, wall_friction, "
        "piston_speed, interval, every, temperature, wall_temperature, obstacles, dt, contact, passes, substeps, "
        "workers.",
    ),
    (
        lambda: sim().add_wall([(0, 0), (99, 0)]),
        "obstacles[0] must lie in the box, [0, 8] x [0, 6]; got a point (99.0, 0.0). Move it, or enlarge the box.",
    ),
    (
        lambda: mpsim.Trajectory("run.txt"),
        "a trajectory's path must end in .xyz, .extxyz, .lammpstrj, .dump, .xyz.gz, .extxyz.gz, .lammpstrj.gz, "
        ".dump.gz, .gsd; got 'run.txt'. Use 'run.xyz'.",
    ),
    (
        lambda: mpsim.Simulation(scene(), start_method="frok"),
        "start_method must be one of 'fork', 'spawn', 'forkserver'; got 'frok'. Did you mean 'fork'?",
    ),
    (
        lambda: mpsim.Simulation(scene(), mpsim.Settings(method="event", law="reflect")),
        "method='event' cannot do law='reflect', which acts on discs that separate. Leave it out, or use "
        "method='grid'.",
    ),
    (
        lambda: mpsim.tradeoff(scene(), [], until=1.0),
        "candidates must hold at least one Settings; got none. Leave it out for the default ones.",
    ),
    (lambda: mpsim.Simulation(None), "scene must be an mpsim.Scene; got NoneType. Make one with Scene(...)."),
]


@pytest.mark.parametrize(("act", "text"), WHOLE, ids=[text[:40] for _, text in WHOLE])
def test_a_refusal_says_it_all_in_the_words_of_its_door(act, text):
    assert assert_refused([], act) == text


# --- the rule, for all that the sources can say

RULE = re.compile(
    r"\b(must|needs?|cannot|can|may|do|does|could not|at most|up to|has|have|holds?|is|are|was|shows?|belongs?|goes)\b"
)
VALUE = re.compile(r"; |: | got |[.}] [A-Z{]")
LEFT_TO_OTHERS = ("{}", "{}.", "{} {}", "{}{}", "change {} of a journal, {} at frame {}: {}")
"""Texts around others, which have all that."""


def refusals(source):
    """Texts of an InputError, or of a class made for it, with {} for what is filled in."""
    for node in ast.walk(ast.parse(source)):
        name = getattr(node, "func", None)
        name = getattr(name, "id", getattr(name, "attr", ""))
        if isinstance(node, ast.Call) and name == "refusal" and len(node.args) > 2:  # whose form is fixed
            what, rule, got, instead = [*map(template, node.args), "Use that."][:4]
            yield f"{what or '{}'} must {rule or '{}'}; got {got or '{}'}. {instead or '{}.'}"
        elif isinstance(node, ast.Call) and name == "InputError":
            for text in map(template, node.args):
                if text and text not in LEFT_TO_OTHERS:
                    yield text


def template(node):
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join("{}" if isinstance(part, ast.FormattedValue) else part.value for part in node.values)
    return None


def breaks_the_rule(text):
    """Why a text is no refusal for people, or None."""
    if not re.search(r"[.?}]$", text):
        return "it does not end as a sentence"
    if not RULE.search(text) and not text.startswith("{}; got"):  # the rule is filled in
        return "it has no rule"
    if not VALUE.search(text):
        return "it says neither what was received nor what to do"
    return None


def test_every_refusal_has_a_rule_a_value_and_a_remedy():
    texts = [text for path in Path(mpsim.__file__).parent.rglob("*.py") for text in refusals(path.read_text())]
    assert len(texts) > 300, "the collector has lost them"
    assert {text: why for text in texts if (why := breaks_the_rule(text))} == {}


@pytest.mark.parametrize("text", ["dt is wrong", "bad value {x}", "dt must be above 0", "no dt; see {x}, please"])
def test_a_text_that_breaks_the_rule_is_found(text):
    """The control."""
    assert breaks_the_rule(next(refusals(f"raise mpsim.InputError(f{text!r})")))
