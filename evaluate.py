"""python evaluate.py ckpt=FILE [key=value …]: judge a checkpoint on test scenes against MPM computed on demand."""

from gns_pl.commands.evaluate import run

if __name__ == "__main__":
    run()
