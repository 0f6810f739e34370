"""python fit.py name=NAME [key=value …]: fit a coarse solver to fine MPM, as a solver of its own."""

from gns_pl.commands.fit import run

if __name__ == "__main__":
    run()
