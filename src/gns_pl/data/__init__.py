"""From stored trajectories to batches: statistics, windows with their ballistic pre-history, the LightningDataModule.

`survey` measures what a data set is like, on a sample of it. Nothing is generated and no noise is added here.
"""
