"""Texts that no file can hold as they are: they are written out, in every format, and found again."""

import mpsim


def odd(x):
    """A run of each kind: its result, and how it fails."""
    if x == 1:
        raise ValueError("z" * 10_000_000)
    if x == 2:
        raise ValueError("no file \udcff")
    return {"name": "a\udcff"}


def test_a_sweep_writes_lone_surrogates_and_long_errors_to_all_its_files(tmp_path):
    path = tmp_path / "sweep.jsonl"
    table = mpsim.sweep(odd, {"x": [0, 1, 2]}, path=path)
    assert path.stat().st_size < 20_000, "an error of 10 MB is cut"
    for write, name in ((table.to_csv, "t.csv"), (table.to_json, "t.json"), (table.to_parquet, "t.parquet")):
        write(tmp_path / name)
    assert "a\\udcff" in (tmp_path / "t.csv").read_text()
    again = mpsim.sweep(odd, {"x": [0]}, path=tmp_path / "again.jsonl").to_csv()
    assert "a\\udcff" in again
