"""`mpsim clean` in this process; what it removes is tested among the faults."""

import json

from support.commands import mpsim_command

from mpsim.engine.workers import shared


def test_clean_can_tell_in_json(monkeypatch):
    block = shared.StaleBlock("mpsim-7-0123abcd", 7, 4096)
    monkeypatch.setattr(shared, "stale_blocks", lambda: [block])
    found = json.loads(mpsim_command("clean", "--dry-run", "--json").stdout)
    assert found == [{"name": "mpsim-7-0123abcd", "pid": 7, "nbytes": 4096}]
