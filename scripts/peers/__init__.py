"""Comparison of mpsim with other engines on the same scenes; see docs/peers.md.

registry.py lists the engines; a file `with_NAME.py` drives each, behind the interface of engine.py; yardstick.cpp is
the report's algorithm in C++. Each engine runs in a process of its own: worker.py there, client.py here. turns.py times
them by turns, accuracy.py finds the steps that errors allow, study.py does all that was asked for; tables.py,
pictures.py and page.py show it.
"""
