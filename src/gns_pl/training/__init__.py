"""Fit a simulator to a dataset: the LightningModule, its callbacks, and `train`, behind `python train.py`.

`train` alone sees the Hydra config; below it there are named arguments. Nothing else in the package imports this room.
"""
