"""python train.py +experiment=NAME [key=value …]: generate the data where missing, train a simulator on them."""

from gns_pl.commands.train import run

if __name__ == "__main__":
    run()
