"""python convert.py source=THEIRS target=FOLDER [to=FORMAT] [key=value …]: others' data and weights, in and out."""

from gns_pl.commands.convert import run

if __name__ == "__main__":
    run()
