"""`python -m mpsim` is the command `mpsim`."""

from mpsim.cli.app import main

if __name__ == "__main__":
    main(prog_name="mpsim")
