"""python benchmark.py [ckpt=[FILE,…]] [key=value …]: time against error, MPM and learned simulators alike."""

from gns_pl.commands.benchmark import run

if __name__ == "__main__":
    run()
