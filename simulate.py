"""python simulate.py [ckpt=FILE] scene=FILE.yaml|NAME [key=value …]: run scenes, frames into HDF5."""

from gns_pl.commands.simulate import run

if __name__ == "__main__":
    run()
