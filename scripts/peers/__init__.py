"""Comparison of mpsim with other engines on the same scenes; see docs/peers.md.

registry.py lists the engines; a file `with_NAME.py` drives each, behind the interface of engine.py; yardstick.cpp is
the report's algorithm in C++. Each engine runs in a process of its own: worker.py there, client.py here.
study.py times them by turns and finds the steps that errors allow; tables.py, pictures.py and page.py show it.
"""
