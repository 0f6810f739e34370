"""python generate.py data=NAME [key=value …]: make a data set, or what is missing of it."""

from gns_pl.commands.generate import run

if __name__ == "__main__":
    run()
