"""python correct.py [key=value …]: fit a network that corrects coarse material point runs."""

from gns_pl.commands.correct import run

if __name__ == "__main__":
    run()
