"""From stored trajectories to batches: statistics, windows with their ballistic pre-history, the LightningDataModule.

Nothing is generated and no noise is added here.
"""
