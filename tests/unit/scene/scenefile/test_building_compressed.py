"""[compressed] in a scene file: the start that Scene.compressed gives, to the bit; what is refused, in words."""

import inspect
import json
import logging

import pytest
from support.commands import mpsim_command
from support.scenefiles import HEAD

import mpsim
from mpsim.scene.scenefile import schema

NINE = "schema = 1\nwidth = 4\nheight = 4\n"
TABLE = "[compressed]\npacking = 0.7\nrate = 1.0\n"
DISCS = "[[discs]]\nplaces = 'random'\ncount = 9\nradius = 0.5\ntemperature = 1.0\nseed = 3\n"


def test_its_keys_and_defaults_are_those_of_python():
    arguments = inspect.signature(mpsim.Scene.compressed).parameters
    fields = schema.Compressed.model_fields
    assert list(fields) == [name for name in arguments if name != "self"]
    assert fields["packing"].is_required()
    assert fields["rate"].default == arguments["rate"].default


def test_a_file_gives_the_bits_of_python_and_keeps_them(plain, load, tmp_path, caplog):
    before = load(NINE + DISCS).scene
    with caplog.at_level(logging.INFO, logger="mpsim"):
        file = load(NINE + TABLE + DISCS)
    assert "compressing <Scene: 9 discs" in caplog.text
    same = before.compressed(0.7, rate=1.0)
    assert file.scene.digest() == same.digest() != before.digest()
    assert file.scene.packing == pytest.approx(0.7, rel=1e-14)
    assert file.scene.digest() != before.compressed(0.7, rate=2.0).digest(), "negative control: the rate counts"
    assert file.scene.redrawn(5).digest() == same.redrawn(5).digest() != same.digest()

    shown = mpsim_command("show", str(tmp_path / "scene.toml"))
    assert "\nstart        compressed to packing 0.7 at rate 1\n" in shown.stdout
    record = json.loads(mpsim_command("show", str(tmp_path / "scene.toml"), "--json").stdout)
    assert record["compressed"] == {"packing": 0.7, "rate": 1.0}

    file.scene.save(tmp_path / "saved.toml")
    assert "compressed" not in (tmp_path / "saved.toml").read_text()
    assert mpsim.Scene.load(tmp_path / "saved.toml").digest() == file.scene.digest()


def test_without_the_table_nothing_is_said_of_it(load, tmp_path):
    assert load(NINE + DISCS).compressed is None
    assert "start" not in mpsim_command("show", str(tmp_path / "scene.toml")).stdout


AT_REST = DISCS.replace("temperature = 1.0\n", "")
PEG = "obstacles = [{ position = [0.2, 0.2], radius = 0.1 }]\n"
WRONG = {
    NINE + "[compressed]\n" + DISCS: "compressed.packing must be given; got nothing.",
    NINE + "compressed = 0.8\n" + DISCS: "compressed must be a table; got 0.8.",
    NINE + TABLE.replace("[compressed]", "[[compressed]]") + DISCS: "compressed must be a table; "
    "got [{'packing': 0.7, 'rate': 1.0}].",
    NINE + TABLE.replace("0.7", "'dense'") + DISCS: "compressed.packing must be a number > 0 (a fraction of the area); "
    "got 'dense'.",
    NINE + TABLE.replace("0.7", "0.95") + DISCS: "compressed.packing must be above that of the scene, 0.441786, and "
    "below 0.9069, the densest that discs of such radii can have; got 0.95. Choose one between, or compress a scene of "
    "lower packing.",
    NINE + TABLE.replace("0.7", "0.4") + DISCS: "compressed.packing must be above that of the scene, 0.441786, and "
    "below 0.9069, the densest that discs of such radii can have; got 0.4. Choose one between, or compress a scene of "
    "lower packing.",
    NINE + TABLE.replace("1.0", "0") + DISCS: "compressed.rate must be a number from 1e-06 to 10; got 0.",
    NINE + TABLE + AT_REST: "compressed: velocity must not be 0 everywhere, and must be "
    "below 1e+140, for compressed: discs move meanwhile; the largest is 0. Give them a temperature.",
    NINE + PEG + TABLE + DISCS: "compressed cannot do a scene with obstacles, as its box shrinks. Compress the discs "
    "without, and make a Scene of their positions and velocities.",
    NINE + TABLE: "compressed needs discs; got 0 discs. Make a scene with some.",
    NINE + "[compressed]\npacking = 0.7\nspeed = 1\n" + DISCS: "compressed.speed must be a key of a scene file; this "
    "one is unknown, with the value 1. Keys there: packing, rate.",
    NINE + "[compressed]\npacking = 0.7\nrat = 1\n" + DISCS: "compressed.rat must be a key of a scene file; this one "
    "is unknown, with the value 1. Did you mean 'rate'?",
    HEAD + "[compression]\npacking = 0.7\n": "compression must be a key of a scene file; this one is unknown, with the "
    "value {'packing': 0.7}. Did you mean 'compressed'?",
    NINE + DISCS.replace("random", "compressed"): "discs[0].places must be a start of one group; got 'compressed', "
    "which is for all groups together. Use 'random' here, and a table [compressed].",
}


@pytest.mark.parametrize("text", WRONG, ids=lambda text: WRONG[text][:60])
def test_what_is_wrong_is_said(problems, text):
    assert problems(text) == [WRONG[text]]
