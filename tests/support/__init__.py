"""What the tests share: scenes, slow twins, subprocesses, comparisons, and the one way into mpsim's internals."""
